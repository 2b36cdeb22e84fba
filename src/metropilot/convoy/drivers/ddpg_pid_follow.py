"""DDPG-PID for followers: gains of a PID by a policy that DDPG learned; what Chen23b compares with."""

from __future__ import annotations

from typing import final

from metropilot.convoy.drivers.base import register_follower
from metropilot.convoy.drivers.learned import POLICIES, AbstractGainFollower


@final
class DdpgPidFollow(AbstractGainFollower):
    """The follower that Chen23b compares with."""

    id = "ddpg_pid_follow"
    summary = "PID on the speed difference, gains by a policy of DDPG"


if (POLICIES / f"{DdpgPidFollow.id}.safetensors").exists():
    register_follower(DdpgPidFollow)
