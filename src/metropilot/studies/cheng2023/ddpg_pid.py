"""DDPG-PID: a learned network sets the gains of the incremental PID at every period (Cheng23)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, final

from metropilot._schema import declare
from metropilot.control import CHENG2023_UPPER, Errors, Gains, incremental_pid
from metropilot.drivers import AbstractTracker, AbstractTrackingOptions, TrackingView
from metropilot.errors import InputError
from metropilot.policy import GuardedPolicy, load_policy, policy_path, shipped_policy
from metropilot.studies.cheng2023.env import gains_of
from metropilot.studies.cheng2023.tracking import SCALE, ObservationScale, tracking_observation

GAINS_OBSERVATION = ("speed", "command", "speed_error", "position_error")
"""Observation entries of the policy, as its file must list them."""


def step_ddpg_pid(
    policy: Callable[[Any], Any],
    seen: TrackingView,
    errors: Errors,
    upper: Gains = CHENG2023_UPPER,
    scale: ObservationScale = SCALE,
) -> tuple[Any, Errors]:
    """One period: the policy's gains (Cheng23 eq. 10), then the incremental law (eqs. 15 and 16).

    Args:
        policy: From an observation of shape (4,) to three numbers in [-1, 1].
        seen: Controller inputs: errors, speed and last command.
        errors: Speed errors of the two periods before.
        upper: Upper limits of the gains.
        scale: Scale of the observation.
    """
    gains = gains_of(policy(tracking_observation(seen, scale)), upper)
    return incremental_pid(seen.command, gains, seen.error_mps, errors)


def load_gains_policy(path: Path) -> GuardedPolicy:
    """A policy that sets gains, from its file.

    Raises:
        InputError: The file cannot be read, is damaged, or is of a policy that sees or sets something else.
    """
    return load_tracking_policy(path, GAINS_OBSERVATION, 3)


def load_tracking_policy(path: Path, observed: Sequence[str], actions: int) -> GuardedPolicy:
    """A policy of a tracking law, from its file.

    Args:
        path: The file.
        observed: Entries of its observation.
        actions: Numbers that it answers with.

    Raises:
        InputError: The file cannot be read, is damaged, or is of a policy that sees or sets something else.
    """
    policy, about = load_policy(path)
    if about.get("observed") != list(observed):
        allowed = ", ".join(observed)
        raise InputError("sees something else than this law", file=path, field="observed", allowed=allowed)
    spec = policy.spec
    if (spec.observation_size, spec.actions, spec.discrete) != (len(observed), actions, False):
        said = f"{actions} numbers from {len(observed)}"
        raise InputError("does not fit this law", file=path, field="policy", value=spec.actions, allowed=said)
    return GuardedPolicy(policy, path)


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
        return load_gains_policy(self.path)

    def aboard(self, number: type) -> None:
        """None: what the policy answers is checked, and an error in it has no form in C."""
        del number

    def read_policy(self) -> object:
        """Read the policy that sets the gains."""
        return self.policy

    def control(self, memory: Errors, seen: TrackingView) -> tuple[float, Errors]:
        """One period: the policy's gains, then the law."""
        command, memory = step_ddpg_pid(self.policy, seen, memory)
        return float(command), memory
