"""DDPG-PID: a learned network sets the gains of the incremental PID at every period (Cheng23)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, final

from metropilot._schema import declare
from metropilot.control import Errors
from metropilot.drivers import AbstractTracker, AbstractTrackingOptions, TrackingView
from metropilot.policy import GuardedPolicy, policy_path, shipped_policy
from metropilot.studies.cheng2023.law import PAPER_LAW, load_tracking_policy


@final
@dataclass(frozen=True)
class DdpgPidOptions(AbstractTrackingOptions):
    """Options of ``ddpg-pid``: the reference and the policy that sets the gains.

    Attributes:
        policy: A policy file, or the folder or id of a learning run; empty: the one shipped.
    """

    policy: str = declare("")


@final
class DdpgPid(AbstractTracker):
    """Tracks a reference with gains that a policy learned to set.

    Args:
        options: Reference and policy.
    """

    id: ClassVar[str] = "ddpg_pid"

    def __init__(self, options: DdpgPidOptions | None = None) -> None:
        options = options or DdpgPidOptions()
        super().__init__(options)
        self.path = policy_path(options.policy) if options.policy else shipped_policy(self.id)

    @cached_property
    def policy(self) -> GuardedPolicy:
        """The policy, read when it is first needed.

        Raises:
            InputError: The file cannot be used.
        """
        return load_tracking_policy(self.path, PAPER_LAW)

    def aboard(self, number: type) -> None:
        """None: what the policy answers is checked, and an error in it has no form in C."""
        del number

    def read_policy(self) -> object:
        """Read the policy that sets the gains."""
        return self.policy

    def control(self, memory: Errors, seen: TrackingView) -> tuple[float, Errors]:
        """One period: the policy's gains, then the law."""
        command, memory = PAPER_LAW.drive(self.policy, seen, memory)
        return float(command), memory
