"""Station stop: braking point, deceleration, and release of the brake within the jerk limit.

The curve builds up a deceleration ``b`` at the jerk limit, holds it, and releases it at a lower jerk ``J`` to
a small deceleration ``e`` at standstill. Every period computes the deceleration with which this curve ends at
the target, from the state predicted for the moment when the command begins to act. (Without a jerk limit this
is ``b = v^2 / (2 S)``, the rule of the heuristic online algorithm of Chen, Chen, Li and Tang, 2013.) The law
has no integrator and no memory: an earlier error is an error in distance, which the next period corrects.
The gain of the brake comes from the estimator.

Closed forms, with distance ``S``, speed ``v`` and final speed ``f``:

* release only: deceleration falls from ``a`` to ``e`` in ``T``: ``v - f = (a+e)T/2``,
  ``S = f T + T^2 (a/6 + e/3)``; so ``e T^2 + 2 (v + 2 f) T - 6 S = 0`` gives ``T``, and ``a = 2(v-f)/T - e``.
* hold ``b``, then release at ``J``: ``T = (b-e)/J``, ``v_T = f + (b^2-e^2)/(2J)``,
  ``S = (v^2 - v_T^2)/(2b) + f T + T^2 (b/6 + e/3)``, which falls as ``b`` grows while ``v >= v_T``.

The law is written over the array namespace (:func:`metropilot.physics.arrays.namespace`): host drivers, the
assists of a learning task and the closed loop of the imitation learner use the same functions and differ in
their :class:`StopOptions`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._typing import Flag, Float, Scalar
from metropilot.control.estimator import StateEstimate
from metropilot.control.prediction import Model, PredictedState, whole_periods
from metropilot.physics import Track, Vehicle, effort_at, namespace, repeat, resistance_and_gradient, scalars

SERVICE_USE = 0.95
"""Share of the available deceleration with which a comfortable stop is planned."""
AT_ONCE_MPS3 = 1e4
"""Jerk limit from which on there is none; it replaces an infinite one where arithmetic needs a number."""
STRONGEST_MPS2 = 3.0
"""Deceleration larger than that of any brake, for a target that is too near to stop at."""
SLOW_SHARE = 0.5
"""A trainset is drawn up only where this share of the planned deceleration would stop it at the mark."""
LEAST_MPS2 = 0.05
"""Least deceleration that is solved for; a stop never begins with less."""
WATCHED_SHARE = 0.5
"""Below this share of the planned deceleration, or of what the brake gives there, the stop is not near enough
to ask what the brake can give."""
SOFT_SHARE = 0.8
"""Deceleration with which a gentle stop ends, over what the jerk limit lets drop in one period..."""
SOFT_S = 1.5
"""...from this time before the stand on."""
LAG_SOFT_M, SOFT_DROP_MPS2 = 0.04, 0.064
"""Error that is accepted for a gentle end where a lag drags every correction on; less, where the deceleration
may drop by more than this in a period: then more can be corrected."""
SCARCE_GAIN = 2.5
"""Correction of a stop that needs more than the brake will give later, beyond what the stop needs..."""
SCARCE_SHARE = 0.96
"""...where that is less than this share of the planned deceleration."""
SLOW_MPS = 6.0
"""Below this speed it is asked what deceleration the jerk limit lets a trainset reach before it stands."""
FADE_POINTS = 25
"""Points at which a brake is looked at between the present speed and standstill."""
NEAREST_M = 1e-3
"""Distance below which the target is reached."""
STARTS_SHARE, STARTS_PULL_MPS2 = 0.05, 0.05
"""Least command of a trainset that leaves a stand on a fall, and the pull from which on that is one."""


@dataclass(frozen=True)
class StopOptions:
    """Constants of the station stop.

    Attributes:
        build_share: Jerk at which the brake is built up, over the trainset's jerk limit.
        release_share: Jerk at which it is released, over the same; a soft release takes longer and leaves
            more of the limit to correct errors.
        end_share: Deceleration the stop is planned to end with, over what the jerk limit lets drop in one
            period.
        drop_share: Largest deceleration in the last period, over the same; below 1, as standstill seldom
            coincides with the end of a period.
        left_share: Deceleration at the stand, over the same, beyond which a lag is compensated in full.
        return_gain: Correction of a departure from the planned deceleration, beyond what the stop needs.
        at_once_gain: The same for a trainset without a jerk limit.
        inch_m: Distance to the target below which a trainset at standstill is not moved again, m.
        push_m: Distance to the target below which no traction is applied, m.
        hold_mps2: Deceleration requested at standstill, m/s^2; the jerk limit lets it drop.
        held_share: Share of a climb that traction may bear there; the rest is for what is not known of it.
        gentle_m: Farther past the target than this the deceleration is requested in full: where more is not
            known of a climb, a trainset foreseen to stand would creep on, m.
        creep_mps: Speed below which the stop is no longer corrected within ``creep_m``, m/s.
        creep_m: Distance to the target below which a creeping trainset is stopped, m.
        past_m: Farther past the target than this it is better to stand with all the jerk limit allows, m.
        soft_m: Error that is accepted at most for a gentle end of the stop, m: under a lag a correction acts
            when the trainset stands, and jerks.
        draw_up_mps2: Acceleration toward the target from a standstill short of it, m/s^2.
        draw_up_share: Share of that acceleration; drawing up ends when a deceleration of this size would
            stop at the target.
        coasts_up: True if a trainset that coasts up to the stop is not powered to brake harder later.
        lag_ramp: True if a lag without a jerk limit shapes the curve; else its user allows for the lag.
        passes: Passes of the fixed point for the build-up; each divides the error by about four.
        newton_steps: Newton steps from the deceleration without a release; six are accurate to 1e-5 m/s^2,
            three to 0.1 where the release takes nearly the whole distance.
    """

    build_share: float = 1.0
    release_share: Scalar = 0.5
    end_share: float = 0.25
    drop_share: float = 0.6
    left_share: float = 0.95
    return_gain: float = 0.5
    at_once_gain: float = 0.5
    inch_m: float = 0.2
    push_m: float = 0.2
    hold_mps2: float = 0.1
    held_share: float = 0.85
    gentle_m: float = 0.02
    creep_mps: float = 0.06
    creep_m: float = 0.0
    past_m: float = 0.1
    soft_m: Scalar = 0.0
    draw_up_mps2: float = 0.3
    draw_up_share: float = 0.3
    coasts_up: bool = False
    lag_ramp: bool = True
    passes: int = 3
    newton_steps: int = 6


STOP_OPTIONS = StopOptions()
"""Options of drivers with an estimator: a small final deceleration leaves room for its errors."""


LAG_STOP = StopOptions(soft_m=LAG_SOFT_M)
"""The same under a lag: the stop ends gently."""


class StopCurve(NamedTuple):
    """Shape of a stop.

    Attributes:
        deceleration_mps2: Deceleration held.
        build_jerk_mps3: Jerk at which it is built up (infinite: at once).
        release_jerk_mps3: Jerk at which it is released (infinite: held to the stop).
        end_mps2: Deceleration left at the stop.
    """

    deceleration_mps2: Scalar
    build_jerk_mps3: Scalar
    release_jerk_mps3: Scalar
    end_mps2: Scalar


def weakest_gradient(model: Model, target_m: float) -> float:
    """Least mean gradient on the way to a stop, as an acceleration (negative downhill), m/s^2.

    Braking is an exchange of energy, so the mean from the braking point to the stop counts; it begins at most
    400 m before.

    Args:
        model: Nominal trainset and section.
        target_m: Position of the stop.
    """
    at = np.linspace(target_m, target_m - 400.0, 41)
    forces = [float(resistance_and_gradient(model.vehicle, model.track, x, np.float64(0.0))[1]) for x in at]
    means = np.cumsum(forces) / np.arange(1, at.size + 1)
    # means over at least 50 m: no stop begins to brake nearer to the target
    return float(means[5:].min()) / float(model.vehicle.effective_mass_kg)


def mean_braking_efforts(
    vehicle: Vehicle,
    speed_mps: float,
    gain: float = 1.0,
    rest_n: Float[ndarray, " points"] | float = 0.0,
    points: int = FADE_POINTS,
) -> Float[ndarray, " points"]:
    """Constant forces that stop from falling speeds over the same distance as full service braking does, N.

    Many brakes give less at high speed; a stop with all they give begins much later than one with the least
    of it. The distance is the integral of kinetic energy over force, so the mean is a harmonic one, of the
    brake and the rest together: a fall takes the larger part of a brake that has faded.

    Args:
        vehicle: Nominal plant.
        speed_mps: The highest of the speeds; the kinetic energies of the others fall evenly to zero.
        gain: Actual over nominal braking force.
        rest_n: Other decelerating forces, constant from each speed on.
        points: Number of speeds.
    """
    speeds = speed_mps * np.sqrt(np.linspace(1.0, 0.0, points))
    efforts = gain * effort_at(vehicle, speeds).brake_n
    ahead = np.triu(np.ones((points, points))) > 0.0
    forces = np.where(ahead, (rest_n + np.zeros(points))[:, None] + efforts, np.inf)
    least = forces.min(axis=1)
    # over the least force: where all are the same, so is their mean, to the last bit
    ways = (least[:, None] / np.where(forces > 0.0, forces, np.inf)).sum(axis=1)
    return np.where(least > 0.0, least * (np.arange(points, 0, -1) / np.maximum(ways, 1e-9)), least)


def comfortable_deceleration(model: Model, estimate: StateEstimate, gradient_mps2: float) -> float:
    """Deceleration for planning a stop: the surely available one, at most the trainset's limit, m/s^2.

    Args:
        model: Nominal trainset and section.
        estimate: State and plant as estimated; the gain of the brake counts less 1.5 standard deviations,
            and at most 1.
        gradient_mps2: Mean gradient from :func:`weakest_gradient`.
    """
    vehicle = model.vehicle
    mass = float(vehicle.effective_mass_kg)
    sure = min(estimate.brake_gain - 1.5 * estimate.brake_gain_sigma, 1.0)
    effort = mean_braking_efforts(vehicle, estimate.speed_mps, sure, gradient_mps2 * mass)
    return max(SERVICE_USE * min(float(effort[0]) / mass, float(vehicle.max_deceleration_mps2)), 0.2)


def curve_for(
    vehicle: Vehicle, dt: Scalar, deceleration_mps2: Scalar, options: StopOptions = STOP_OPTIONS
) -> StopCurve:
    """Stop curve for a trainset's jerk limit; ``v^2 / (2 S)`` where there is none.

    Args:
        vehicle: Nominal plant.
        dt: Control period, s.
        deceleration_mps2: Deceleration to hold.
        options: Constants of the stop.
    """
    xp = namespace(vehicle.jerk_mps3, deceleration_mps2)
    jerk = vehicle.jerk_mps3
    if options.lag_ramp:
        # Without a jerk limit the lag alone shapes build-up and release: a ramp with the same mean delay.
        lagged = deceleration_mps2 / (2.0 * xp.maximum(vehicle.lag_s, 1e-6))
        jerk = xp.where((jerk >= AT_ONCE_MPS3) & (vehicle.lag_s > 0.0), lagged, jerk)
    end = xp.minimum(options.end_share * jerk * dt, deceleration_mps2)
    return StopCurve(deceleration_mps2, options.build_share * jerk, options.release_share * jerk, end)


@no_type_check
def braking_distance(speed_mps: Scalar, curve: StopCurve, final_mps: Scalar = 0.0) -> Scalar:
    """Distance from one speed down to another: hold, then release (no build-up), m."""
    xp = namespace(speed_mps, curve.deceleration_mps2, final_mps)
    v, e = xp.maximum(speed_mps, final_mps), curve.end_mps2
    held = _attainable_deceleration(xp, v, curve, final_mps)
    return _distance(xp, v, held, e, curve.release_jerk_mps3, final_mps)


@no_type_check
def braking_time(speed_mps: Scalar, curve: StopCurve) -> Scalar:
    """Time from a speed to standstill: hold, then release (no build-up), s."""
    xp = namespace(speed_mps, curve.deceleration_mps2)
    b, e = _attainable_deceleration(xp, speed_mps, curve, 0.0), curve.end_mps2
    jerk = xp.minimum(curve.release_jerk_mps3, AT_ONCE_MPS3)
    return (speed_mps - (b * b - e * e) / (2.0 * jerk)) / b + (b - e) / jerk


@no_type_check
def _attainable_deceleration(xp: Any, v: Scalar, curve: StopCurve, final_mps: Scalar) -> Scalar:  # noqa: ANN401
    """Deceleration held: the planned one, at most what the release can reduce before the final speed."""
    e = curve.end_mps2
    jerk = xp.minimum(curve.release_jerk_mps3, AT_ONCE_MPS3)
    return xp.minimum(curve.deceleration_mps2, xp.sqrt(e * e + 2.0 * jerk * (v - final_mps)))


@no_type_check
def _distance(xp: Any, v: Scalar, b: Scalar, e: Scalar, jerk: Scalar, f: Scalar) -> Scalar:  # noqa: ANN401
    """Distance of holding ``b`` and releasing it to ``e``, from ``v`` to ``f``."""
    jerk = xp.minimum(jerk, AT_ONCE_MPS3)
    t = (b - e) / jerk
    released = f + (b * b - e * e) / (2.0 * jerk)
    return (v * v - released * released) / (2.0 * b) + f * t + t * t * (b / 6.0 + e / 3.0)


@no_type_check
def required_deceleration(
    speed_mps: Scalar,
    distance_m: Scalar,
    curve: StopCurve,
    final_mps: Scalar = 0.0,
    newton_steps: int = STOP_OPTIONS.newton_steps,
) -> tuple[Scalar, Scalar]:
    """Deceleration that must act now for the curve to end at the target, and the jerk of its release.

    The held deceleration is found by Newton's method on :func:`braking_distance`, the release in closed form.

    Args:
        speed_mps: Speed.
        distance_m: Distance to go.
        curve: Shape of the stop; its ``deceleration_mps2`` is not used but solved for.
        final_mps: Speed at the target; 0 for a stop.
        newton_steps: See :class:`StopOptions`.

    Returns:
        Deceleration, m/s^2, and the jerk at which it is released from now on, m/s^3 (0 while it is held).
    """
    xp = namespace(speed_mps, distance_m, curve.end_mps2, final_mps)
    v, f, e = xp.maximum(speed_mps, final_mps), final_mps, curve.end_mps2
    s, jerk = xp.maximum(distance_m, NEAREST_M), xp.minimum(curve.release_jerk_mps3, AT_ONCE_MPS3)
    square = (v * v - f * f) / (2.0 * s)
    top = xp.sqrt(e * e + 2.0 * jerk * (v - f))
    b = xp.minimum(xp.maximum(square, LEAST_MPS2), xp.minimum(top, STRONGEST_MPS2) + LEAST_MPS2)

    def improve(b: Scalar) -> tuple[Scalar]:
        t, released = (b - e) / jerk, f + (b * b - e * e) / (2.0 * jerk)
        slope = (released * released - v * v) / (2.0 * b * b) - released / jerk
        slope = slope + (2.0 * t / jerk) * (b / 6.0 + e / 3.0) + t * t / 6.0 + f / jerk
        # Distance falls with deceleration; a slope bounded away from zero bounds the step.
        change = (_distance(xp, v, b, e, jerk, f) - s) / xp.minimum(slope, -1e-2)
        return (xp.minimum(xp.maximum(b - change, LEAST_MPS2), STRONGEST_MPS2),)

    (b,) = repeat(newton_steps, improve, b)
    now, left_s = release(v, s, e, f)
    falling = xp.maximum(now - e, 0.0) / left_s
    limited = curve.release_jerk_mps3 < AT_ONCE_MPS3
    releasing = limited & (s <= _distance(xp, v, xp.maximum(top, LEAST_MPS2), e, jerk, f))
    required = xp.where(releasing, now, xp.where(limited, b, square))
    return xp.where(v > f, required, 0.0), xp.where(releasing, xp.maximum(falling, 1e-6), 0.0)


@no_type_check
def reachable_deceleration(speed_mps: Scalar, acceleration_mps2: Scalar, curve: StopCurve) -> Scalar:
    """Largest deceleration that a stop can build up and still release before standstill, m/s^2.

    From ``a`` to ``b`` and from there to ``e``: ``v = (b^2 - a^2) / (2 J) + (b^2 - e^2) / (2 R)`` with the
    jerks ``J`` of the build-up and ``R`` of the release. A slow trainset does not reach what is planned.

    Args:
        speed_mps: Speed.
        acceleration_mps2: Acceleration that acts now.
        curve: Shape of the stop.
    """
    xp = namespace(speed_mps, acceleration_mps2)
    build, let_go = (xp.minimum(j, AT_ONCE_MPS3) for j in (curve.build_jerk_mps3, curve.release_jerk_mps3))
    a, e = acceleration_mps2, curve.end_mps2
    lost = 2.0 * xp.maximum(speed_mps, 0.0) + a * a / build + e * e / let_go
    return xp.maximum(xp.sqrt(lost / (1.0 / build + 1.0 / let_go)), LEAST_MPS2)


@no_type_check
def release(
    speed_mps: Scalar, distance_m: Scalar, end_mps2: Scalar, final_mps: Scalar = 0.0
) -> tuple[Scalar, Scalar]:
    """Deceleration now, m/s^2, and time left, s, of a release that ends after a distance."""
    xp = namespace(speed_mps, distance_m, end_mps2, final_mps)
    p = 2.0 * speed_mps + 4.0 * final_mps
    # The root of a quadratic in the form without cancellation: ``end_mps2`` may be zero.
    left_s = 12.0 * distance_m / (xp.sqrt(p * p + 24.0 * end_mps2 * distance_m) + p + 1e-9)
    left_s = xp.maximum(left_s, 1e-6)
    return 2.0 * (speed_mps - final_mps) / left_s - end_mps2, left_s


@no_type_check
def build_up(
    speed_mps: Scalar, acceleration_mps2: Scalar, deceleration_mps2: Scalar, jerk_mps3: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Build a deceleration up at a jerk, from the acceleration that acts now.

    Returns:
        Speed at the end, m/s, distance gone, m, and time taken, s.
    """
    xp = namespace(speed_mps, acceleration_mps2, deceleration_mps2, jerk_mps3)
    v, a, jerk = speed_mps, acceleration_mps2, xp.minimum(jerk_mps3, AT_ONCE_MPS3)
    t = xp.where(jerk < AT_ONCE_MPS3, xp.maximum(deceleration_mps2 + a, 0.0) / jerk, 0.0)
    after = xp.maximum(v + a * t - 0.5 * jerk * t * t, 0.0)
    return after, v * t + 0.5 * a * t * t - jerk * t * t * t / 6.0, t


@no_type_check
def required_with_build_up(
    speed_mps: Scalar,
    acceleration_mps2: Scalar,
    distance_m: Scalar,
    curve: StopCurve,
    final_mps: Scalar = 0.0,
    options: StopOptions = STOP_OPTIONS,
) -> tuple[Scalar, Scalar]:
    """:func:`required_deceleration` including the build-up from the present acceleration.

    Args:
        speed_mps: Speed.
        acceleration_mps2: Acceleration that acts now.
        distance_m: Distance to go.
        curve: Shape of the stop; its ``deceleration_mps2`` is not used.
        final_mps: Speed at the target; 0 for a stop.
        options: Constants of the stop.
    """
    xp = namespace(speed_mps, acceleration_mps2, distance_m, curve.end_mps2)
    steps = options.newton_steps
    required, falling = required_deceleration(speed_mps, distance_m, curve, final_mps, steps)
    if xp is scalars and (falling > 0 or required >= STRONGEST_MPS2):
        return required, falling

    # Building up takes no less than braking at once would; and what is built up must be let go before the
    # stand, beyond which the fixed point would leap to and fro.
    least, jerk = required, xp.minimum(curve.build_jerk_mps3, AT_ONCE_MPS3)
    share = 1.0 + jerk / xp.minimum(curve.release_jerk_mps3, AT_ONCE_MPS3)
    lost = 2.0 * jerk * xp.maximum(speed_mps - final_mps, 0.0) + acceleration_mps2 * acceleration_mps2
    most = xp.minimum(xp.maximum(xp.sqrt(lost / share), least), STRONGEST_MPS2)

    def allow_for_build_up(required: Scalar) -> tuple[Scalar]:
        speed, gone, _ = build_up(speed_mps, acceleration_mps2, required, curve.build_jerk_mps3)
        again, _ = required_deceleration(speed, distance_m - gone, curve, final_mps, steps)
        return (xp.where(falling > 0, required, xp.minimum(xp.maximum(again, least), most)),)

    (required,) = repeat(options.passes, allow_for_build_up, required)
    return required, falling


class StopDemand(NamedTuple):
    """Deceleration of one period on the way to a stop.

    Attributes:
        wanted_mps2: Requested deceleration, m/s^2; negative if the trainset is too slow to reach the target.
        required_mps2: Deceleration that must be held for the curve to end at the target, build-up included.
        falling_mps3: Jerk of the release from now on, m/s^3; 0 while the deceleration is held.
    """

    wanted_mps2: Scalar
    required_mps2: Scalar
    falling_mps3: Scalar


@no_type_check
def stop_deceleration(
    speed_mps: Scalar,
    acceleration_mps2: Scalar,
    distance_m: Scalar,
    curve: StopCurve,
    dt: Scalar,
    options: StopOptions = STOP_OPTIONS,
) -> StopDemand:
    """Deceleration of the coming period on the way to a stop.

    While held it is corrected toward the planned one, as far as that can be let go before standstill; during
    the release it is the mean over the period; in the last period it is the constant deceleration that stops
    at the target. It never exceeds what can be released before standstill.

    Args:
        speed_mps: Speed when the command begins to act.
        acceleration_mps2: Acceleration in the period before.
        distance_m: Distance to the target.
        curve: Shape of the stop.
        dt: Control period, s.
        options: Constants of the stop.
    """
    v, s = speed_mps, distance_m
    xp = namespace(v, acceleration_mps2, s, curve.end_mps2)
    required, falling = required_with_build_up(v, acceleration_mps2, s, curve, 0.0, options)
    gain = xp.where(curve.release_jerk_mps3 < AT_ONCE_MPS3, options.return_gain, options.at_once_gain)
    # A departure is not corrected at the cost of the last periods: they would have to make up for it.
    gain = gain * xp.clip(0.5 * v / (xp.maximum(required, LEAST_MPS2) * dt) - 1.0, 0.0, 1.0)
    # Where the planned one could not be let go before the stand, there is nothing to return to.
    planned = _attainable_deceleration(xp, v, curve, 0.0)
    held = xp.maximum(required + gain * (required - planned), 0.0)
    released = required - 0.5 * falling * dt
    last = v * v / (2.0 * xp.maximum(s, NEAREST_M))
    released = xp.where(v <= released * dt, last, released)
    released = xp.where(s < options.push_m, xp.maximum(released, 0.0), released)
    wanted = xp.where(falling > 0, released, xp.where(required < STRONGEST_MPS2, held, STRONGEST_MPS2))
    creeps = (v < options.creep_mps) & (s < options.creep_m)
    wanted = xp.where(creeps, xp.maximum(wanted, options.hold_mps2), wanted)
    wanted = xp.where(s > NEAREST_M, wanted, STRONGEST_MPS2)
    wanted = xp.minimum(wanted, strongest(v, curve, dt, options))
    # A release within two periods is too coarse to end at the target: a constant deceleration does, and a
    # trainset that would go past the target stands with all that the jerk limit allows.
    drop = xp.minimum(curve.build_jerk_mps3 / options.build_share, AT_ONCE_MPS3) * dt
    ends = (s > options.push_m) & (s <= v * dt) & (last <= drop)
    past = (v > 0.0) & (way_in_period(v, wanted, dt) > s + options.past_m)
    wanted = xp.where(ends, last, wanted)
    wanted = xp.where(past, xp.maximum(xp.minimum(last, drop), wanted), wanted)
    return StopDemand(wanted, required, falling)


@no_type_check
def way_in_period(speed_mps: Scalar, deceleration_mps2: Scalar, dt: Scalar) -> Scalar:
    """Distance gone in a period, or to the stand in it, m."""
    xp = namespace(speed_mps, deceleration_mps2)
    v, b = speed_mps, deceleration_mps2
    stands_s = xp.minimum(v / xp.maximum(b, 1e-9), dt)
    return (v - 0.5 * b * stands_s) * stands_s


@no_type_check
def strongest(speed_mps: Scalar, curve: StopCurve, dt: Scalar, options: StopOptions = STOP_OPTIONS) -> Scalar:
    """Largest deceleration that the jerk limit can still release before standstill, m/s^2.

    In periods of ``dt`` the last one decelerates by at most ``c`` (which may drop to zero at once), the one
    before by ``J dt`` more; ``n`` periods take ``v = n c dt + J dt^2 n (n - 1) / 2``.
    """
    xp = namespace(speed_mps, curve.build_jerk_mps3)
    jerk = xp.minimum(curve.build_jerk_mps3, AT_ONCE_MPS3)
    drop = jerk * dt
    last, half = options.drop_share * drop, 0.5 * drop
    more = (last - half) * (last - half) + 4.0 * half * xp.maximum(speed_mps, 0.0) / dt
    periods = (half - last + xp.sqrt(more)) / (2.0 * half)
    most = last + xp.maximum(periods - 1.0, 0.0) * drop
    return xp.where(jerk < AT_ONCE_MPS3, most, STRONGEST_MPS2)


class Stop(NamedTuple):
    """Command of a stop in one period.

    Attributes:
        share: The command.
        required_mps2: Deceleration that must be held for the curve to end at the target, build-up included;
            braking begins when it reaches the planned deceleration.
        later_mps2: The same if braking waits another period; it begins before that exceeds what the brake
            gives.
        ahead: Predicted state for which it was computed.
        left_m: Distance to the target from that state.
    """

    share: float
    required_mps2: float
    later_mps2: float
    ahead: PredictedState
    left_m: float


def stop_command(
    model: Model,
    ahead: PredictedState,
    target_m: float,
    curve: StopCurve,
    options: StopOptions = STOP_OPTIONS,
) -> Stop:
    """Compute the command of this period on the way to a stop.

    Args:
        model: Nominal trainset and section.
        ahead: State when the command begins to act, from :func:`metropilot.control.look_ahead`.
        target_m: Position of the stop.
        curve: Shape of the stop; deviations from its deceleration are corrected with a small gain.
        options: Constants of the stop.
    """
    v, distance = ahead.speed_mps, target_m - ahead.position_m
    jerk, lag = float(model.vehicle.jerk_mps3), float(model.vehicle.lag_s)
    if v <= 0 and distance < options.inch_m:
        if distance < -options.gentle_m:
            wanted = -max(curve.end_mps2, options.hold_mps2)
            return Stop(ahead.share_for(wanted), 0.0, 0.0, ahead, distance)
        # who is foreseen to stand may still creep
        hold = max(curve.end_mps2, min(options.hold_mps2, options.drop_share * jerk * model.dt))
        drag = ahead.resistance_mps2 + ahead.gradient_mps2
        share = ahead.command_for(min(drag - hold, options.held_share * max(drag, 0.0)))
        return Stop(share, 0.0, 0.0, ahead, distance)
    planned = float(curve.deceleration_mps2)
    if draws_up(v, ahead.acceleration_mps2, distance, jerk, lag, options, planned):
        return Stop(ahead.share_for(options.draw_up_mps2), 0.0, 0.0, ahead, distance)
    demand = stop_deceleration(v, ahead.acceleration_mps2, distance, curve, model.dt, options)
    required = later = float(demand.required_mps2)
    if _comes_near(required, curve, ahead):
        later = required_later(ahead, distance, curve, model.dt, options)
    wanted = float(demand.wanted_mps2)
    if options.coasts_up and demand.falling_mps3 <= 0.0:
        # on a climb nobody powers only to brake harder later
        wanted = max(wanted, min(required, ahead.resistance_mps2 + ahead.gradient_mps2))
    share = _share_in(model, ahead, -wanted, options)
    return Stop(share, required, later, ahead, distance)


def _share_in(model: Model, ahead: PredictedState, wanted_mps2: float, options: StopOptions) -> float:
    """:func:`share_to_stand` for what is declared: a lag that is estimated is not compensated in full."""
    _, part = whole_periods(round(float(model.vehicle.delay_s) / model.dt, 6))
    if float(model.vehicle.lag_s) <= 0.0 and part <= 0.0:
        return ahead.share_for(wanted_mps2)
    return share_to_stand(ahead, wanted_mps2, float(model.vehicle.jerk_mps3), model.dt, part, options)


def share_to_stand(
    ahead: PredictedState,
    wanted_mps2: float,
    jerk_mps3: float,
    dt: float,
    part: float = 0.0,
    options: StopOptions = STOP_OPTIONS,
) -> float:
    """Compute the command for an acceleration wanted on the way to a stand.

    No later period makes up for what a lag leaves of the brake in the last one: where that is more than the
    jerk limit lets drop, the lag is compensated in full. Where a dead time is no whole number of periods, the
    command before has its part in the period, too.

    Args:
        ahead: State when the command begins to act.
        wanted_mps2: Acceleration wanted.
        jerk_mps3: Jerk limit.
        dt: Control period, s.
        part: Part of a period by which the dead time exceeds whole ones.
        options: Constants of the stop.
    """
    share, drop = ahead.share_for(wanted_mps2), jerk_mps3 * dt
    acting = min(share + (ahead.share - share) * ahead.keep, 0.0)
    left = ahead.resistance_mps2 + ahead.gradient_mps2 - acting * ahead.brake_mps2
    left = max(left, -ahead.acceleration_mps2 - drop)
    most, least = options.left_share * drop, ahead.speed_mps / dt
    if least > (1.0 - part) * left:
        # it stands in the next period of the plant, which this command begins, if at all
        stands_hard = left > most and least <= left
        return ahead.share_for(wanted_mps2, lead=1.0) if stands_hard else share
    before = -part * ahead.acceleration_mps2
    if (1.0 - part) * left + before <= most:
        return share
    gently = max(most - before, least, options.end_share * drop) / (1.0 - part)
    return ahead.share_for(max(wanted_mps2, -gently), lead=1.0)


@no_type_check
def motion_if_braked_later(
    speed_mps: Scalar,
    acceleration_mps2: Scalar,
    most_mps2: Scalar,
    curve: StopCurve,
    dt: Scalar,
    options: StopOptions,
) -> tuple[Scalar, Scalar, Scalar]:
    """Let a period pass before a stop: traction goes on, and builds up at the jerk limit.

    Traction that is nearly full only takes the way; what it adds to the speed counts in the period after.

    Args:
        speed_mps: Speed.
        acceleration_mps2: Acceleration that acts now; a small one is that of a fall, which does not grow.
        most_mps2: Acceleration of full traction.
        curve: Shape of the stop.
        dt: Control period, s.
        options: Constants of the stop.

    Returns:
        Speed, m/s, and acceleration, m/s^2, at the end of the period, and the way in it, m.
    """
    xp = namespace(speed_mps, acceleration_mps2)
    a, jerk = xp.maximum(acceleration_mps2, 0.0), curve.build_jerk_mps3 / options.build_share
    rise = xp.minimum(jerk, AT_ONCE_MPS3) * dt
    grown = xp.minimum(a + rise, most_mps2)
    builds_up = (jerk < AT_ONCE_MPS3) & (a > 0.5 * rise) & (grown - a > 0.5 * rise)
    rate = xp.where(builds_up, grown, a)
    speed = xp.where(builds_up, speed_mps + rate * dt, speed_mps)
    return speed, xp.where(builds_up, rate, acceleration_mps2), (speed_mps + 0.5 * rate * dt) * dt


def required_later(
    ahead: PredictedState,
    distance_m: float,
    curve: StopCurve,
    dt: float,
    options: StopOptions = STOP_OPTIONS,
) -> float:
    """:func:`required_with_build_up` if braking waits another period (see :func:`motion_if_braked_later`).

    Without a jerk limit the speed that traction adds in that period counts, too: none of it is taken back
    while traction dies away. (The assists of policies leave it out, as they were learned.)

    Args:
        ahead: State when a command given now begins to act.
        distance_m: Distance to the target from there.
        curve: Shape of the stop.
        dt: Control period, s.
        options: Constants of the stop.
    """
    moving = ahead.speed_mps, ahead.acceleration_mps2
    most = ahead.traction_mps2 - ahead.resistance_mps2 - ahead.gradient_mps2
    speed, acceleration, way_m = motion_if_braked_later(*moving, most, curve, dt, options)
    if curve.build_jerk_mps3 >= AT_ONCE_MPS3:
        speed = ahead.speed_mps + max(ahead.acceleration_mps2, 0.0) * dt
    return float(required_with_build_up(speed, acceleration, distance_m - way_m, curve, 0.0, options)[0])


def _comes_near(required_mps2: float, curve: StopCurve, ahead: PredictedState) -> bool:
    """Tell if a stop is near enough to ask what the brake can give."""
    gives = ahead.brake_mps2 + min(ahead.gradient_mps2, 0.0)
    planned = min(curve.deceleration_mps2, max(gives, LEAST_MPS2))
    return required_mps2 >= WATCHED_SHARE * min(planned, _reachable_when_slow(ahead, curve))


def _reachable_when_slow(ahead: PredictedState, curve: StopCurve) -> float:
    """:func:`reachable_deceleration` of a slow trainset; infinite for a faster one, which reaches any."""
    if ahead.speed_mps >= SLOW_MPS or curve.build_jerk_mps3 >= AT_ONCE_MPS3:
        return math.inf
    return float(reachable_deceleration(ahead.speed_mps, ahead.acceleration_mps2, curve))


def stop_with_brake(
    model: Model,
    estimate: StateEstimate,
    ahead: PredictedState,
    target_m: float,
    curve: StopCurve,
    use: float,
    options: StopOptions = STOP_OPTIONS,
) -> tuple[Stop, float]:
    """Compute the command of a stop with a brake that may have nothing to spare.

    Where the rest of the way admits less than the deceleration planned, on a fall to come or at the end of a
    climb, what will be missing is braked now.

    Args:
        model: Nominal trainset and section.
        estimate: State and plant as estimated.
        ahead: State when the command begins to act, from :func:`metropilot.control.look_ahead`.
        target_m: Position of the stop.
        curve: Shape of the stop.
        use: Share of the brake to count on.
        options: Constants of the stop.

    Returns:
        The command, and the deceleration that the stop may count on, m/s^2; infinite while it is far off.
    """
    stop = stop_command(model, ahead, target_m, curve, options)
    if not _comes_near(stop.required_mps2, curve, stop.ahead):
        return stop, math.inf
    available = use * deceleration_to(model, estimate, stop)
    if available < curve.deceleration_mps2:
        if available < SCARCE_SHARE * curve.deceleration_mps2:
            options = replace(options, return_gain=SCARCE_GAIN, at_once_gain=SCARCE_GAIN)
        curve = curve._replace(deceleration_mps2=available)
        stop = stop_command(model, ahead, target_m, curve, options)
    return stop, min(available, _reachable_when_slow(ahead, curve))


@no_type_check
def draws_up(
    speed_mps: Scalar,
    acceleration_mps2: Scalar,
    distance_m: Scalar,
    jerk_mps3: Scalar,
    lag_s: Scalar,
    options: StopOptions = STOP_OPTIONS,
    planned_mps2: Scalar = math.inf,
) -> Flag:
    """Tell if a trainset is so slow before the stop that it has to be drawn up to it.

    Args:
        speed_mps: Speed.
        acceleration_mps2: Acceleration; what the trainset still gains while it dies away counts as speed.
        distance_m: Distance to the stop.
        jerk_mps3: Jerk limit.
        lag_s: Lag.
        options: Constants of the stop.
        planned_mps2: Deceleration that the stop is planned with: who keeps to a gentle one is not too slow.
    """
    xp = namespace(speed_mps, acceleration_mps2, distance_m)
    rise = xp.maximum(acceleration_mps2, 0.0)
    then_mps = speed_mps + rise * (lag_s + 0.5 * rise / xp.minimum(jerk_mps3, AT_ONCE_MPS3))
    stops = xp.minimum(options.draw_up_share * options.draw_up_mps2, SLOW_SHARE * planned_mps2)
    most = 2.0 * stops * distance_m
    return (distance_m >= options.inch_m) & (then_mps * then_mps < most)


@no_type_check
def start_command(share: Scalar, speed_mps: Scalar, drag_mps2: Scalar, goes: Flag = True) -> Scalar:
    """Command that lets a trainset leave a stand on a fall that pulls harder than it may want to accelerate.

    The holding brake waits for traction; coasting, or a brake that would be right in motion, keeps it there.

    Args:
        share: Command wanted.
        speed_mps: Speed.
        drag_mps2: Resistance and gradient over the effective mass.
        goes: True if it is to leave.
    """
    xp = namespace(share, speed_mps, drag_mps2)
    held = (speed_mps <= 0.0) & (drag_mps2 < -STARTS_PULL_MPS2)
    return xp.where(held & goes, xp.maximum(share, STARTS_SHARE), share)


def start_on_fall(model: Model, position_m: float, speed_mps: float, share: Scalar) -> Scalar:
    """Command that lets a trainset leave a stand short of its stop on a fall (:func:`start_command`).

    Args:
        model: Nominal trainset and section.
        position_m: Position.
        speed_mps: Speed as measured: a prediction takes no account of the holding brake.
        share: Command wanted.
    """
    if speed_mps > 0.0:
        return share
    resistance, gradient = resistance_and_gradient(model.vehicle, model.track, position_m, 0.0)
    short = model.track.length_m - position_m > STOP_OPTIONS.inch_m
    return start_command(share, speed_mps, (resistance + gradient) / model.vehicle.effective_mass_kg, short)


def deceleration_to(model: Model, estimate: StateEstimate, stop: Stop) -> float:
    """Constant deceleration that stops over the same distance as full service braking, m/s^2.

    Braking is an exchange of energy, so it is the least mean deceleration over all remaining distances. A
    brake that fades at high speed gives less than it there, all of what it has, and more later on.

    Args:
        model: Nominal trainset and section.
        estimate: State and plant as estimated; gain of the brake and factor on resistance count as at most 1.
        stop: The stop from :func:`stop_command`.
    """
    ahead, gains = stop.ahead, (min(estimate.brake_gain, 1.0), min(estimate.resistance_factor, 1.0))
    end_m = ahead.position_m + max(stop.left_m, 0.0)
    return lasting_deceleration(model.vehicle, model.track, ahead.position_m, end_m, ahead.speed_mps, *gains)


def lasting_deceleration(
    vehicle: Vehicle,
    track: Track,
    start_m: float,
    end_m: float,
    speed_mps: float,
    brake_gain: float = 1.0,
    resistance_factor: float = 1.0,
) -> float:
    """Deceleration that full service braking sustains from everywhere on the way to a stop, m/s^2.

    Args:
        vehicle: Nominal plant.
        track: Nominal section.
        start_m: Position from which it brakes.
        end_m: Position of the stop.
        speed_mps: Speed at the start.
        brake_gain: Actual over nominal braking force.
        resistance_factor: Actual over nominal resistance.
    """
    done = np.linspace(0.0, 1.0, FADE_POINTS)
    speeds, at = speed_mps * np.sqrt(1.0 - done), start_m + done * (end_m - start_m)
    resistance, gradient = resistance_and_gradient(vehicle, track, at, speeds)
    held = resistance_factor * resistance + gradient
    rests = (np.cumsum(held[::-1]) / np.arange(1, held.size + 1))[::-1]
    forces = mean_braking_efforts(vehicle, speed_mps, brake_gain, rests)
    return float(forces.min()) / float(vehicle.effective_mass_kg)


def stand(
    model: Model,
    stop: Stop,
    near_enough_m: float,
    creep_m: float,
    options: StopOptions = STOP_OPTIONS,
) -> float:
    """Command of the last metres: the stop's, or the deceleration in force if it ends near enough.

    Args:
        model: Nominal trainset and section.
        stop: The stop from :func:`stop_command`.
        near_enough_m: Largest stop error that is accepted without a correction in the last period.
        creep_m: Distance to the target below which a creeping trainset is stopped.
        options: Constants of the stop.
    """
    ahead = stop.ahead
    settles, wanted = settle(
        ahead.speed_mps,
        ahead.acceleration_mps2,
        stop.left_m,
        float(model.vehicle.jerk_mps3),
        model.dt,
        near_enough_m,
        creep_m,
        options,
    )
    return _share_in(model, ahead, wanted, options) if settles else stop.share


@no_type_check
def settle(
    speed_mps: Scalar,
    acceleration_mps2: Scalar,
    distance_m: Scalar,
    jerk_mps3: Scalar,
    dt: Scalar,
    near_enough_m: float,
    creep_m: float,
    options: StopOptions = STOP_OPTIONS,
) -> tuple[Flag, Scalar]:
    """Tell if the stop ends near enough without a correction, and the acceleration until then.

    The deceleration in force is kept where it ends in this period; a trainset that creeps is stopped gently,
    and so is one that would stand within ``options.soft_m`` anyway.

    Args:
        speed_mps: Speed when the command begins to act.
        acceleration_mps2: Acceleration in the period before.
        distance_m: Distance to the target.
        jerk_mps3: Jerk limit.
        dt: Control period, s.
        near_enough_m: Largest stop error that is accepted without a correction in the last period.
        creep_m: Distance to the target below which a creeping trainset is stopped.
        options: Constants of the stop.
    """
    xp = namespace(speed_mps, acceleration_mps2, distance_m)
    rate, drop = -acceleration_mps2, jerk_mps3 * dt
    error = xp.abs(distance_m - speed_mps * speed_mps / (2 * xp.where(rate > 0.0, rate, 1.0)))
    ends = (speed_mps > 0.0) & (speed_mps <= rate * dt) & (rate <= drop) & (error <= near_enough_m)
    creeps = (speed_mps < options.creep_mps) & (xp.abs(distance_m) < creep_m) & (drop < float("inf"))
    largest = xp.minimum(drop, AT_ONCE_MPS3)
    soft = SOFT_SHARE * largest
    missed = xp.abs(distance_m - speed_mps * speed_mps / (2 * soft))
    accepted = options.soft_m * xp.minimum(SOFT_DROP_MPS2 / largest, 1.0)
    softly = (speed_mps > 0.0) & (speed_mps <= soft * SOFT_S) & (missed <= accepted) & (drop < float("inf"))
    gentle = xp.where(softly, soft, options.drop_share * largest)
    return ends | creeps | softly, -xp.where(ends, rate, gentle)
