"""Laws of a tracking controller whose parameters a policy sets at every period."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from metropilot._typing import Array, Float
from metropilot.control import CHENG2023_UPPER, Errors, Gains, incremental_pid
from metropilot.drivers import TrackingView
from metropilot.errors import InputError
from metropilot.policy import GuardedPolicy, load_policy
from metropilot.studies.cheng2023.tracking import SCALE, ObservationScale, tracking_observation


class TrackingLaw(NamedTuple):
    """Law whose parameters a policy sets.

    Attributes:
        observed: Entries of an observation, as the file of a policy must list them.
        actions: Numbers of an action, each in [-1, 1].
        observe: From controller inputs and the errors before to an observation.
        step: From an action, controller inputs and the errors before to the command and the errors after.
    """

    observed: Sequence[str]
    actions: int
    observe: Callable[[TrackingView, Errors], Array]
    step: Callable[[Array, TrackingView, Errors], tuple[Array, Errors]]

    def drive(self, policy: Callable[[Any], Any], seen: TrackingView, errors: Errors) -> tuple[Array, Errors]:
        """One period: the policy's action, then the law; returns command and errors.

        Args:
            policy: From an observation to an action.
            seen: Controller inputs.
            errors: Speed errors of the two periods before.
        """
        return self.step(policy(self.observe(seen, errors)), seen, errors)


def gains_of(action: Float[Array, "3"]) -> Gains:
    """Gains of an action of three numbers in [-1, 1] (Cheng23 eq. 10)."""
    return Gains(*(0.5 * (action[j] + 1.0) * CHENG2023_UPPER[j] for j in range(3)))


def gains_law(scale: ObservationScale = SCALE) -> TrackingLaw:
    """The paper's law: the policy sets three gains (Cheng23 eqs. 7, 10, 15 and 16).

    Args:
        scale: Scale of the observation.
    """

    def step(action: Array, seen: TrackingView, errors: Errors) -> tuple[Array, Errors]:
        return incremental_pid(seen.command, gains_of(action), seen.error_mps, errors)

    observed = ("speed", "command", "speed_error", "position_error")
    return TrackingLaw(observed, 3, lambda seen, _: tracking_observation(seen, scale), step)


PAPER_LAW = gains_law()
"""The paper's law with its limits and the scale of this study."""


def load_tracking_policy(path: Path, law: TrackingLaw) -> GuardedPolicy:
    """A policy that sets the parameters of a law, from its file.

    Args:
        path: The file.
        law: The law.

    Raises:
        InputError: The file cannot be read, is damaged, or is of a policy that sees or sets something else.
    """
    policy, about = load_policy(path)
    if about.get("observed") != list(law.observed):
        allowed = ", ".join(law.observed)
        raise InputError("sees something else than this law", file=path, field="observed", allowed=allowed)
    spec = policy.spec
    if (spec.observation_size, spec.actions, spec.discrete) != (len(law.observed), law.actions, False):
        allowed = f"{law.actions} numbers from {len(law.observed)}"
        raise InputError(
            "does not set what this law needs", file=path, field="policy", value=spec.actions, allowed=allowed
        )
    return GuardedPolicy(policy, path)
