"""Speed control under a ceiling: reach a speed, hold it, and slow down in time for lower permitted speeds.

The ceiling is protection's permitted-speed curve less a margin. A driver that still accelerates stays further
below it, so that protection does not intervene.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._typing import Flag, Float, Scalar
from metropilot.control.estimator import StateEstimate, look_along
from metropilot.control.prediction import Model, PredictedState
from metropilot.control.stopping import AT_ONCE_MPS3, StopCurve, required_with_build_up, start_on_fall
from metropilot.physics import Command, least_between, namespace, repeat, track_arrays, vehicle_arrays
from metropilot.planning import limit_at
from metropilot.protection import (
    Memory,
    Protection,
    admits_braking,
    asks_for_less,
    guarantees_less,
    on_grid,
    periods_in_effect,
    permitted_before_end,
    permitted_before_service,
    permitted_speed,
    protect,
    supervise,
    usable_deceleration,
)
from metropilot.railway import Section
from metropilot.sim import Observation, Run, declared_bounds

CLEARING_STEPS = 7
"""Bisection steps for the largest admissible command; the last interval is 2 / 2^7."""
MARGIN_MPS = 0.15
"""Margin below the permitted speed."""
CATCH_PER_S = 1.0
"""Deceleration for each m/s above the ceiling."""
APPROACH_S = 1.25
"""Time in which a gap below the speed to hold is closed."""
LEAST_SQUARE = 1e-12
"""Least squared acceleration that a root is taken of, m^2/s^4: small enough to change no value."""
EASE_SHARE = 0.4
"""Jerk at which traction is reduced before a speed is reached, over the trainset's jerk limit."""
REACTION_S = 1.0
"""Time to change from traction to braking, without dead time and lag."""
SLOWS_SHARE, LEAST_SLOWING_MPS2 = 0.93, 0.1
"""Share of the brake that a slow-down counts on where a fall leaves less than planned; the least of it."""
SPACING_M = 1.0
"""Distance between two nodes of the ceiling."""
BEYOND_M = 100.0
"""Length of the ceiling beyond the stop, for a trainset that overshoots."""


class Ceiling(NamedTuple):
    """Largest speed and acceleration without an intervention, from the origin to beyond the stop.

    Attributes:
        guard: Protection of the section.
        position_m: Uniform grid from the origin. Shape (N,).
        speed_mps: Largest speed that may be held. Shape (N,).
        line_mps: The same for one who brakes to the stop at a usable deceleration, and so need not hold a
            speed under the end of the movement authority. Shape (N,).
        reaction_s: Time for which protection assumes that an acceleration continues, s.
        quadratic: Coefficient of the further gain of speed while it decays, s^3/m.
        late_s: Largest dead time and lag of a service command, s.
        lag_s: The lag alone, s.
        weak: True if a weaker brake than the service brake is guaranteed; it builds up slowly.
    """

    guard: Protection
    position_m: Float[ndarray, " nodes"]
    speed_mps: Float[ndarray, " nodes"]
    line_mps: Float[ndarray, " nodes"]
    reaction_s: float
    quadratic: float
    late_s: float
    lag_s: float
    weak: bool

    @property
    def look_s(self) -> float:
        """Time ahead within which traction must respect lower permitted speeds, s."""
        rates = self.guard.rates
        built_s = float(rates.brake_mps2 / rates.jerk_mps3) if self.weak else 0.0
        return REACTION_S + self.late_s + built_s

    def at(self, position_m: float, way_m: float = 0.0) -> float:
        """Lowest ceiling from a position over a short distance, m/s."""
        first = min(max(int(position_m / SPACING_M), 0), self.position_m.size - 2)
        last = min(int((position_m + way_m) / SPACING_M) + 2, self.position_m.size)
        return float(least_between(self.speed_mps, first, last))

    def acceleration_under(self, room_mps: float, steeper_mps2: float = 0.0) -> float:
        """Largest acceleration at a distance below the ceiling, m/s^2; negative above the ceiling.

        It solves ``a r + q a^2 = room``: the inverse of :func:`metropilot.protection.approach_margin`,
        with late commands and the trainset's own jerk limit.

        Args:
            room_mps: Distance below the ceiling.
            steeper_mps2: Pull that protection reckons with beyond that of the gradient here. The ceiling
                holds ``q e^2`` of it already, and ``q ((a + e)^2 - e^2)`` is left for the acceleration.
        """
        if room_mps < 0:
            return CATCH_PER_S * room_mps
        r, q = self.reaction_s + 2.0 * self.quadratic * steeper_mps2, self.quadratic
        return 2.0 * room_mps / (r + math.sqrt(r * r + 4.0 * q * room_mps))

    def steeper_mps2(self, position_m: float, gradient_mps2: float) -> float:
        """Pull that protection reckons with at a position beyond that of the gradient there, m/s^2."""
        node, _ = on_grid(self.guard, np.float64(position_m))
        return max(float(self.guard.pull_mps2[int(node)]) + gradient_mps2, 0.0)

    def approach(self, ahead: PredictedState) -> float:
        """Largest acceleration at a predicted state, m/s^2."""
        here_mps = float(np.interp(ahead.position_m, self.position_m, self.speed_mps))
        return self.acceleration_under(here_mps - ahead.speed_mps)


def model_of(run: Run, section: Section) -> Model:
    """Nominal model of a run's trainset and of a section, for the control laws.

    Its largest deceleration is one that protection leaves to a driver
    (:func:`metropilot.protection.usable_deceleration`).
    """
    trainset = run.disturbance.nominal(run.trainset)
    vehicle, most = vehicle_arrays(trainset), usable_deceleration(section, trainset, declared_bounds(run))
    vehicle = vehicle._replace(max_deceleration_mps2=np.float64(most))
    return Model(vehicle, track_arrays(section, trainset), run.dt)


def ceiling_of(run: Run, section: Section, margin_mps: float = MARGIN_MPS) -> Ceiling:
    """Ceiling of a section under the protection that supervises the run.

    Protection uses each measured speed without a filter, so the largest error of one measurement adds to the
    margin. Where commands act late, or protection's service brake is weaker than the trainset's, the ceiling
    leaves time for that brake, and where less than that is guaranteed, for the guaranteed brake before the
    end of the movement authority too.

    Args:
        run: The run.
        section: The section with every restriction announced so far.
        margin_mps: Margin below the permitted speed.
    """
    model, bounds = model_of(run, section), declared_bounds(run)
    trainset = run.disturbance.nominal(run.trainset)
    guard, weak = protect(section, trainset, bounds), guarantees_less(trainset, bounds)
    rates, late = guard.rates, bounds.delay_s + bounds.lag_s
    at = np.arange(0.0, section.length_m + BEYOND_M, SPACING_M)
    cap = np.minimum(permitted_speed(guard, at), limit_at(model.track, at))
    if late > 0.0 or weak or asks_for_less(trainset):
        cap = np.minimum(cap, permitted_before_service(guard, model.track, at))
    below_mps = margin_mps + float(rates.speed_error_mps)
    line = speed = np.maximum(cap - below_mps, 0.5)
    if weak:
        speed = np.minimum(line, np.maximum(permitted_before_end(guard, model.track, at) - below_mps, 0.5))
    ratio = float(rates.mass_high / rates.mass_low)
    jerk = min(float(model.vehicle.jerk_mps3), 1e6)
    return Ceiling(
        guard=guard,
        position_m=at,
        speed_mps=speed,
        line_mps=line,
        reaction_s=ratio * (float(rates.reaction_s) + late),
        quadratic=0.5 * ratio**2 / float(rates.jerk_mps3) + 0.5 / jerk,
        late_s=late,
        lag_s=bounds.lag_s,
        weak=weak,
    )


def largest_admissible_command(
    guard: Protection,
    supervision: Memory,
    position_m: float,
    speed_mps: float,
    share: float,
    look: Callable[[Scalar], Float[ndarray, "2 periods"]],
) -> tuple[float, Memory]:
    """Largest command up to ``share`` that protection admits, and the memory of protection after it.

    A late command counts as long as it is on its way. One that is admitted now but would not let full braking
    pass on that way is too large. Where full braking now would hardly pass, or not at all, it is the
    command: anything less only brings the intervention nearer.

    Args:
        guard: Protection of the section.
        supervision: Memory of protection.
        position_m: Position.
        speed_mps: Measured speed.
        share: Wanted command in [-1, 1].
        look: Position and speed at the end of each period in which a command may still be on its way
            (:func:`look_along`).
    """

    def decide(command: Scalar) -> tuple[Memory, Flag]:
        _, after, verdict = supervise(guard, supervision, position_m, speed_mps, Command(command, False))
        return after, int(verdict.level) == 0

    def admits(command: Scalar, after: Memory) -> Flag:
        return admits_braking(guard, after, *look(command))

    after, passes = decide(share)
    if passes and admits(share, after):
        return share, after
    least, _ = decide(-1.0)
    if admits(-1.0, least):
        return _largest_between(decide, admits, share, least)
    return -1.0, least


def ask_protection(
    guard: Protection,
    supervision: Memory,
    model: Model,
    estimate: StateEstimate,
    observation: Observation,
    share: Scalar,
) -> tuple[float, Memory]:
    """Largest command that protection admits on the way as estimated, and the memory of protection after it.

    A trainset that stands short of its stop on a fall is started, whatever is wanted.

    Args:
        guard: Protection of the section.
        supervision: Memory of protection kept alongside.
        model: Nominal trainset and section.
        estimate: State and plant as estimated.
        observation: Measurements of this period.
        share: Wanted command in [-1, 1].
    """
    seen = observation.position_m, observation.speed_mps
    share = start_on_fall(model, *seen, share)
    look = look_along(model, estimate, periods_in_effect(guard, supervision))
    return largest_admissible_command(guard, supervision, *seen, share, look)


def _largest_between(
    decide: Callable[[Scalar], tuple[Memory, Flag]],
    admits: Callable[[Scalar, Memory], Flag],
    share: Scalar,
    least: Memory,
) -> tuple[Scalar, Memory]:
    """Largest command under ``share`` that passes, by halving from full braking, and what follows it."""
    found, _, after = repeat(CLEARING_STEPS, partial(_halve, decide, admits), -1.0, share, least)
    return found, after


def _halve(
    decide: Callable[[Scalar], tuple[Memory, Flag]],
    admits: Callable[[Scalar, Memory], Flag],
    low: Scalar,
    high: Scalar,
    least: Memory,
) -> tuple[Scalar, Scalar, Memory]:
    """One step of it: the largest that passed, the least that did not, and what follows the former."""
    middle = 0.5 * (low + high)
    after, passes = decide(middle)
    return (middle, high, after) if passes and admits(middle, after) else (low, middle, least)


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
        # on a fall the brake holds back less than a stop is planned with
        gives = max(SLOWS_SHARE * ahead.brake_mps2 + ahead.gradient_mps2, LEAST_SLOWING_MPS2)
        # a slow-down that has begun (below -0.1 m/s^2) goes on, so that the brake is not applied twice
        if required >= min(curve.deceleration_mps2, gives) or falling > 0.0 or ahead.acceleration_mps2 < -0.1:
            most = float(model.vehicle.max_deceleration_mps2)
            wanted = min(wanted, -min(required, (v - lower) / model.dt, most))
    return wanted


def traction_limit(estimate: StateEstimate, ahead: PredictedState, ceiling: Ceiling) -> float:
    """Largest traction command that protection admits now and when the command begins to act.

    Protection evaluates a command with the nominal trainset and the lightest admissible one, without dead
    time; a command that holds the speed is always admitted.

    Args:
        estimate: State and plant as estimated.
        ahead: The state when the command begins to act.
        ceiling: Speed ceiling.
    """
    drag = ahead.resistance_mps2 + ahead.gradient_mps2
    here_mps = ceiling.at(estimate.position_m, ceiling.look_s * estimate.speed_mps)
    steeper = ceiling.steeper_mps2(estimate.position_m, ahead.gradient_mps2) if ceiling.weak else 0.0
    here = ceiling.acceleration_under(here_mps - estimate.speed_mps, steeper)
    there_mps = ceiling.at(ahead.position_m, ceiling.look_s * ahead.speed_mps)
    there = ceiling.acceleration_under(there_mps - ahead.speed_mps, steeper)
    nominal_mps2 = ahead.traction_mps2 / estimate.traction_gain
    hold = drag / ahead.traction_mps2 if ahead.speed_mps <= there_mps else 0.0
    return min(max((min(here, there) + drag) / nominal_mps2, hold, 0.0), 1.0)


def lowest_ahead(ahead: PredictedState, ceiling: Ceiling, curve: StopCurve) -> tuple[float, float] | None:
    """Distance, m, and speed, m/s, of the point ahead that requires the hardest braking; None: none soon."""
    x, v, b = ahead.position_m, ahead.speed_mps, curve.deceleration_mps2
    jerk = curve.build_jerk_mps3
    build_m = v * max(b + min(ahead.acceleration_mps2, b), 0.0) / (2.0 * jerk) if math.isfinite(jerk) else 0.0
    first = int(x / SPACING_M) + 1
    last = first + int((v * v / (2.0 * b) + 3.0 * v) / SPACING_M) + 2
    lower, at = ceiling.line_mps[first:last], ceiling.position_m[first:last]
    release_m = lower * b / (2.0 * jerk) if math.isfinite(jerk) else 0.0
    needed = (v * v - lower * lower) / (2.0 * np.maximum(at - x - build_m - release_m, 0.5))
    # a point that needs less than half of the planned deceleration is too far away to act on
    if needed.size == 0 or needed.max() < 0.5 * b:
        return None
    k = int(np.argmax(needed))
    return float(at[k]) - x, float(lower[k])


def approach(model: Model, speed_mps: float, target_mps: float) -> float:
    """Acceleration toward a speed, at most the service limit, m/s^2."""
    missing = target_mps - speed_mps
    if missing < 0:
        return max(missing / APPROACH_S, -1.0)
    rise = closing_acceleration(missing, APPROACH_S, float(model.vehicle.jerk_mps3))
    return min(float(model.vehicle.max_acceleration_mps2), rise)


@no_type_check
def closing_acceleration(gap_mps: Scalar, time_s: Scalar, jerk_mps3: Scalar) -> Scalar:
    """Largest acceleration that closes a gap in speed in a time and within the jerk limit, m/s^2.

    Args:
        gap_mps: Speed to reach over the speed now, at least 0.
        time_s: Time in which a constant acceleration would close it.
        jerk_mps3: The trainset's jerk limit.
    """
    xp = namespace(gap_mps, time_s, jerk_mps3)
    jerk = xp.minimum(jerk_mps3, AT_ONCE_MPS3)
    # no root of 0, whose slope is infinite: a learner's gradient would end where the gap is closed
    square = xp.maximum(2.0 * EASE_SHARE * jerk * gap_mps, LEAST_SQUARE)
    return xp.minimum(gap_mps / time_s, xp.sqrt(square))
