"""The expert of Huang25: its rules and speed window, its tables of a section, its station stop that learns.

The rules (eqs. 14 to 24) are written over the array namespace ``xp``: the compiled task calls them with JAX,
a driver on the host with :data:`metropilot.physics.arrays.scalars`, so there is one expert. Rates ``u`` are
wheel effort over mass, as in the paper, which keeps them within 1 m/s^2. What the paper leaves open is
decided so: the speed that is compared with the window is the mean speed a trainset would have that coasts
from here and brakes as late as it may. The plain speed would hold a trainset near the mean speed it needs,
and the published drive (19.49 m/s at most, then 900 m of coasting) does not.

The minimum-time curve (full traction up to the limits, full braking for the lower ones and the stop) gives
the least time from any state to the destination, ``tau_D``, and to the end of the speed-limit interval,
``tau_k``. The interval gets ``Tr tau_k / tau_D`` of the reserved time (Algorithm 1, rule 5). An interval ends
where the minimum-time curve must slow down for a lower limit and traction is needed again behind it; all
others are one with the next.

The station stop is a heuristic online algorithm. In every control period the deceleration is computed anew
that ends at the stop, ``b = v^2 / (2 S)`` with the trainset's jerk limit
(:mod:`metropilot.control.stopping`), and divided by the gain of the brake learned so far: in every period
from the deceleration that came of the command, and at the balises from the speeds at two exact places,
``(v1^2 - v2^2) / (2 (S1 - S2))``. Source: Chen, Chen, Li and Tang, T-ITS 14(3) 2013 (TASC, HOA; used in
Huang25 section 3.1). Its formula is not at hand; this is the form its description has. Places of the balises:
from memory of the group's papers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, no_type_check

import numpy as np

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Array, Flag, Float, Scalar
from metropilot.control import (
    AT_ONCE_MPS3,
    LAG_STOP,
    STOP_OPTIONS,
    Ceiling,
    CommandActuation,
    Model,
    Motion,
    PredictedState,
    StopCurve,
    draws_up,
    lasting_deceleration,
    predict_motion,
    predict_path,
    required_later,
    required_with_build_up,
    settle,
    share_to_stand,
    stop_deceleration,
    strongest,
    weighs_load,
    whole_periods,
)
from metropilot.physics import effort_at, least_between, mean_slopes, scalars
from metropilot.planning import (
    build_mesh,
    fastest_profile,
    interpolate_time_to_go,
    specific,
    tabulate_time_to_go,
)

SEGMENTS = 16
CREEP_MPS, TOO_SLOW_S = 1.0, 1000.0
"""A trainset slower than this is far too late, so that it neither brakes to a stand nor stays there."""
SLOWEST_MPS = 0.5
"""A trainset that coasts slower than this counts as going this fast: far too late for any timetable."""
LEAST_S = 0.1
SURE = 0.2
"""Least share of the largest change that a trainset outside its window makes back into it."""
GENTLE_MPS2 = 0.5
"""Braking of a trainset that is early even if it coasts."""
RELEASE_SHARE = 0.5
"""Jerk at which the last brake is let go, over the trainset's limit."""
OBSERVED = 7


@dataclass(frozen=True)
class ExpertRules(CheckedFields):
    """The expert's constants.

    Attributes:
        start_mps2: Largest acceleration (rule 2; 0.6 in the paper).
        change_mps2: Largest change of the rate in an interval (rule 3; 0.3 in the paper).
        interval_s: That interval; our control period. (The paper's step is 0.02 s, which would be no limit.)
        tolerance_s: ``T0`` of Algorithm 1.
        brake_mps2: Deceleration the last braking is forecast with.
        safe_share: Speed scaling factor of eq. 17.
        intervals: Share the time left out among the speed-limit intervals as Algorithm 1 prints it, and keep
            to the time of each. Otherwise the window is always that of the destination; see the study.
    """

    start_mps2: float = declare(0.6, unit="m/s^2", low=0.0, high=2.0, above=True)
    change_mps2: float = declare(0.3, unit="m/s^2", low=0.0, high=2.0, above=True)
    interval_s: float = declare(0.2, unit="s", low=0.0, high=5.0, above=True)
    tolerance_s: float = declare(3.0, unit="s", low=0.0, high=30.0, above=True)
    brake_mps2: float = declare(0.9, unit="m/s^2", low=0.0, high=2.0, above=True)
    safe_share: float = declare(0.95, low=0.0, high=1.0, above=True)
    intervals: bool = False


class ExpertStretch(NamedTuple):
    """Ground between here and the end of the interval, at :data:`SEGMENTS` + 1 even nodes.

    Attributes:
        left_m: Distance to its end.
        climb: Work of gradients and curves since the first node, J/kg. One entry a node.
        cap: Highest kinetic energy kept there, J/kg. One entry a node.
        end_mps: Speed to have at the end: 0 at the stop.
    """

    left_m: Array
    climb: Sequence[Array]
    cap: Array | Sequence[Array]
    end_mps: Array


class ExpertWindow(NamedTuple):
    """Place of a trainset between too slow and too fast (Huang25 eq. 14). Speeds are means to the end.

    Attributes:
        mean_mps: Mean speed of a trainset that coasts from here.
        low_mps: Slower than this and even 3 s late are too few: ``d / T+``.
        middle_mps: Exactly on time.
        high_mps: Faster than this and it is more than 3 s early: ``d / T-``.
        late_s: Seconds it would come late.
    """

    mean_mps: Array
    low_mps: Array
    middle_mps: Array
    high_mps: Array
    late_s: Array


def coasting_time(
    xp: Any,  # noqa: ANN401 (a module)
    davis: Sequence[Array],
    brake_mps2: Array,
    speed_mps: Array,
    stretch: ExpertStretch,
) -> Array:
    """Time to the end of a stretch: coast, and brake at a constant rate as late as that allows, s.

    Energy over distance: in each segment ``e`` falls by resistance and climb; where the coasting line meets
    the braking line ``e_end + b (d - s)``, the rest is braking.

    Args:
        xp: Array namespace.
        davis: Constant, linear and quadratic resistance over mass. Three numbers.
        brake_mps2: Braking rate.
        speed_mps: Speed now.
        stretch: What lies ahead.
    """
    # not of a symbol, from which the form in C is made: it takes both branches of every segment
    single = isinstance(speed_mps, float) and isinstance(stretch.left_m, float)
    ds = xp.maximum(stretch.left_m, 1e-3) / SEGMENTS
    least = 0.5 * SLOWEST_MPS * SLOWEST_MPS
    end = 0.5 * stretch.end_mps * stretch.end_mps
    v = xp.maximum(speed_mps, SLOWEST_MPS)
    e, total, over = 0.5 * v * v, 0.0 * v, v < 0.0
    for k in range(SEGMENTS):
        pull = davis[0] + v * (davis[1] + v * davis[2]) + (stretch.climb[k + 1] - stretch.climb[k]) / ds
        behind = (SEGMENTS - 1 - k) * ds
        after = e - pull * ds
        if single and not after >= end + brake_mps2 * behind:
            # one state on the host computes no branch that does not count
            e = xp.maximum(xp.minimum(after, stretch.cap[k + 1]), least)
            faster = xp.sqrt(2.0 * e)
            total, v = total + 2.0 * ds / (v + faster), faster
            continue
        s = xp.clip((end + brake_mps2 * (behind + ds) - e) / xp.maximum(brake_mps2 - pull, 0.05), 0.0, ds)
        meets = after >= end + brake_mps2 * behind
        crossing = xp.sqrt(2.0 * xp.maximum(e - pull * s, least))
        braking = 2.0 * s / (v + crossing) + xp.maximum(crossing - stretch.end_mps, 0.0) / brake_mps2
        e = xp.maximum(xp.minimum(after, stretch.cap[k + 1]), least)
        faster = xp.sqrt(2.0 * e)
        total = total + xp.where(over, 0.0, xp.where(meets, braking, 2.0 * ds / (v + faster)))
        if single:
            break
        over = over | meets
        v = faster
    if single:
        return total if speed_mps >= CREEP_MPS else total + TOO_SLOW_S
    return total + xp.where(speed_mps < CREEP_MPS, TOO_SLOW_S, 0.0)


def expert_window(
    xp: Any,  # noqa: ANN401 (a module)
    rules: ExpertRules,
    left_m: Array,
    coasting: Array,
    time_left_s: Array,
    share: Array = 1.0,
) -> ExpertWindow:
    """The speed window (Huang25 eq. 14, Algorithm 1).

    Args:
        xp: Array namespace.
        rules: The expert's constants.
        left_m: ``d_k``, distance to the end of the interval.
        coasting: Time to there if it coasts, from :func:`coasting_time`.
        time_left_s: ``Tr``, reserved time to the destination.
        share: ``tau_k / tau_D``, least time to the end of the interval over that to the destination.
    """
    coasting = xp.maximum(coasting, LEAST_S)
    late, on_time, early = (
        xp.maximum((time_left_s + t) * share, LEAST_S) for t in (rules.tolerance_s, 0.0, -rules.tolerance_s)
    )
    return ExpertWindow(
        left_m / coasting, left_m / late, left_m / on_time, left_m / early, coasting - on_time
    )


def constant_rate_change(xp: Any, rules: ExpertRules, window: ExpertWindow, rate_mps2: Array) -> Array:  # noqa: ANN401
    """EITOE's change of the rate in an interval: up while too slow, down while too fast (eqs. 15 and 16).

    Inside the window, which the paper leaves open, a trainset under traction goes on until it would come
    exactly on time, and a coasting one coasts on.
    """
    goes_on = (rate_mps2 > 0.0) & (window.mean_mps < window.middle_mps)
    up = (window.mean_mps < window.low_mps) | goes_on
    return xp.where(up, rules.change_mps2, -rules.change_mps2)


def next_expert_rate(
    xp: Any,  # noqa: ANN401 (a module)
    most_mps2: Array,
    window: ExpertWindow,
    rate_mps2: Array,
    change_mps2: Array,
    top_mps2: Array,
) -> Array:
    """The rate after a change of it (eqs. 15 and 16; 22 to 24 with a change of the policy's choice).

    The window has the last word on the direction: below it the rate rises, above it falls, and traction above
    it ends as quickly as it may: what it adds is braked away again. A trainset that is too fast even when it
    coasts brakes gently, once it coasts, until it would come on time; the paper's EITOP does so when it is
    told of a later arrival.

    Args:
        xp: Array namespace.
        most_mps2: Largest change of the rate in this period.
        window: From :func:`expert_window`.
        rate_mps2: The rate now.
        change_mps2: Wanted change.
        top_mps2: Largest rate here.
    """
    late, early = window.mean_mps < window.low_mps, window.mean_mps > window.high_mps
    sure = SURE * most_mps2
    change = xp.where(late, xp.maximum(change_mps2, sure), change_mps2)
    change = xp.where(early, xp.where(rate_mps2 > 0.0, -most_mps2, xp.minimum(change, -sure)), change)
    slows = (rate_mps2 <= 0.0) & (early | ((rate_mps2 < 0.0) & (window.mean_mps > window.middle_mps)))
    change = xp.where(slows, xp.minimum(change, -sure), change)
    eased = xp.minimum(rate_mps2 + most_mps2, 0.0)
    pulled = xp.clip(rate_mps2 + change, 0.0, xp.maximum(top_mps2, 0.0))
    braked = xp.maximum(rate_mps2 + change, -GENTLE_MPS2)
    return xp.where(slows, braked, xp.where(rate_mps2 < 0.0, eased, pulled))


EXPERT_STATE = MappingProxyType(
    {"distance_left": 1, "speed": 1, "time_left": 1, "command": 1, "efforts": 1, "coasting": 2}
)
"""Features of :func:`expert_state` by their general names, and how many numbers each has."""


def expert_state(
    xp: Any,  # noqa: ANN401 (a module)
    window: ExpertWindow,
    speed_mps: Array,
    left_m: Array,
    time_left_s: Array,
    rate_mps2: Array,
    traction_mps2: Array,
) -> list[Array]:
    """Observation of a policy inside the expert: the state of Huang25 eq. 19 and its place in the window."""
    late = xp.clip(window.late_s, -9.0, 9.0)
    return [
        left_m / 1000.0,
        speed_mps / 20.0,
        time_left_s / 100.0,
        rate_mps2,
        traction_mps2,
        late / 3.0,
        xp.clip(late, -1.0, 1.0),
    ]


def expert_safe_speed(
    xp: Any,  # noqa: ANN401 (a module)
    rules: ExpertRules,
    brake_mps2: Array,
    lower_mps: Array,
    left_m: Array,
    limit_mps: Array,
) -> Array:
    """Speed to stay under, m/s (Huang25 eqs. 17 and 18).

    Args:
        xp: Array namespace.
        rules: The expert's constants.
        brake_mps2: Largest deceleration.
        lower_mps: Limit of the next, slower interval.
        left_m: Distance to where it begins.
        limit_mps: Limit here.
    """
    before = xp.sqrt(lower_mps * lower_mps + 2.0 * brake_mps2 * xp.maximum(left_m, 0.0))
    return xp.minimum(rules.safe_share * before, limit_mps)


STEP_M = 4.0
UNLIMITED_MPS2 = 1.0
"""Acceleration and deceleration in service of a trainset that declares no limit, as of most metros."""
EFFORT_STEP_MPS = 0.25
FADE_SHARES = tuple(math.sqrt(k / 8) for k in range(8, -1, -1))
"""Speeds, over that at which braking begins, at which a brake that fades is looked at."""
BEYOND_M = 60.0
FOR_LIMITS = 0.85
"""Share of the largest deceleration to brake for lower limits with: protection watches the brake build up."""
LASTING_SHARE = 0.95
"""Share of what a weak brake, or one on a fall, sustains on the way to a lower limit."""
UNDER_MPS, UNDER_LATE_MPS = 0.4, 0.2
"""Speed below a lower limit's ceiling at which the braking for it ends; the second where commands act late,
but not less than the first for each second of a period."""


class ExpertMotion(NamedTuple):
    """Motion of the last period.

    Attributes:
        motion: Position, speed, acceleration, and share of the effort in force.
        limits_mps2: Largest traction, largest service brake, and drag.
        brake_gain: Actual over believed braking force.
    """

    motion: Motion
    limits_mps2: tuple[float, float, float]
    brake_gain: float


class ExpertTrack(NamedTuple):
    """Tables of a section, even in position and speed; every number over effective mass.

    Attributes:
        length_m: Position of the stop.
        climb_jpkg: Work of gradients and curves since the origin, by position.
        downhill_mps2: Loss of station-stop deceleration to gradients and curves, by position: their mean from
            there, or from somewhere behind it, to the stop, where that is worst; at most 0.
        safe_mps: Speed to stay under, by position.
        traction_mps2: Largest traction, by speed.
        brake_mps2: Braking that command -1 asks for, by speed.
        davis: Constant, linear and quadratic resistance.
        weighed_brakes: The brake gives its deceleration at any load.
        most_mps2: Largest acceleration in service.
        stop_mps2: Largest deceleration that station-stop braking is planned with.
        jerk_mps3: Jerk limit in service.
    """

    length_m: float
    climb_jpkg: list[float]
    downhill_mps2: list[float]
    safe_mps: list[float]
    traction_mps2: list[float]
    brake_mps2: list[float]
    davis: tuple[float, float, float]
    weighed_brakes: bool
    most_mps2: float
    stop_mps2: float
    jerk_mps3: float

    def climb(self, position_m: float) -> float:
        """Work of gradients and curves from the origin, J/kg."""
        return _interpolate(self.climb_jpkg, position_m / STEP_M)

    def downhill(self, position_m: float) -> float:
        """Loss of station-stop deceleration to gradients and curves from a position, m/s^2; at most 0."""
        return _interpolate(self.downhill_mps2, position_m / STEP_M)

    def safe(self, position_m: float) -> float:
        """Speed to stay under, m/s."""
        return _interpolate(self.safe_mps, position_m / STEP_M)

    def lowest(self, position_m: float, way_m: float) -> float:
        """The lowest speed to stay under from a position over a little way, m/s."""
        end = len(self.safe_mps)
        first = min(max(int(position_m / STEP_M), 0), end - 1)
        return least_between(
            self.safe_mps, first, min(max(int((position_m + way_m) / STEP_M) + 2, first + 1), end)
        )

    def traction(self, speed_mps: float) -> float:
        """Largest traction, m/s^2."""
        return _interpolate(self.traction_mps2, speed_mps / EFFORT_STEP_MPS)

    def brake(self, speed_mps: float) -> float:
        """Full service brake, m/s^2."""
        return _interpolate(self.brake_mps2, speed_mps / EFFORT_STEP_MPS)

    def mean_brake(self, speed_mps: float, gain: float, downhill_mps2: float) -> tuple[float, float]:
        """Constant decelerations that take as much way to standstill as full braking, m/s^2.

        Args:
            speed_mps: Speed from which the trainset brakes.
            gain: Actual over nominal braking force.
            downhill_mps2: Least mean slope on the way, as an acceleration.

        Returns:
            On level track with the nominal brake, and on that slope with the actual one. A brake that fades
            spends most of its way at high speed, and there a fall takes the larger part of it.
        """
        brakes = [self.brake(speed_mps * share) for share in FADE_SHARES]
        nets = [max(gain * brake + downhill_mps2, LEAST_EFFORT_MPS2) for brake in brakes]
        return _harmonic_mean(brakes), _harmonic_mean(nets)

    def drag(self, position_m: float, speed_mps: float) -> float:
        """Resistance and gradient, m/s^2."""
        k = min(max(int(position_m / STEP_M), 0), len(self.climb_jpkg) - 2)
        slope = (self.climb_jpkg[k + 1] - self.climb_jpkg[k]) / STEP_M
        a, b, c = self.davis
        return a + speed_mps * (b + speed_mps * c) + slope

    def stretch(self, position_m: float, end_m: float, end_mps: float) -> ExpertStretch:
        """Summarise the track between a position and the end of an interval."""
        left = max(end_m - position_m, 1e-3)
        ds = left / SEGMENTS
        at = [position_m + k * ds for k in range(SEGMENTS + 1)]
        climb, safe = self.climb_jpkg, self.safe_mps
        caps = [_interpolate(safe, x / STEP_M) for x in at]
        return ExpertStretch(
            left, [_interpolate(climb, x / STEP_M) for x in at], [0.5 * v * v for v in caps], end_mps
        )

    def now(
        self, actuation: CommandActuation, state: tuple[float, float, float], brake_gain: float
    ) -> ExpertMotion:
        """The motion now, and what may act on it.

        Args:
            actuation: Commands on their way.
            state: Position, speed and acceleration of the last period; m, m/s, m/s^2.
            brake_gain: Actual over believed braking force.
        """
        x, v, a = state
        limits = self.traction(v), brake_gain * self.brake(v), self.drag(x, v)
        return ExpertMotion(Motion(x, v, a, actuation.share), limits, brake_gain)

    def ahead(self, actuation: CommandActuation, now: ExpertMotion) -> PredictedState:
        """The state at the moment a command given now begins to act.

        Args:
            actuation: Commands on their way.
            now: From :meth:`now`.
        """
        motion, limits, brake_gain = now
        if actuation.delay_steps > 0:
            commands, steps, keep = actuation.commands, actuation.delay_steps, actuation.keep
            motion = predict_motion(motion, commands, steps, keep, limits, self.jerk_mps3, actuation.dt)
            x, v = motion.position_m, motion.speed_mps
            limits = self.traction(v), brake_gain * self.brake(v), self.drag(x, v)
        traction, brake, drag = limits
        return PredictedState(actuation.seconds, *motion, actuation.keep, drag, 0.0, traction, brake)

    def look_along(
        self, actuation: CommandActuation, now: ExpertMotion, periods: int
    ) -> Callable[[Scalar], Float[np.ndarray, "2 periods"]]:
        """Prepare to predict positions, m, and speeds, m/s, at the end of each coming period, by command.

        Args:
            actuation: Commands on their way.
            now: From :meth:`now`.
            periods: Periods to predict.
        """
        motion, (traction, brake, drag), _ = now
        x, v, dt = motion.position_m, motion.speed_mps, actuation.dt
        steps, keep, jerk = actuation.delay_steps, actuation.keep, self.jerk_mps3
        drags = [drag, *(self.drag(x + v * dt * k, v) for k in range(1, periods))]

        @no_type_check
        def look(share: Scalar) -> Float[np.ndarray, "2 periods"]:
            commands = (share, *actuation.commands)
            return predict_path(motion, commands, steps, keep, (traction, brake), drags, jerk, dt)

        return look


def expert_track(model: Model, ceiling: Ceiling, rules: ExpertRules) -> ExpertTrack:
    """Tables of a section for a trainset.

    Args:
        model: Nominal trainset and section.
        ceiling: Speeds protection permits, less a margin; eqs. 17 and 18 of Huang25 come on top.
        rules: The expert's constants.
    """
    vehicle, track = model.vehicle, model.track
    mass = float(vehicle.effective_mass_kg)
    at = np.arange(0.0, float(track.length_m) + BEYOND_M, STEP_M)
    gradient, curve, _ = mean_slopes(vehicle, track, at)
    pull = (float(vehicle.gravity_mps2) * gradient + curve) * float(vehicle.mass_kg) / mass
    climb = np.concatenate([[0.0], np.cumsum(0.5 * (pull[1:] + pull[:-1]) * STEP_M)])
    speeds = np.arange(0.0, float(vehicle.max_speed_mps) + 3.0, EFFORT_STEP_MPS)
    effort = [effort_at(vehicle, np.float64(v)) for v in speeds]
    brake = np.array([max(float(e.brake_n), 1.0) / mass for e in effort])
    most = _service_limit(float(vehicle.max_acceleration_mps2))
    return ExpertTrack(
        length_m=float(track.length_m),
        climb_jpkg=climb.tolist(),
        downhill_mps2=_downhill(at, climb, float(track.length_m)).tolist(),
        safe_mps=_safe(model, ceiling, rules, at).tolist(),
        traction_mps2=[max(float(e.traction_n), 1.0) / mass for e in effort],
        brake_mps2=brake.tolist(),
        davis=tuple(float(d) / mass for d in vehicle.davis_n),  # pyright: ignore[reportArgumentType]
        weighed_brakes=weighs_load(vehicle),
        most_mps2=most,
        stop_mps2=min(most, float(vehicle.max_deceleration_mps2)),
        jerk_mps3=float(vehicle.jerk_mps3),
    )


def _service_limit(limit_mps2: float) -> float:
    """Limit of a trainset on its acceleration or deceleration, or the usual one where it declares none."""
    return limit_mps2 if math.isfinite(limit_mps2) else UNLIMITED_MPS2


def _harmonic_mean(values: Sequence[float]) -> float:
    """Harmonic mean; where all are the same it is that value to the last bit."""
    least = min(values)
    return least * (len(values) / sum(least / value for value in values))


def _downhill(at: np.ndarray, climb: np.ndarray, length_m: float) -> np.ndarray:
    """The least mean slope from a position or any place behind it to the stop, by position."""
    lost, left = np.interp(length_m, at, climb) - climb, length_m - at
    mean = lost / np.maximum(left, STEP_M)
    to_the_stop = lost / np.maximum(left, NEAREST_M)
    mean = np.where(to_the_stop < -STEEP_MPS2, to_the_stop, mean)
    mean = np.where(at < length_m, mean, mean[np.flatnonzero(at < length_m)[-1]])
    return np.minimum.accumulate(np.minimum(mean, 0.0)[::-1])[::-1]


def drops(model: Model) -> list[tuple[float, float]]:
    """Starts of lower limits and their values, for every one of the section; m and m/s."""
    begins, limits = np.asarray(model.track.limit_from_m), np.asarray(model.track.limit_mps)
    inside = np.isfinite(begins) & (begins > 0.0) & (begins < float(model.track.length_m))
    return [(float(begins[k]), float(limits[k])) for k in np.flatnonzero(inside) if limits[k] < limits[k - 1]]


def _safe(model: Model, ceiling: Ceiling, rules: ExpertRules, at: np.ndarray) -> np.ndarray:
    """The safe speed at every position: eqs. 17 and 18 for every lower limit ahead, under the ceiling."""
    begins, limits = np.asarray(model.track.limit_from_m), np.asarray(model.track.limit_mps)
    here = limits[np.clip(np.searchsorted(begins, at, side="right") - 1, 0, limits.size - 1)]
    safe = np.minimum(here, [ceiling.at(float(x)) for x in at])
    under = max(UNDER_LATE_MPS, UNDER_MPS * model.dt) if ceiling.late_s > 0.0 else UNDER_MPS
    most = _service_limit(float(model.vehicle.max_deceleration_mps2))
    for place, lower in drops(model):
        fastest = float(here[at < place].max())
        way_m = min(0.5 * fastest * fastest / most, place)
        lasts = lasting_deceleration(model.vehicle, model.track, place - way_m, place, fastest)
        rate = max(min(FOR_LIMITS * most, LASTING_SHARE * lasts), LEAST_EFFORT_MPS2)
        kept = min(lower, ceiling.at(place)) - under
        begins = place - lower * lead_s(model)
        before = expert_safe_speed(np, rules, rate, kept / rules.safe_share, begins - at, here)
        safe = np.where(at < place, np.minimum(safe, before), safe)
    return safe


def _interpolate(values: list[float], steps: float) -> float:
    """A table at a place between its entries, held beyond its ends."""
    if steps <= 0.0:
        return values[0]
    if steps >= len(values) - 1:
        return values[-1]
    k = int(steps)
    low = values[k]
    return low + (values[k + 1] - low) * (steps - k)


def lead_s(model: Model) -> float:
    """Time between a command and its effect, jerk limit apart, s."""
    return float(model.vehicle.delay_s) + float(model.vehicle.lag_s)


def build_up_s(ground: ExpertTrack, rate_mps2: float) -> float:
    """Half the time the jerk limit takes for a change of the acceleration, s."""
    return 0.5 * abs(rate_mps2) / ground.jerk_mps3 if math.isfinite(ground.jerk_mps3) else 0.0


SLACK_MPS = 0.3
SLOW = 1.2
"""Coasting that takes so many times the least time is no way to go on."""


class Leg(NamedTuple):
    """One interval.

    Attributes:
        end_m: End of the interval.
        end_mps: Speed to have there, 0 at the stop.
        after_s: Least time from there to the destination, at that speed.
    """

    end_m: float
    end_mps: float
    after_s: float


class Legs(NamedTuple):
    """The intervals of a section, and the least time to its end from everywhere.

    Attributes:
        legs: In order; the last ends at the stop.
        to_go_s: Least time to the destination: rows even in the root of the distance left, columns in speed.
        length_m: Length of the section.
    """

    legs: tuple[Leg, ...]
    to_go_s: list[list[float]]
    length_m: float

    def leg(self, position_m: float) -> Leg:
        """The interval a position is in."""
        for leg in self.legs:
            if position_m < leg.end_m:
                return leg
        return self.legs[-1]

    def least_s(self, left_m: float, speed_mps: float) -> float:
        """``tau_D``: least time to the destination, s."""
        table = self.to_go_s
        shape, share = (len(table), len(table[0])), left_m / self.length_m
        return interpolate_time_to_go(lambda row, column: table[row][column], shape, share, speed_mps)

    def share(self, leg: Leg, position_m: float, speed_mps: float) -> float:
        """``tau_k / tau_D``, 1 in the last interval."""
        if leg.after_s <= 0.0:
            return 1.0
        whole = self.least_s(self.length_m - position_m, speed_mps)
        return max(1.0 - leg.after_s / max(whole, leg.after_s + 1e-3), 1e-3)


def legs_of(model: Model, ground: ExpertTrack, rules: ExpertRules) -> Legs:
    """The intervals of a section for a trainset that keeps the expert's acceleration.

    Args:
        model: Nominal trainset and section.
        ground: Tables of the section.
        rules: The expert's constants.
    """
    gentle = min(rules.start_mps2, float(model.vehicle.max_acceleration_mps2))
    vehicle = model.vehicle._replace(max_acceleration_mps2=np.float64(gentle))
    length = ground.length_m
    whole = Legs((), tabulate_time_to_go(vehicle, model.track).time_s.tolist(), length)
    mesh = build_mesh(vehicle, model.track, np.array([0.0, length]), STEP_M)
    fastest = np.sqrt(2.0 * fastest_profile(specific(vehicle), mesh))
    legs: list[Leg] = []
    for place, limit in drops(model):
        lower = min(limit, ground.safe(place))
        leg = Leg(place, lower, whole.least_s(length - place, lower))
        if np.interp(place, mesh.node_m, fastest) > lower - SLACK_MPS and _needs_power(ground, leg, rules):
            legs.append(leg)
    return whole._replace(legs=(*legs, Leg(length, 0.0, 0.0)))


def _needs_power(ground: ExpertTrack, leg: Leg, rules: ExpertRules) -> bool:
    """Tell if a trainset that coasts on from the end of an interval comes to the stop far too late."""
    stretch = ground.stretch(leg.end_m, ground.length_m, 0.0)
    return coasting_time(scalars, ground.davis, rules.brake_mps2, leg.end_mps, stretch) > SLOW * leg.after_s


BALISES_M = (64.0, 36.0, 16.0, 4.0, 0.0)
"""Distances of the balises before the stop."""
HEURISTIC = 0.5
"""Share of the gain measured between two balises that is taken over."""
UNSURE = 0.2
"""Scatter of the gain of a brake never tried."""
SETTLED = 0.01
"""Least scatter, and what one day does to it."""
ANSWER_MPS2 = 0.03
"""Scatter of a period's deceleration about the gain's."""
STRANGE = 4.0
"""A period this many deviations off is not the brake's doing (protection may have stepped in) ..."""
DOUBT = 0.003
"""... or the brake is no longer what it was: so much more scatter."""
LEAST_EFFORT_MPS2 = 0.15
STEEP_MPS2, NEAREST_M = 0.1, 1e-3
"""A fall that pulls more than this counts up to so near the stop; a gentler one fades in the last step of the
tables, where it is not missed."""
GAIN = (0.5, 1.6)
CAUTION = 1.7
USE = 0.97
NEAR = 0.4
CRAWL_SHARE = 0.5
"""Share of what the jerk limit releases before the stand with which a crawling trainset begins to brake."""
COARSE = 0.05
"""A period in which braking changes the speed by more than twice this share is no measure of distance."""
CRAWL_M = 2.0
"""A trainset that coasts to a crawl is drawn up to the stop from this distance on; it is in time..."""
LATE_CRAWL_MPS = 3.0
"""...and from so much farther off for each second of dead time and lag: traction acts too long there."""
CREEPS_PAST_MPS, PAST_M = 0.03, 0.01
"""A trainset slower than this so far past the mark is brought to a stand."""
DRAW_UP_M = 8.0
"""A trainset that stands no farther short of the stop than this is drawn up to it."""


HEAVY, HEAVY_SIGMAS = 0.02, 3.0
"""Loss of traction per mass from which a trainset counts as heavier, at least so many standard deviations."""


class Hoa(NamedTuple):
    """Knowledge of the brake, and progress of this stop.

    Attributes:
        gain: Actual over nominal braking force.
        sigma: Its standard deviation.
        braking: True while the station-stop braking is on.
        passed: Balises passed.
        speed_mps: Speed at the last of them.
        effort_jpkg: Braking effort asked for since, times distance, after delay and lag.
        drag_jpkg: Resistance and gradient since, times distance.
    """

    gain: float = 1.0
    sigma: float = UNSURE
    braking: bool = False
    passed: int = 0
    speed_mps: float = 0.0
    effort_jpkg: float = 0.0
    drag_jpkg: float = 0.0

    def plan_mps2(self, brake_mps2: float, net_mps2: float, most_mps2: float) -> float:
        """Deceleration to plan the stop with: the less the gain is known the less.

        Args:
            brake_mps2: What the nominal brake gives on level track (:meth:`ExpertTrack.mean_brake`).
            net_mps2: What is left of the actual brake on the slope ahead (the same).
            most_mps2: Largest deceleration in service.
        """
        sure = min(self.gain * (1.0 - CAUTION * self.sigma), 1.0)
        return USE * min(brake_mps2 * sure, net_mps2, most_mps2)

    def next_stop(self) -> Hoa:
        """Knowledge carried to the next stop."""
        return Hoa(self.gain, max(self.sigma, SETTLED))


def expect_mass(hoa: Hoa, traction_gain: float, sigma: float) -> Hoa:
    """Knowledge of a brake that does not weigh the load, before it is tried: the traction tells the mass.

    Args:
        hoa: Knowledge of earlier stops.
        traction_gain: Traction over the nominal one, per mass.
        sigma: Its standard deviation.
    """
    heavier = (hoa.braking ^ True) & (1.0 - traction_gain >= scalars.maximum(HEAVY, HEAVY_SIGMAS * sigma))
    return hoa._replace(gain=scalars.where(heavier, scalars.minimum(hoa.gain, traction_gain), hoa.gain))


def update_gain(
    hoa: Hoa,
    ground: ExpertTrack,
    actuation: CommandActuation,
    state: tuple[float, float, float],
    before_mps2: float,
) -> Hoa:
    """Update the gain after one control period.

    Args:
        hoa: Knowledge before the period.
        ground: Tables of the section.
        actuation: Actuation during the period.
        state: Position, speed and acceleration of the period; m, m/s, m/s^2.
        before_mps2: Acceleration of the period before.
    """
    x, v, a = state
    asked = -actuation.share * ground.brake(v)
    if asked < LEAST_EFFORT_MPS2 or v < 0.5:
        return hoa
    drag = ground.drag(x, v)
    found = _at_balise(hoa, ground, x, v, (asked * v * actuation.dt, drag * v * actuation.dt))
    ramping = abs(a - before_mps2) > 0.9 * ground.jerk_mps3 * actuation.dt
    if ramping:
        return found
    variance = found.sigma * found.sigma
    spread = ANSWER_MPS2 * ANSWER_MPS2 + variance * asked * asked
    miss = -(a + drag) - asked * found.gain
    if miss * miss > STRANGE * STRANGE * spread:
        return found._replace(sigma=min(found.sigma + DOUBT, UNSURE))
    weight = variance * asked / spread
    gain = found.gain + weight * miss
    variance *= 1.0 - weight * asked
    return found._replace(gain=min(max(gain, GAIN[0]), GAIN[1]), sigma=max(variance**0.5, SETTLED))


def _at_balise(hoa: Hoa, ground: ExpertTrack, x: float, v: float, work: tuple[float, float]) -> Hoa:
    """Add up the period's work; at a balise, what came of it since the one before."""
    hoa = hoa._replace(effort_jpkg=hoa.effort_jpkg + work[0], drag_jpkg=hoa.drag_jpkg + work[1])
    left_m = ground.length_m - x
    if not any(hoa.passed == k and left_m <= at_m for k, at_m in enumerate(BALISES_M)):
        return hoa
    gain = hoa.gain
    if hoa.passed > 0 and hoa.effort_jpkg > LEAST_EFFORT_MPS2 and 0.5 * work[0] <= COARSE * v * v:
        lost = 0.5 * (hoa.speed_mps * hoa.speed_mps - v * v)
        said = (lost - hoa.drag_jpkg) / hoa.effort_jpkg
        gain += HEURISTIC * min(max(said - gain, -0.1), 0.1)
    return hoa._replace(gain=gain, passed=hoa.passed + 1, speed_mps=v, effort_jpkg=0.0, drag_jpkg=0.0)


def _share_at_stand(
    ground: ExpertTrack, ahead: PredictedState, curve: StopCurve, dt: float, *, stands: Flag
) -> float:
    """The command at the mark of a trainset that is foreseen to stand, or creeps on past it."""
    # past the mark so low a speed asks for less than the error of the resistance: it would creep on
    # on a fall what holds on the level would only just balance it
    drag, distance = ahead.resistance_mps2, ground.length_m - ahead.position_m
    holds = -max(curve.end_mps2, STOP_OPTIONS.hold_mps2, STOP_OPTIONS.hold_mps2 - drag)
    if stands and distance < -STOP_OPTIONS.gentle_m:
        return ahead.command_for(holds)
    gently = drag - STOP_OPTIONS.drop_share * ground.jerk_mps3 * dt
    # who is foreseen to stand may still creep: even on a climb it stands gently
    most = STOP_OPTIONS.held_share * max(drag, 0.0) if distance >= -STOP_OPTIONS.gentle_m else 0.0
    return ahead.command_for(max(min(gently, most), holds))


def stop_share(
    hoa: Hoa, ground: ExpertTrack, actuation: CommandActuation, ahead: PredictedState, curve: StopCurve
) -> tuple[float, bool]:
    """Choose the command of the station-stop braking; False beside it if it is not on.

    Args:
        hoa: Knowledge of the brake.
        ground: Tables of the section.
        actuation: Commands on their way.
        ahead: The state when a command given now begins to act, the gain in its brake.
        curve: Shape of the stop, planned with :meth:`Hoa.plan_mps2`.
    """
    v, distance, plan = ahead.speed_mps, ground.length_m - ahead.position_m, curve.deceleration_mps2
    dt, a = actuation.dt, ahead.acceleration_mps2
    stands = v <= 0.0 and distance < STOP_OPTIONS.inch_m
    if stands or (v < CREEPS_PAST_MPS and distance < -PAST_M):
        return _share_at_stand(ground, ahead, curve, dt, stands=stands), True
    near_m = CRAWL_M + LATE_CRAWL_MPS * (actuation.seconds + actuation.lag_s)
    # an emergency brake may let go of a trainset that still moves, and the stop's curve would keep it at that
    slows = (a < 0.0) & ((v >= STOP_OPTIONS.creep_mps) | (distance <= CRAWL_M))
    crawls = (slows ^ True) if hoa.braking else distance <= near_m
    if crawls & draws_up(v, a, distance, ground.jerk_mps3, actuation.lag_s):
        # After an intervention the trainset stands short of the stop, or it has coasted to a crawl before it:
        # far from it the rules drive on.
        if distance > DRAW_UP_M:
            return 0.0, False
        wanted = STOP_OPTIONS.draw_up_mps2 + ahead.resistance_mps2
        return ahead.command_for(wanted), True
    # far from braking; nearer than two seconds even a crawling trainset has to be looked at
    if not hoa.braking and v * v < 2.0 * NEAR * plan * max(distance - 2.0 * v, 0.0):
        return 0.0, False
    if not hoa.braking:
        early_m = v * (0.5 * actuation.lag_s + 0.25 * dt)
        sooner, _ = required_with_build_up(v, a, distance - early_m, curve)
        later = required_later(ahead, distance, curve, dt)
        # a crawling trainset stands before the jerk limit lets it brake as planned
        begins = min(plan, CRAWL_SHARE * strongest(v, curve, dt))
        waits = sooner < begins and later <= begins / USE
        if waits and actuation.lag_s > 0.0:
            # what is planned with has something to spare for the way of the lag, what the brake gives has
            # not, nor does it take back what traction adds, without a jerk limit, while the lag lets go of it
            fades = scalars.maximum(ahead.share, 0.0) * ahead.traction_mps2 * actuation.lag_s
            fades = fades if curve.build_jerk_mps3 >= AT_ONCE_MPS3 else 0.0
            lasts = ahead._replace(speed_mps=v + fades)
            last = required_later(lasts, distance - v * actuation.lag_s, curve, dt)
            waits = last <= max(ahead.brake_mps2 + ahead.resistance_mps2, begins / USE)
        if waits:
            return 0.0, False
    wanted = -stop_deceleration(v, a, distance, curve, dt).wanted_mps2
    if actuation.lag_s > 0.0:
        settles, gently = settle(v, a, distance, ground.jerk_mps3, dt, 0.0, 0.0, LAG_STOP)
        wanted = gently if settles else wanted
    _, part = whole_periods(actuation.delay_steps)
    return share_to_stand(ahead, wanted, ground.jerk_mps3, dt, part), True
