"""Drivers of trainsets that follow another, one file each."""

from metropilot.convoy.drivers import (  # noqa: F401 (importing a follower's file registers it)
    ddpg_pid_follow,
    follow_gap,
    follow_mpc,
    follow_pid,
    sac_pid,
)
from metropilot.convoy.drivers.base import AbstractFollower, FollowerRegistry, register_follower

FOLLOWERS = FollowerRegistry()

__all__ = ["FOLLOWERS", "AbstractFollower", "FollowerRegistry", "register_follower"]
