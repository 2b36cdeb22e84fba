"""Headroom below protection's curves, and the largest command that protection admits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.control.prediction import Model, PredictedState
from metropilot.physics import Command
from metropilot.planning import limit_at
from metropilot.protection import (
    Bounds,
    Memory,
    Protection,
    permitted_before_service,
    permitted_speed,
    supervise,
)

CLEARING_STEPS = 7
"""Bisection steps for the largest admissible command; the last interval is 2 / 2^7."""
CATCH_PER_S = 1.0
"""Deceleration for each m/s above the headroom."""


class Headroom(NamedTuple):
    """Largest speed and acceleration without an intervention of protection.

    Attributes:
        position_m: Uniform grid of 1 m from the origin. Shape (G,).
        speed_mps: Largest speed that may be held. Shape (G,).
        reaction_s: Time for which protection assumes that an acceleration continues, s.
        quadratic: Coefficient of the further gain of speed while it decays, s^3/m.
        late_s: Largest dead time and lag of a service command, s.
    """

    position_m: Float[ndarray, " grid"]
    speed_mps: Float[ndarray, " grid"]
    reaction_s: float
    quadratic: float
    late_s: float

    def approach(self, ahead: PredictedState) -> float:
        """Largest acceleration that stays below the ceiling, m/s^2: ``a r + q a^2 <= room``."""
        room = float(np.interp(ahead.position_m, self.position_m, self.speed_mps)) - ahead.speed_mps
        if room < 0:
            return CATCH_PER_S * room
        r, q = self.reaction_s, self.quadratic
        return 2.0 * room / (r + math.sqrt(r * r + 4.0 * q * room))


def headroom_of(model: Model, guard: Protection, bounds: Bounds, margin_mps: float) -> Headroom:
    """Headroom of a section under its protection.

    Args:
        model: Nominal trainset and section.
        guard: Protection of this section.
        bounds: Bounds on the plant that were declared to protection.
        margin_mps: Margin below the permitted speed; the error of one measurement is added.
    """
    rates, late = guard.rates, bounds.delay_s + bounds.lag_s
    at = np.arange(0.0, float(model.track.length_m) + 1.0, 1.0)
    cap = np.minimum(permitted_speed(guard, at), limit_at(model.track, at))
    if late > 0.0:
        cap = np.minimum(cap, permitted_before_service(guard, model.track, at))
    ratio = float(rates.mass_high / rates.mass_low)
    jerk = min(float(model.vehicle.jerk_mps3), 1e6)
    return Headroom(
        position_m=at,
        speed_mps=np.maximum(cap - margin_mps - float(rates.speed_error_mps), 0.5),
        reaction_s=ratio * (float(rates.reaction_s) + late),
        quadratic=0.5 * ratio**2 / float(rates.jerk_mps3) + 0.5 / jerk,
        late_s=late,
    )


def largest_admissible_command(
    guard: Protection, watched: Memory, position_m: float, speed_mps: float, share: float
) -> tuple[float, Memory]:
    """Largest command up to ``share`` that protection admits, and the memory of protection after it.

    Args:
        guard: Protection of the section.
        watched: Memory of protection.
        position_m: Position.
        speed_mps: Measured speed.
        share: Wanted command in [-1, 1].
    """
    seen = position_m, speed_mps
    _, after, verdict = supervise(guard, watched, *seen, Command(share, False))
    if int(verdict.level) == 0:
        return share, after
    low, high = -1.0, share
    for _ in range(CLEARING_STEPS):
        middle = 0.5 * (low + high)
        _, _, verdict = supervise(guard, watched, *seen, Command(middle, False))
        low, high = (middle, high) if int(verdict.level) == 0 else (low, middle)
    _, after, _ = supervise(guard, watched, *seen, Command(low, False))
    return low, after
