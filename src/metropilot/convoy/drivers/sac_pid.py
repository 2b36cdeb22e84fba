"""SAC-PID: the gains of a follower's PID set by a policy that soft actor-critic learned (Chen23b)."""

from __future__ import annotations

from typing import final

from metropilot.convoy.drivers.base import register_follower
from metropilot.convoy.drivers.learned import POLICIES, AbstractGainFollower


@final
class SacPid(AbstractGainFollower):
    """Chen23b's follower."""

    id = "sac_pid"
    summary = "PID on the speed difference, gains by a policy of soft actor-critic"


if (POLICIES / f"{SacPid.id}.safetensors").exists():
    register_follower(SacPid)
