"""Virtually coupled trainsets: model, link, environment, followers, rollout, key figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.convoy.attack import (
        ATTACKED_HEADS,
        LONGEST_EMERGENCY_S,
        AttackArena,
        AttackCampaign,
        AttackCase,
    )
    from metropilot.convoy.drivers import FOLLOWERS, AbstractFollower, register_follower
    from metropilot.convoy.drivers.learned import AbstractGainFollower, FollowPolicyOptions
    from metropilot.convoy.env import MAX_PERIODS, ConvoyTask, ConvoyTaskConfig
    from metropilot.convoy.headway import ConvoyService, needed_gap_m
    from metropilot.convoy.kpis import ConvoyKpis, MemberKpis, convoy_kpis, write_convoy
    from metropilot.convoy.leaders import record_leader, reference_speeds
    from metropilot.convoy.model import GAP_M, Convoy, ConvoyGuard, Link, LinkQuality, convoy_members
    from metropilot.convoy.pettingzoo import ConvoyParallelEnv
    from metropilot.convoy.request import ConvoyRequest
    from metropilot.convoy.rollout import ConvoyDrive, ConvoyRollout, HeadRun, drive_convoy
    from metropilot.convoy.stability import speed_gains

__all__ = [
    "ATTACKED_HEADS",
    "FOLLOWERS",
    "GAP_M",
    "LONGEST_EMERGENCY_S",
    "MAX_PERIODS",
    "AbstractFollower",
    "AbstractGainFollower",
    "AttackArena",
    "AttackCampaign",
    "AttackCase",
    "Convoy",
    "ConvoyDrive",
    "ConvoyGuard",
    "ConvoyKpis",
    "ConvoyParallelEnv",
    "ConvoyRequest",
    "ConvoyRollout",
    "ConvoyService",
    "ConvoyTask",
    "ConvoyTaskConfig",
    "FollowPolicyOptions",
    "HeadRun",
    "Link",
    "LinkQuality",
    "MemberKpis",
    "convoy_kpis",
    "convoy_members",
    "drive_convoy",
    "needed_gap_m",
    "record_leader",
    "reference_speeds",
    "register_follower",
    "speed_gains",
    "write_convoy",
]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "attack": (
            "ATTACKED_HEADS",
            "AttackArena",
            "AttackCampaign",
            "AttackCase",
            "LONGEST_EMERGENCY_S",
        ),
        "drivers": (
            "AbstractFollower",
            "FOLLOWERS",
            "register_follower",
        ),
        "drivers.learned": (
            "AbstractGainFollower",
            "FollowPolicyOptions",
        ),
        "env": (
            "ConvoyTask",
            "ConvoyTaskConfig",
            "MAX_PERIODS",
        ),
        "headway": (
            "ConvoyService",
            "needed_gap_m",
        ),
        "kpis": (
            "ConvoyKpis",
            "MemberKpis",
            "convoy_kpis",
            "write_convoy",
        ),
        "leaders": (
            "record_leader",
            "reference_speeds",
        ),
        "model": (
            "Convoy",
            "ConvoyGuard",
            "GAP_M",
            "Link",
            "LinkQuality",
            "convoy_members",
        ),
        "pettingzoo": ("ConvoyParallelEnv",),
        "request": ("ConvoyRequest",),
        "rollout": (
            "ConvoyDrive",
            "ConvoyRollout",
            "HeadRun",
            "drive_convoy",
        ),
        "stability": ("speed_gains",),
    },
)
