"""Dead time, lag and jerk limit: commands on their way, and the state when a command given now begins to act.

The one prediction that drivers compensate the actuation with (Huang25 eq. 4, Chen23a eq. 1). A dead time that
is no whole number of periods blends two commands, as the plant does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, no_type_check

import numpy as np

from metropilot._typing import Scalar
from metropilot.physics import Track, Vehicle, namespace, scalars

LAG_LEAD = 0.7
"""Share of the lag that is made up for by asking for more at once; all of it would amplify noise."""


class Model(NamedTuple):
    """What the driver believes about trainset and section.

    Attributes:
        vehicle: The trainset as the driver knows it (NumPy).
        track: The section.
        dt: Control period, s.
    """

    vehicle: Vehicle
    track: Track
    dt: float


class PredictedState(NamedTuple):
    """The state at the moment a command given now begins to act.

    Attributes:
        seconds: How far ahead.
        position_m: Position.
        speed_mps: Speed.
        acceleration_mps2: Acceleration in the period before.
        share: Command after delay and lag in the period before.
        resistance_mps2: Believed resistance there, per effective mass, factor included.
        gradient_mps2: Gradient force there, per effective mass, positive uphill.
        traction_mps2: Largest traction there, per effective mass, gain included.
        brake_mps2: Largest service brake there, per effective mass, gain included.
    """

    seconds: float
    position_m: float
    speed_mps: float
    acceleration_mps2: float
    share: float
    resistance_mps2: float
    gradient_mps2: float
    traction_mps2: float
    brake_mps2: float


class Motion(NamedTuple):
    """Position, speed, acceleration of the last period, and the command that acted in it."""

    position_m: float
    speed_mps: float
    acceleration_mps2: float
    share: float


class CommandActuation(NamedTuple):
    """Commands on their way through a known dead time and lag.

    Attributes:
        commands: Commands given, newest first, as many as are on their way and one more.
        share: Command after dead time and lag in the last period.
        delay_steps: Dead time in control periods, not always whole.
        keep: Share of the old effort that the lag keeps over a period.
        lag_s: Time constant of the lag.
        dt: Control period, s.
    """

    commands: tuple[float, ...]
    share: float
    delay_steps: float
    keep: float
    lag_s: float
    dt: float

    @property
    def seconds(self) -> float:
        """Whole periods until a command given now begins to act."""
        return math.ceil(self.delay_steps) * self.dt

    def issue(self, command: float) -> CommandActuation:
        """The actuation once a command has been given for the coming period."""
        commands = (command, *self.commands[:-1])
        acting = acting_command(commands, self.delay_steps)
        return self._replace(commands=commands, share=acting + (self.share - acting) * self.keep)


def actuation_of(model: Model) -> CommandActuation:
    """The actuation of a nominal trainset with no command on its way."""
    dt, lag = model.dt, float(model.vehicle.lag_s)
    steps = round(float(model.vehicle.delay_s) / dt, 6)
    keep = math.exp(-dt / lag) if lag > 0 else 0.0
    return CommandActuation((0.0,) * (math.ceil(steps) + 1), 0.0, steps, keep, lag, dt)


@no_type_check
def acting_command(commands: Sequence[Scalar], age: Scalar) -> Scalar:
    """The command issued so many periods ago, blended between two as the plant does.

    Args:
        commands: Newest first.
        age: Periods, one number or an array of them.
    """
    xp = namespace(age)
    whole = int(age) if xp is scalars else np.floor(age).astype(int)
    part = age - whole
    older = commands[xp.minimum(whole + 1, len(commands) - 1)]
    return commands[whole] * (1.0 - part) + older * part


def predict_motion(
    motion: Motion,
    commands: Sequence[float],
    delay_steps: float,
    keep: float,
    limits_mps2: tuple[float, float, float],
    jerk_mps3: float,
    dt: float,
) -> Motion:
    """The motion when a command given now begins to act, with the commands on their way.

    Args:
        motion: The motion now.
        commands: Commands given, newest first.
        delay_steps: Dead time in control periods.
        keep: Share of the old effort that the lag keeps over a period.
        limits_mps2: Largest traction, largest service brake, and resistance with gradient; they hold over
            the prediction, which is far shorter than they take to change.
        jerk_mps3: Jerk limit.
        dt: Control period, s.
    """
    x, v, a, share = motion
    traction, brake, drag = limits_mps2
    room = jerk_mps3 * dt
    for k in range(math.ceil(delay_steps)):
        # The command given now is not known yet: where a part of it acts already, the newest stands for it.
        acting = acting_command(commands, max(delay_steps - 1 - k, 0.0))
        share = acting + (share - acting) * keep
        wanted = share * (traction if share > 0.0 else brake) - drag
        a = min(max(wanted, a - room), a + room)
        a = max(a, 0.0) if v <= 0.0 else a
        after = max(v + a * dt, 0.0)
        x, v = x + 0.5 * (v + after) * dt, after
    return Motion(x, v, a, share)


def lead_command(share: float, acting: float, keep: float, lead: float = LAG_LEAD) -> float:
    """The command that makes up for part of the trainset's lag, in [-1, 1].

    Args:
        share: Command that should act.
        acting: Command after delay and lag in the period before.
        keep: Share of it that the lag keeps over a period.
        lead: How much of the lag to make up for, in [0, 1].
    """
    kept = lead * keep
    return min(max((share - kept * acting) / (1.0 - kept), -1.0), 1.0)
