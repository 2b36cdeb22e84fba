"""Virtually coupled trainsets: model, link, environment, followers, rollout, key figures."""

from typing import TYPE_CHECKING

from metropilot.convoy.drivers import FOLLOWERS, AbstractFollower
from metropilot.convoy.env import ConvoyTask, ConvoyTaskConfig
from metropilot.convoy.kpis import ConvoyKpis, MemberKpis, convoy_kpis
from metropilot.convoy.link import Link
from metropilot.convoy.model import Convoy
from metropilot.convoy.request import ConvoyRequest
from metropilot.convoy.rollout import ConvoyDrive, ConvoyRollout, HeadRun, drive_convoy

if TYPE_CHECKING:
    from metropilot.convoy.pettingzoo import ConvoyParallelEnv

__all__ = [
    "FOLLOWERS",
    "AbstractFollower",
    "Convoy",
    "ConvoyDrive",
    "ConvoyKpis",
    "ConvoyParallelEnv",
    "ConvoyRequest",
    "ConvoyRollout",
    "ConvoyTask",
    "ConvoyTaskConfig",
    "HeadRun",
    "Link",
    "MemberKpis",
    "convoy_kpis",
    "drive_convoy",
]


def __getattr__(name: str) -> object:
    # PettingZoo belongs to the extra ``rl``: it is imported when the environment is asked for.
    if name == "ConvoyParallelEnv":
        from metropilot.convoy.pettingzoo import ConvoyParallelEnv

        return ConvoyParallelEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
