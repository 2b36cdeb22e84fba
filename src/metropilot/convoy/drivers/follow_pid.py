"""The PID on the speed difference (Chen23b eq. 12): fixed gains, and the state of a policy that sets them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final, no_type_check

import numpy as np

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Array, Scalar
from metropilot.control import Errors, Gains, incremental_pid
from metropilot.convoy.drivers.base import AbstractFollower, waits
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import Vehicle, namespace, scalars

GAIN_LOW, GAIN_HIGH = Gains(0.0, 0.0, 0.0), Gains(5.0, 1.5, 1.5)
"""Chen23b table 1."""
# Names of the entries of the state, in order.
STATE = ("command", "acceleration", "speed", "position", "speed difference", "gap less wanted gap")
SPEED_MPS, POSITION_M, FINE_MPS, FINE_M, FINE_SCALE = 20.0, 1000.0, 0.02, 0.01, 3.0


@no_type_check
def chen2023b_state(observation: FollowerObservation) -> Array:
    """The state of Chen23b eq. 16, scaled: u, acceleration, v, p, dv, dp. Shape (6,), float32.

    ``asinh`` scales the differences, to resolve millimetres near zero and still hold metres. The speed
    difference is the speed ahead minus the own speed; the gap is counted from the desired one.
    """
    xp = namespace(observation.position_m, observation.gap_m)
    join = np if xp is scalars else xp
    values = (
        observation.command,
        observation.acceleration_mps2,
        observation.speed_mps / SPEED_MPS,
        observation.position_m / POSITION_M,
        join.arcsinh((observation.ahead_mps - observation.speed_mps) / FINE_MPS) / FINE_SCALE,
        join.arcsinh((observation.gap_m - observation.wanted_gap_m) / FINE_M) / FINE_SCALE,
    )
    return join.stack([join.asarray(value, np.float32) for value in values])


@no_type_check
def gains_of(action: Array) -> Gains:
    """Gains within the bounds of Chen23b table 1 from actions in [-1, 1] (eq. 15)."""
    return Gains(
        *(
            low + (action[k] + 1.0) * (high - low) / 2.0
            for k, (low, high) in enumerate(zip(GAIN_LOW, GAIN_HIGH, strict=True))
        )
    )


@dataclass(frozen=True)
class FollowPidOptions(CheckedFields):
    """Gains of the PID, 1/(m/s); the best of a grid within Chen23b's bounds on its own run.

    Attributes:
        proportional: On the change of the speed difference, 0 to 5.
        integral: On the speed difference, 0 to 1.5.
        derivative: On the change of the change, 0 to 1.5.
    """

    proportional: float = declare(5.0, low=GAIN_LOW.proportional, high=GAIN_HIGH.proportional)
    integral: float = declare(1.5, low=GAIN_LOW.integral, high=GAIN_HIGH.integral)
    derivative: float = declare(0.5, low=GAIN_LOW.derivative, high=GAIN_HIGH.derivative)


@final
class FollowPid(AbstractFollower):
    """Incremental PID on the speed difference; the gap is not fed back."""

    id = "follow_pid"

    def __init__(self, options: FollowPidOptions | None = None) -> None:
        self.options = options or FollowPidOptions()

    def init(self, vehicle: Vehicle, period_s: float) -> Errors:
        """Start with zero errors."""
        del period_s
        zero = np.asarray(vehicle.mass_kg).dtype.type(0.0)
        return Errors(zero, zero)

    def act(self, memory: Errors, observation: FollowerObservation) -> tuple[Scalar, Errors]:
        """Evaluate the law with fixed gains."""
        options = self.options
        return pid_step(
            observation, Gains(options.proportional, options.integral, options.derivative), memory
        )


@no_type_check
def pid_step(observation: FollowerObservation, gains: Gains, errors: Errors) -> tuple[Scalar, Errors]:
    """Evaluate the PID on the last command that protection passed; hold the command at standstill.

    The speed difference is the trainset ahead's less the own one: with Chen23b's own sign (eq. 10) the loop
    would be unstable.
    """
    xp = namespace(observation.position_m, observation.gap_m)
    share, errors = incremental_pid(
        observation.command, gains, observation.ahead_mps - observation.speed_mps, errors
    )
    return xp.where(waits(observation, observation.wanted_gap_m), 0.0 * share, share), errors
