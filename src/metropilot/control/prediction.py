"""Prediction over dead time, lag and jerk limit: the state when a command given now begins to act.

All drivers compensate the actuation with it (Huang25 eq. 4, Chen23a eq. 1). Where a dead time is no whole
number of periods, the plant blends two commands in each: a command acts with one part in a first period and
with the rest in the second. It is meant for a period that begins when the dead time is over, in the midst of
the first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Scalar
from metropilot.physics import Track, Vehicle, command_for_effort, kept_share, namespace, scalars

ALMOST = 1e-5
"""A dead time this much below a whole number of periods counts as whole."""
ROOTS = 8
"""Binary places of a part of a period, for the power of a number."""
LAG_LEAD = 0.7
"""Share of the lag that is compensated by a larger command; full compensation would amplify noise."""


@no_type_check
def whole_periods(delay_steps: Scalar) -> tuple[Scalar, Scalar]:
    """Split a dead time into whole periods and the part of another, in control periods.

    Args:
        delay_steps: Dead time in control periods.
    """
    # 0.14 / 0.02 is a little more or less than 7
    xp = namespace(delay_steps)
    near = delay_steps + ALMOST
    whole = math.floor(near) if xp is scalars else xp.floor(near)
    return whole, xp.maximum(delay_steps - whole, 0.0)


@no_type_check
def kept_over(keep: Scalar, part: Scalar) -> Scalar:
    """Share of an old effort that remains after a part of a period of lag: ``keep ** part``.

    Square roots give it, to 1 % where a hundredth remains after the period: a controller has nothing else.

    Args:
        keep: Share that remains after a whole period.
        part: Part of a period, in [0, 1).
    """
    xp = namespace(keep, part)
    kept, root = 1.0, keep
    for _ in range(ROOTS):
        root, part = xp.sqrt(root), 2.0 * part
        counts = part >= 1.0
        kept, part = xp.where(counts, kept * root, kept), xp.where(counts, part - 1.0, part)
    return kept


class Model(NamedTuple):
    """Nominal model of trainset and section in a driver.

    Attributes:
        vehicle: Nominal plant (NumPy).
        track: The section.
        dt: Control period, s.
    """

    vehicle: Vehicle
    track: Track
    dt: float


class PredictedState(NamedTuple):
    """Predicted state when a command given now begins to act.

    Attributes:
        seconds: Time from now, s.
        position_m: Position.
        speed_mps: Speed.
        acceleration_mps2: Acceleration in the period before.
        share: Command after delay and lag in the period before.
        keep: Share of the old effort that remains after a period of lag.
        resistance_mps2: Estimated resistance there, per effective mass, factor included.
        gradient_mps2: Gradient force there, per effective mass, positive uphill.
        traction_mps2: Largest traction there, per effective mass, gain included.
        brake_mps2: Largest service brake there, per effective mass, gain included.
    """

    seconds: Scalar
    position_m: Scalar
    speed_mps: Scalar
    acceleration_mps2: Scalar
    share: Scalar
    keep: Scalar
    resistance_mps2: Scalar
    gradient_mps2: Scalar
    traction_mps2: Scalar
    brake_mps2: Scalar

    def command_for(self, effort_mps2: Scalar, lead: float = LAG_LEAD) -> Scalar:
        """Command for a wheel effort per effective mass at the moment when it begins to act, in [-1, 1].

        Args:
            effort_mps2: Effort, traction positive.
            lead: Share of the lag that is compensated by a larger command, in [0, 1].
        """
        return self.lead(command_for_effort(effort_mps2, self.traction_mps2, self.brake_mps2), lead)

    def share_for(self, wanted_mps2: Scalar, lead: float = LAG_LEAD) -> Scalar:
        """Command for an acceleration at that moment, in [-1, 1].

        Args:
            wanted_mps2: Wanted acceleration.
            lead: Share of the lag that is compensated by a larger command, in [0, 1].
        """
        return self.command_for(wanted_mps2 + self.resistance_mps2 + self.gradient_mps2, lead)

    @no_type_check
    def lead(self, share: Scalar, lead: float = LAG_LEAD) -> Scalar:
        """Command that compensates part of the lag, in [-1, 1].

        Args:
            share: Command that should act.
            lead: Share of the lag that is compensated, in [0, 1].
        """
        kept = lead * self.keep
        acting = (share - kept * self.share) / (1.0 - kept)
        xp = namespace(acting)
        return xp.minimum(xp.maximum(acting, -1.0), 1.0)


class Motion(NamedTuple):
    """Position, speed, acceleration of the last period, and the command that acted in it."""

    position_m: Scalar
    speed_mps: Scalar
    acceleration_mps2: Scalar
    share: Scalar


class CommandActuation(NamedTuple):
    """Commands in the pipeline of a known dead time and lag.

    Attributes:
        commands: Commands given, newest first: those not yet acting and one more.
        share: Command after dead time and lag in the last period.
        delay_steps: Dead time in control periods, not always whole.
        keep: Share of the old effort that remains after a period of lag.
        lag_s: Time constant of the lag.
        dt: Control period, s.
    """

    commands: Sequence[float]
    share: float
    delay_steps: float
    keep: float
    lag_s: float
    dt: float

    @property
    def seconds(self) -> float:
        """Time until a command given now begins to act, s."""
        return self.delay_steps * self.dt

    def issue(self, command: float) -> CommandActuation:
        """Add a command for the coming period."""
        commands = (command, *self.commands[:-1])
        acting = acting_command(commands, self.delay_steps)
        return self._replace(commands=commands, share=acting + (self.share - acting) * self.keep)


def actuation_of(model: Model) -> CommandActuation:
    """Actuation of a nominal trainset with an empty pipeline."""
    dt, lag = model.dt, float(model.vehicle.lag_s)
    steps = round(float(model.vehicle.delay_s) / dt, 6)
    keep = float(kept_share(lag, dt))
    return CommandActuation((0.0,) * (math.ceil(steps) + 1), 0.0, steps, keep, lag, dt)


@no_type_check
def acting_command(commands: Sequence[Scalar], age: Scalar) -> Scalar:
    """Command issued a number of periods ago, blended between two as in the plant.

    Args:
        commands: Newest first.
        age: Periods, one number or an array of them.
    """
    xp = namespace(age)
    floor = int(age) if xp is scalars else xp.floor(age)
    whole, part = floor if xp is scalars else floor.astype(np.int32), age - floor
    if xp is not scalars and isinstance(commands, list | tuple):
        commands = xp.stack(commands)
    older = commands[xp.minimum(whole + 1, len(commands) - 1)]
    return commands[whole] * (1.0 - part) + older * part


@no_type_check
def predict_motion(
    motion: Motion,
    commands: Sequence[Scalar],
    delay_steps: Scalar,
    keep: Scalar,
    limits_mps2: tuple[Scalar, Scalar, Scalar],
    jerk_mps3: Scalar,
    dt: Scalar,
) -> Motion:
    """Predict the motion when a command given now begins to act.

    Args:
        motion: The motion now.
        commands: Commands given, newest first; in a compiled program as many as the dead time takes, and one.
        delay_steps: Dead time in control periods.
        keep: Share of the old effort that remains after a period of lag.
        limits_mps2: Largest traction, largest service brake, and resistance with gradient; constant over the
            prediction, which is short.
        jerk_mps3: Jerk limit.
        dt: Control period, s.
    """
    xp = namespace(motion.speed_mps, delay_steps, limits_mps2[0])
    single = namespace(delay_steps) is scalars
    first, (before, part) = commands[0], whole_periods(delay_steps)
    # The command given now acts in none of these periods; any number serves in its place.
    given = [first, *commands] if single else xp.concatenate([xp.expand_dims(first, 0), commands])
    for k in range(before if single else commands.shape[0] - 1):
        acting = acting_command(given, xp.maximum(delay_steps - k, 0.0))
        later = _move(motion, acting, keep, limits_mps2, jerk_mps3, dt)
        if not single:
            # A compiled program predicts as many periods for all trainsets.
            later = Motion(*(xp.where(k < before, new, old) for new, old in zip(later, motion, strict=True)))
        motion = later
    if single and part <= 0.0:
        return motion
    later = _move(motion, first, kept_over(keep, part), limits_mps2, jerk_mps3, part * dt)
    # a part of nothing leaves all as it is, the acceleration too
    return Motion(*(xp.where(part > 0.0, new, old) for new, old in zip(later, motion, strict=True)))


def predict_path(
    motion: Motion,
    commands: Sequence[float],
    delay_steps: float,
    keep: float,
    limits_mps2: tuple[float, float],
    drags_mps2: Sequence[float],
    jerk_mps3: float,
    dt: float,
) -> Float[ndarray, "2 periods"]:
    """Predict positions, m, and speeds, m/s, at the end of each coming period.

    Args:
        motion: The motion now.
        commands: Commands given, newest first; the newest is the one of the first period.
        delay_steps: Dead time in control periods.
        keep: Share of the old effort that remains after a period of lag.
        limits_mps2: Largest traction and largest service brake, constant over the prediction.
        drags_mps2: Resistance with gradient in each period, where the trainset will be.
        jerk_mps3: Jerk limit.
        dt: Control period, s.
    """
    path = []
    for k, drag in enumerate(drags_mps2):
        acting = acting_command(commands, max(delay_steps - k, 0.0))
        motion = _move(motion, acting, keep, (*limits_mps2, drag), jerk_mps3, dt)
        path.append((motion.position_m, motion.speed_mps))
    xp = namespace(motion.speed_mps)
    return (np if xp is scalars else xp).array(path).transpose()


@no_type_check
def _move(
    motion: Motion,
    acting: Scalar,
    keep: Scalar,
    limits_mps2: tuple[Scalar, Scalar, Scalar],
    jerk_mps3: Scalar,
    dt: Scalar,
) -> Motion:
    """Predict the motion after a period in which a command acts."""
    x, v, a, share = motion
    traction, brake, drag = limits_mps2
    xp = namespace(v, acting, traction)
    room = jerk_mps3 * dt
    later = acting + (share - acting) * keep
    wanted = later * xp.where(later > 0.0, traction, brake) - drag
    then = xp.minimum(xp.maximum(wanted, a - room), a + room)
    then = xp.where(v <= 0.0, xp.maximum(then, 0.0), then)
    after = xp.maximum(v + then * dt, 0.0)
    return Motion(x + 0.5 * (v + after) * dt, after, then, later)
