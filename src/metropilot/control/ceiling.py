"""Speed control under a ceiling: reach a speed, hold it, and slow down in time for lower permitted speeds.

The ceiling is protection's permitted-speed curve less a margin. A driver that still accelerates stays further
below it, so that protection does not intervene.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.control.estimator import StateEstimate
from metropilot.control.prediction import Model, PredictedState
from metropilot.control.stopping import StopCurve, required_with_build_up
from metropilot.physics import Command, track_arrays, vehicle_arrays
from metropilot.planning import limit_at
from metropilot.protection import (
    Bounds,
    Memory,
    Protection,
    approach_margin,
    permitted_before_service,
    permitted_speed,
    protect,
    supervise,
)
from metropilot.railway import Section
from metropilot.sim import Run, declared_bounds

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


MARGIN_MPS = 0.15
"""Margin below the permitted speed."""
APPROACH_PER_S = 0.8
"""Acceleration for each m/s below the speed to hold."""
EASE_SHARE = 0.4
"""Jerk at which traction is reduced before the speed is reached, over the trainset's jerk limit."""
REACTION_S = 1.0
"""Time to change from traction to braking, without dead time and lag."""
SPACING_M = 2.0
"""Distance between two nodes of the ceiling."""
BEYOND_M = 100.0
"""Length of the ceiling beyond the stop, for a trainset that overshoots."""
ACCELERATIONS_MPS2 = np.linspace(0.0, 1.5, 16)
"""Accelerations for which protection's approach margin is tabulated."""


class Ceiling(NamedTuple):
    """Speed ceiling on a uniform grid from the origin to beyond the stop.

    Attributes:
        position_m: Grid. Shape (N,).
        speed_mps: Permitted speed less the margin. Shape (N,).
        room_mps: Least distance below the permitted speed for each acceleration. Shape (A,).
        reaction_s: Time ahead within which traction must respect lower permitted speeds, s.
    """

    position_m: Float[ndarray, " nodes"]
    speed_mps: Float[ndarray, " nodes"]
    room_mps: Float[ndarray, " accelerations"]
    reaction_s: float

    def at(self, position_m: float, way_m: float = 0.0) -> float:
        """Lowest ceiling from a position over a short distance, m/s."""
        first = min(max(int(position_m / SPACING_M), 0), self.position_m.size - 2)
        last = min(int((position_m + way_m) / SPACING_M) + 2, self.position_m.size)
        return float(self.speed_mps[first:last].min())

    def acceleration_under(self, missing_mps: float) -> float:
        """Largest acceleration at a speed below the ceiling: the inverse of protection's approach margin."""
        return float(np.interp(missing_mps, self.room_mps, ACCELERATIONS_MPS2))


def model_of(run: Run, section: Section) -> Model:
    """Nominal model of a run's trainset and of a section, for the control laws."""
    trainset = run.disturbance.nominal(run.trainset)
    return Model(vehicle_arrays(trainset), track_arrays(section, trainset), run.dt)


def ceiling_of(run: Run, section: Section, margin_mps: float = MARGIN_MPS) -> Ceiling:
    """Ceiling of a section under the protection that supervises the run.

    Protection uses each measured speed without a filter, so the largest error of one measurement adds to the
    margin.

    Args:
        run: The run.
        section: The section with every restriction announced so far.
        margin_mps: Margin below the permitted speed.
    """
    bounds = declared_bounds(run)
    protection = protect(section, run.disturbance.nominal(run.trainset), bounds)
    margin = margin_mps + bounds.speed_error_mps
    at = np.arange(0.0, section.length_m + BEYOND_M, SPACING_M)
    return Ceiling(
        position_m=at,
        speed_mps=np.maximum(np.asarray(permitted_speed(protection, at)) - margin, 0.5),
        room_mps=np.asarray(approach_margin(protection, ACCELERATIONS_MPS2)),
        reaction_s=REACTION_S + bounds.delay_s + bounds.lag_s,
    )


def ceiling_acceleration(
    model: Model, ahead: PredictedState, ceiling: Ceiling, cruise_mps: float, curve: StopCurve
) -> float:
    """Acceleration toward the cruising speed or the ceiling, within the comfort limits.

    Args:
        model: Nominal trainset and section.
        ahead: The state when the command begins to act.
        ceiling: Speed ceiling.
        cruise_mps: Speed to hold where the ceiling is higher.
        curve: Deceleration and jerk of a slow-down.

    Returns:
        Wanted acceleration, m/s^2.
    """
    x, v = ahead.position_m, ahead.speed_mps
    cap = ceiling.at(x, v * model.dt)
    wanted = approach(model, v, min(cap, cruise_mps))
    slowing = curve._replace(end_mps2=0.0)
    found = lowest_ahead(ahead, ceiling, slowing)
    if found is not None:
        distance, lower = found
        required, falling = required_with_build_up(v, ahead.acceleration_mps2, distance, slowing, lower)
        # a slow-down that has begun (below -0.1 m/s^2) goes on, so that the brake is not applied twice
        if required >= curve.deceleration_mps2 or falling > 0.0 or ahead.acceleration_mps2 < -0.1:
            most = float(model.vehicle.max_deceleration_mps2)
            wanted = min(wanted, -min(required, (v - lower) / model.dt, most))
    return wanted


def traction_limit(belief: StateEstimate, ahead: PredictedState, ceiling: Ceiling) -> float:
    """Largest traction command that protection admits now and when the command begins to act.

    Protection evaluates a command with the nominal trainset and the lightest admissible one, without dead
    time; a command that holds the speed is always admitted.

    Args:
        belief: The estimate.
        ahead: The state when the command begins to act.
        ceiling: Speed ceiling.
    """
    drag = ahead.resistance_mps2 + ahead.gradient_mps2
    here_mps = ceiling.at(belief.position_m, ceiling.reaction_s * belief.speed_mps)
    here = ceiling.acceleration_under(here_mps - belief.speed_mps)
    there_mps = ceiling.at(ahead.position_m, ceiling.reaction_s * ahead.speed_mps)
    there = ceiling.acceleration_under(there_mps - ahead.speed_mps)
    believed = ahead.traction_mps2 / belief.traction_gain
    hold = drag / ahead.traction_mps2 if ahead.speed_mps <= there_mps else 0.0
    return min(max((min(here, there) + drag) / believed, hold, 0.0), 1.0)


def lowest_ahead(ahead: PredictedState, ceiling: Ceiling, curve: StopCurve) -> tuple[float, float] | None:
    """Distance, m, and speed, m/s, of the point ahead that requires the hardest braking; None: none soon."""
    x, v, b = ahead.position_m, ahead.speed_mps, curve.deceleration_mps2
    jerk = curve.build_jerk_mps3
    build_m = v * max(b + min(ahead.acceleration_mps2, b), 0.0) / (2.0 * jerk) if math.isfinite(jerk) else 0.0
    first = int(x / SPACING_M) + 1
    last = first + int((v * v / (2.0 * b) + 3.0 * v) / SPACING_M) + 2
    lower, at = ceiling.speed_mps[first:last], ceiling.position_m[first:last]
    release_m = lower * b / (2.0 * jerk) if math.isfinite(jerk) else 0.0
    needed = (v * v - lower * lower) / (2.0 * np.maximum(at - x - build_m - release_m, 0.5))
    # a point that needs less than half of the planned deceleration is too far away to act on
    if needed.size == 0 or needed.max() < 0.5 * b:
        return None
    k = int(np.argmax(needed))
    return float(at[k]) - x, float(lower[k])


def approach(model: Model, speed_mps: float, target_mps: float) -> float:
    """Acceleration toward a speed, reduced in time for the jerk limit, at most the service limit, m/s^2."""
    missing = target_mps - speed_mps
    if missing < 0:
        return max(APPROACH_PER_S * missing, -1.0)
    jerk = EASE_SHARE * float(model.vehicle.jerk_mps3)
    eased = math.sqrt(2.0 * jerk * missing) if math.isfinite(jerk) else math.inf
    return min(float(model.vehicle.max_acceleration_mps2), APPROACH_PER_S * missing, eased)
