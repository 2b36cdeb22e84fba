"""Drivers of trainsets that follow another, one file each; listing them imports none of those files."""

from metropilot._registry import RegistryRow
from metropilot.convoy.drivers.base import FOLLOWER_REGISTRY as FOLLOWERS
from metropilot.convoy.drivers.base import AbstractFollower, register_follower

FOLLOWERS.add(
    {
        "ddpg_pid_follow": RegistryRow(
            "metropilot.studies.chen2023b.drivers:DdpgPidFollow",
            "PID on the speed difference, gains by a policy of DDPG",
            "Chen23b",
        ),
        "follow_gap": RegistryRow(
            "metropilot.convoy.drivers.follow_gap:FollowGap",
            "Own place in the planned motion by linear control; constant gap or time gap",
            "own",
        ),
        "follow_mpc": RegistryRow(
            "metropilot.convoy.drivers.follow_mpc:FollowMpc",
            "Own place in the planned motion by model-predictive control within efforts and jerk",
            "own",
        ),
        "follow_pid": RegistryRow(
            "metropilot.convoy.drivers.follow_pid:FollowPid",
            "PID on the speed difference to the trainset ahead, fixed gains",
            "Chen23b eq. 12, gains tuned within its bounds",
        ),
        "follow_plan": RegistryRow(
            "metropilot.convoy.drivers.follow_plan:FollowPlan",
            "Own place in the planned motion of the convoy, stop at the own mark",
            "own",
        ),
        "sac_pid": RegistryRow(
            "metropilot.studies.chen2023b.drivers:SacPid",
            "PID on the speed difference, gains by a policy of soft actor-critic",
            "Chen23b",
        ),
    }
)

__all__ = ["FOLLOWERS", "AbstractFollower", "register_follower"]
