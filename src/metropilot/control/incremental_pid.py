"""Incremental PID law of the tracking controllers and the tracking task."""

from __future__ import annotations

from typing import NamedTuple

from metropilot._typing import Scalar
from metropilot.physics import namespace


class Gains(NamedTuple):
    """Gains of the law, per m/s of error and per control period.

    Attributes:
        proportional: Gain on the change of the error, 1/(m/s).
        integral: Gain on the error, 1/(m/s).
        derivative: Gain on the second difference of the error, 1/(m/s).
    """

    proportional: Scalar
    integral: Scalar
    derivative: Scalar


CHENG2023_GAINS = Gains(3.4, 0.3, 0.2)
"""Cheng23's fixed and initial gains."""
CHENG2023_UPPER = Gains(5.0, 1.5, 1.5)
"""Cheng23's upper limits of the gains."""


class Errors(NamedTuple):
    """Speed errors of the two periods before, m/s."""

    last: Scalar
    before: Scalar


def incremental_pid(command: Scalar, gains: Gains, error: Scalar, errors: Errors) -> tuple[Scalar, Errors]:
    """Compute the new command in [-1, 1], and the errors for the next period.

    ``u = clip(u + kp (e - e1) + ki e + kd (e - 2 e1 + e2), -1, 1)`` with ``e`` the reference's speed less the
    trainset's. The clipped command prevents windup. Source: Cheng23 eqs. 15 and 16.

    Args:
        command: Command of the period before.
        gains: Gains in force.
        error: Speed error now, m/s.
        errors: Speed errors of the two periods before, m/s.
    """
    xp = namespace(command, error, gains.proportional)
    e1, e2 = errors
    change = (
        gains.proportional * (error - e1)
        + gains.integral * error
        + gains.derivative * (error - 2.0 * e1 + e2)
    )
    return xp.clip(command + change, -1.0, 1.0), Errors(error, e1)
