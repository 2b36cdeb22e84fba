"""DDPG-PID: a learned network sets the gains of the incremental PID at every period (Cheng23)."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, final

from metropilot import drivers
from metropilot._schema import declare
from metropilot.control import Errors
from metropilot.env import FEATURE_WORDS
from metropilot.policy import GuardedPolicy, policy_path, shipped_policy
from metropilot.sim import Run
from metropilot.studies.cheng2023.law import PAPER_LAW, load_tracking_policy

WORDS = {**FEATURE_WORDS, "speed_error": "speed error", "position_error": "position error"}
"""Features and errors in the field's words."""


@final
@dataclass(frozen=True)
class DdpgPidOptions(drivers.AbstractTrackingOptions):
    """Options of ``ddpg-pid``: the reference and the policy that sets the gains.

    Attributes:
        policy: A policy file, or the folder or id of a learning run; empty: the one shipped.
    """

    policy: str = declare("")


@final
class DdpgPid(drivers.AbstractTracker, drivers.AbstractNetworkDriver):
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

    @cached_property
    def gains(self) -> drivers.PolicyFunction:
        """The function that sets the gains: the policy."""
        return self.policy

    def network_view(self, run: Run) -> drivers.NetworkView:
        """The network, and the errors that it sees; the proportional gain counts."""
        del run
        spans = (drivers.FeatureSpan(name, WORDS[name], 1) for name in PAPER_LAW.observed)
        return drivers.NetworkView(self.policy.policy, tuple(spans), "a higher proportional gain", 0)

    def with_policy(self, policy: drivers.PolicyFunction) -> DdpgPid:
        """The same driver with another function in the place of its policy."""
        found = copy(self)
        found.gains = policy
        return found

    def aboard(self, number: type) -> None:
        """None: what the policy answers is checked, and an error in it has no form in C."""
        del number

    def read_policy(self) -> object:
        """Read the policy that sets the gains."""
        return self.policy

    def control(self, memory: Errors, seen: drivers.TrackingView) -> tuple[float, Errors]:
        """One period: the policy's gains, then the law."""
        command, memory = PAPER_LAW.drive(self.gains, seen, memory)
        return float(command), memory
