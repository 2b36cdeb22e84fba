"""The PID on the speed difference, with fixed gains (Chen23b eq. 12)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final, no_type_check

import numpy as np

from metropilot._schema import check_fields, declared
from metropilot._typing import Scalar
from metropilot.control import Errors, Gains, incremental_pid
from metropilot.convoy.drivers.base import AbstractFollower, waits
from metropilot.convoy.gains import GAIN_HIGH, GAIN_LOW
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import Vehicle, namespace


@dataclass(frozen=True)
class FollowPidOptions:
    """Gains of the PID, 1/(m/s); the best of a grid within Chen23b's bounds on its own run.

    Attributes:
        proportional: On the change of the speed difference, 0 to 5.
        integral: On the speed difference, 0 to 1.5.
        derivative: On the change of the change, 0 to 1.5.
    """

    proportional: float = declared(5.0, low=GAIN_LOW.proportional, high=GAIN_HIGH.proportional)
    integral: float = declared(1.5, low=GAIN_LOW.integral, high=GAIN_HIGH.integral)
    derivative: float = declared(0.5, low=GAIN_LOW.derivative, high=GAIN_HIGH.derivative)

    def __post_init__(self) -> None:
        check_fields(self)


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
    return xp.where(waits(observation), 0.0 * share, share), errors
