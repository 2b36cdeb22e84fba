"""Stop at a point: where to begin braking, how hard, and how to let go so that nobody feels the stop.

The curve is: build up to a deceleration ``b`` at the jerk limit, hold it, let it fall at a softer jerk ``J``
to a small deceleration ``e``, and stand. At every period the deceleration is computed anew that makes this
curve end at the target from the state predicted for the moment the command begins to act. (Without a jerk
limit this is ``b = v^2 / (2 S)``, the rule of the heuristic online algorithm of Chen, Chen, Li and Tang,
2013.) So there is nothing to integrate and nothing to remember: an error made earlier is an error in
distance, and the next period answers it. What the brake really gives is the observer's business.

Closed forms, with distance ``S`` and speed ``v``:

* release only: deceleration falls from ``a`` to ``e`` in ``T``: ``v = (a+e)T/2``, ``S = T^2 (a/6 + e/3)``; so
  ``e T^2 + 2 v T - 6 S = 0`` gives ``T``, and ``a = 2v/T - e``.
* hold ``b``, then release at ``J``: ``T = (b-e)/J``, ``v_T = (b^2-e^2)/(2J)``,
  ``S = (v^2 - v_T^2)/(2b) + T^2 (b/6 + e/3)``, which falls as ``b`` grows while ``v >= v_T``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from metropilot.control.estimator import Model, PredictedState, StateEstimate, look_ahead, share_for
from metropilot.physics import Vehicle, resistance_and_gradient
from metropilot.physics.effort import effort_at

RELEASE_SHARE = 0.5
"""Jerk of the release over the trainset's jerk limit."""
END_SHARE = 0.25
"""Deceleration at the stop over what the jerk limit allows to drop in one period."""
RETURN_GAIN = 0.5
"""How strongly a departure from the wanted deceleration is corrected beyond what the stop needs."""
SERVICE_USE = 0.95
"""Share of the deceleration at hand that a comfortable stop is planned with."""
CREEP_MPS = 0.06
"""Slower than this, and near enough, there is nothing left to correct."""
DROP_SHARE = 0.6
"""Largest deceleration at the stop over what the jerk limit allows to drop in one period."""
INCH_M = 0.2
"""A trainset that would stand nearer to the target than this is left to stand."""
DRAW_UP_MPS2 = 0.3
"""Acceleration with which a trainset that stands short of the stop draws up to it..."""
DRAW_UP_SHARE = 0.3
"""...until a deceleration of this share of it would be needed to stop there."""
HOLD_MPS2 = 0.1
"""Least deceleration asked for to stand."""
BISECTIONS = 20
STRONGEST_MPS2 = 3.0
"""Larger than any brake: where the target is too near to stop at."""


class StopCurve(NamedTuple):
    """The shape of a stop.

    Attributes:
        deceleration_mps2: Deceleration held.
        build_jerk_mps3: Jerk at which it is built up (infinite: at once).
        release_jerk_mps3: Jerk at which it is let go (infinite: held to the stop).
        end_mps2: Deceleration left at the stop.
    """

    deceleration_mps2: float
    build_jerk_mps3: float
    release_jerk_mps3: float
    end_mps2: float


def weakest_gradient(model: Model, target_m: float, stretch_m: float = 400.0) -> float:
    """The worst mean gradient on the way to a stop, as an acceleration (negative downhill), m/s^2.

    Braking is an exchange of energy, so what counts is the mean from where it begins to the stop.

    Args:
        model: What the driver believes about trainset and section.
        target_m: Where to stop.
        stretch_m: How far before the stop braking may begin.
    """
    at = np.linspace(target_m, target_m - stretch_m, 41)
    forces = [float(resistance_and_gradient(model.vehicle, model.track, x, np.float64(0.0))[1]) for x in at]
    means = np.cumsum(forces) / np.arange(1, at.size + 1)
    return float(means[5:].min()) / float(model.vehicle.effective_mass_kg)


def comfortable_deceleration(
    model: Model, belief: StateEstimate, gradient_mps2: float, use: float = SERVICE_USE
) -> float:
    """Deceleration to plan a stop with: what is surely at hand, and no more than the trainset's own limit.

    Args:
        model: What the driver believes about trainset and section.
        belief: The belief; a brake not yet tried counts for less, one that turned out stronger for no more.
        gradient_mps2: From :func:`weakest_gradient`.
        use: Share of it to plan with.
    """
    vehicle = model.vehicle
    speeds = (0.0, belief.speed_mps)
    effort = min(float(effort_at(vehicle, np.float64(v)).brake_n) for v in speeds) / float(
        vehicle.effective_mass_kg
    )
    sure = min(belief.brake_gain - 1.5 * belief.brake_gain_sigma, 1.0)
    return max(use * min(effort * sure + gradient_mps2, float(vehicle.max_deceleration_mps2)), 0.2)


def curve_for(vehicle: Vehicle, dt: float, deceleration_mps2: float) -> StopCurve:
    """The curve that a trainset's jerk limit asks for; a plain ``v^2 / (2 S)`` where there is none.

    Args:
        vehicle: The trainset as the driver knows it.
        dt: Control period, s.
        deceleration_mps2: Deceleration to hold.
    """
    jerk = float(vehicle.jerk_mps3)
    if not math.isfinite(jerk):
        return StopCurve(deceleration_mps2, math.inf, math.inf, deceleration_mps2)
    end = min(END_SHARE * jerk * dt, deceleration_mps2)
    return StopCurve(deceleration_mps2, jerk, RELEASE_SHARE * jerk, end)


def release(
    speed_mps: float, distance_m: float, end_mps2: float, final_mps: float = 0.0
) -> tuple[float, float]:
    """Deceleration now, and time left, of a release that ends after a distance with ``end_mps2`` left."""
    v, e, s = max(speed_mps, final_mps), max(end_mps2, 1e-3), max(distance_m, 1e-9)
    p = 2.0 * (v - final_mps) + 6.0 * final_mps
    time_s = 12.0 * s / (math.sqrt(p * p + 24.0 * e * s) + p)
    return 2.0 * (v - final_mps) / time_s - e, time_s


def braking_distance(speed_mps: float, curve: StopCurve, final_mps: float = 0.0) -> float:
    """Distance from one speed down to another: hold, then release (no build-up)."""
    v, e, jerk = max(speed_mps, final_mps), curve.end_mps2, curve.release_jerk_mps3
    return _distance(v, curve.deceleration_mps2, e, jerk, final_mps)


def _distance(v: float, b: float, e: float, jerk: float, final_mps: float) -> float:
    """:func:`braking_distance` from a speed not below the final one; plain numbers, for it is asked often."""
    if b <= e or not math.isfinite(jerk):
        return (v * v - final_mps * final_mps) / (2.0 * b)
    b = max(min(b, math.sqrt(e * e + 2.0 * jerk * (v - final_mps))), e)
    time_s = (b - e) / jerk
    released = final_mps + (b * b - e * e) / (2.0 * jerk)
    hold_m = (v * v - released * released) / (2.0 * b)
    return hold_m + final_mps * time_s + time_s * time_s * (b / 6.0 + e / 3.0)


def required_deceleration(
    speed_mps: float, distance_m: float, curve: StopCurve, final_mps: float = 0.0
) -> tuple[float, float]:
    """Deceleration that must act now for the curve to end where it should, and how fast it is let go.

    Args:
        speed_mps: Speed.
        distance_m: Distance to go.
        curve: Shape of the stop; its ``deceleration_mps2`` is not used, it is what is solved for.
        final_mps: Speed to have there: 0 for a stop.

    Returns:
        Deceleration, m/s^2, and the jerk at which it is let go from now on, m/s^3 (0 while it is held).
    """
    v, s, e, jerk = max(speed_mps, 0.0), distance_m, curve.end_mps2, curve.release_jerk_mps3
    if v <= final_mps:
        return 0.0, 0.0
    if s <= 1e-9:
        return math.inf, 0.0
    if not math.isfinite(jerk):
        return (v * v - final_mps * final_mps) / (2.0 * s), 0.0
    top = math.sqrt(e * e + 2.0 * jerk * (v - final_mps))
    if s <= _distance(v, top, e, jerk, final_mps):
        now, left = release(v, s, e, final_mps)
        return now, (now - e) / left
    low, high = 0.0, top
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if _distance(v, middle, e, jerk, final_mps) > s:
            low = middle
        else:
            high = middle
    return high, 0.0


def after_build_up(ahead: PredictedState, curve: StopCurve) -> tuple[float, float]:
    """Speed, and distance gone, when the deceleration has been built up from the one that acts now."""
    a, v, jerk = ahead.acceleration_mps2, ahead.speed_mps, curve.build_jerk_mps3
    missing = curve.deceleration_mps2 + a
    if missing <= 0 or not math.isfinite(jerk):
        return v, 0.0
    t = missing / jerk
    return max(v + a * t - 0.5 * jerk * t * t, 0.0), v * t + 0.5 * a * t * t - jerk * t**3 / 6.0


def required_ahead(
    ahead: PredictedState, distance_m: float, curve: StopCurve, final_mps: float = 0.0
) -> tuple[float, float]:
    """:func:`required_deceleration` with the build-up from the deceleration that acts now."""
    required, falling = required_deceleration(ahead.speed_mps, distance_m, curve, final_mps)
    if falling > 0.0 or required >= STRONGEST_MPS2:
        return required, falling
    for _ in range(3):
        speed, gone = after_build_up(ahead, curve._replace(deceleration_mps2=required))
        needed, _ = required_deceleration(speed, distance_m - gone, curve, final_mps)
        required = min(needed, STRONGEST_MPS2)
    return required, 0.0


class Stop(NamedTuple):
    """What a stop needs now.

    Attributes:
        share: The command that gives it.
        required_mps2: Deceleration that must be held for the curve to end at the target, build-up included:
            begin braking when it reaches the deceleration you want.
        ahead: The state it was worked out for.
        left_m: Distance to the target from there.
    """

    share: float
    required_mps2: float
    ahead: PredictedState
    left_m: float


def stop_command(model: Model, belief: StateEstimate, target_m: float, curve: StopCurve) -> Stop:
    """The command of this period on the way to a stop.

    Args:
        model: What the driver believes about trainset and section.
        belief: From :func:`metropilot.control.estimator.observe`.
        target_m: Where to stop.
        curve: Shape of the stop; departures from its deceleration are corrected gently.
    """
    ahead = look_ahead(model, belief)
    v, distance = ahead.speed_mps, target_m - ahead.position_m
    if v <= 0 and distance < INCH_M:
        return Stop(share_for(belief, ahead, -max(curve.end_mps2, HOLD_MPS2)), 0.0, ahead, distance)
    if distance >= INCH_M and v * v < 2.0 * DRAW_UP_SHARE * DRAW_UP_MPS2 * distance:
        return Stop(share_for(belief, ahead, DRAW_UP_MPS2), 0.0, ahead, distance)
    required, falling = required_ahead(ahead, distance, curve)
    if falling == 0.0 and required < STRONGEST_MPS2:
        wanted = max(required + RETURN_GAIN * (required - curve.deceleration_mps2), 0.0)
    else:
        wanted = required - 0.5 * falling * model.dt
        if v <= wanted * model.dt and distance > 0:
            wanted = v * v / (2.0 * distance)
        if distance < INCH_M:
            wanted = max(wanted, 0.0)
    wanted = min(wanted, strongest(v, curve, model.dt))
    return Stop(share_for(belief, ahead, -wanted), required, ahead, distance)


def deceleration_to(model: Model, belief: StateEstimate, stop: Stop) -> float:
    """The constant deceleration that full service braking can keep up from a state to the stop, m/s^2.

    Braking exchanges energy, so it is the least of the mean decelerations over every rest of the way; of the
    effort the least on the way down to standstill counts.

    Args:
        model: What the driver believes about trainset and section.
        belief: The belief; a brake stronger than nominal counts for no more, and so does a larger resistance.
        stop: From :func:`stop_command`.
    """
    vehicle, ahead = model.vehicle, stop.ahead
    done = np.linspace(0.0, 1.0, 9)
    speeds = ahead.speed_mps * np.sqrt(1.0 - done)
    at = ahead.position_m + done * max(stop.left_m, 0.0)
    resistance, gradient = resistance_and_gradient(vehicle, model.track, at, speeds)
    effort = min(float(effort_at(vehicle, v).brake_n) for v in speeds)
    held = min(belief.resistance_factor, 1.0) * resistance + gradient
    rests = np.cumsum(held[::-1]) / np.arange(1, held.size + 1)
    return (min(belief.brake_gain, 1.0) * effort + float(rests.min())) / float(vehicle.effective_mass_kg)


def stand(model: Model, belief: StateEstimate, stop: Stop, near_enough_m: float, creep_m: float) -> float:
    """The stop's command; in the last period the deceleration in force, where it ends near enough.

    Args:
        model: What the driver believes about trainset and section.
        belief: The belief.
        stop: From :func:`stop_command`.
        near_enough_m: Error at the stop that is not worth a correction in the last period.
        creep_m: Nearer than this a trainset that hardly moves is made to stand.
    """
    ahead, left_m, dt = stop.ahead, stop.left_m, model.dt
    rate, drop = -ahead.acceleration_mps2, float(model.vehicle.jerk_mps3) * dt
    last = 0 < ahead.speed_mps <= rate * dt and rate <= drop
    if last and abs(left_m - ahead.speed_mps**2 / (2 * rate)) <= near_enough_m:
        return share_for(belief, ahead, -rate)
    if ahead.speed_mps < CREEP_MPS and abs(left_m) < creep_m and math.isfinite(drop):
        return share_for(belief, ahead, -DROP_SHARE * drop)
    return stop.share


def strongest(speed_mps: float, curve: StopCurve, dt: float) -> float:
    """The deceleration from which the jerk limit still allows to let go before standing, m/s^2.

    In periods of ``dt``: the last one decelerates by at most ``c`` (what may drop to zero at once), the one
    before by ``J dt`` more; ``n`` periods take ``v = n c dt + J dt^2 n (n - 1) / 2``.
    """
    if not math.isfinite(curve.build_jerk_mps3):
        return STRONGEST_MPS2
    drop = curve.build_jerk_mps3 * dt
    last = DROP_SHARE * drop
    half = 0.5 * drop
    n = (half - last + math.sqrt((last - half) ** 2 + 4.0 * half * max(speed_mps, 0.0) / dt)) / (2.0 * half)
    return last + max(n - 1.0, 0.0) * drop
