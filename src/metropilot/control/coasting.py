"""Coasting: the speeds of a trainset without effort, and the time to the stop with a coasting point.

:func:`coast` is the forecast of policies' features and of the surrogate of a human driver. The experts of
Huang25 keep the coarser one that their policies learned with (:mod:`metropilot.studies.huang2025.laws`).
"""

from __future__ import annotations

import bisect
import functools
import math
from collections.abc import Sequence
from typing import NamedTuple, no_type_check

import numpy as np

from metropilot._typing import Array, Float, Scalar
from metropilot.control.ceiling import Ceiling
from metropilot.control.prediction import Model
from metropilot.physics import effort_at, namespace, resistance_and_gradient

COAST_SHARES = np.linspace(0.0, 1.0, 49, dtype=np.float32)
"""Nodes of the forecast, as shares of the distance."""
COAST_PASSES = 2
NEARBY = 0.05
"""Relative change of speed of the secant in place of the slope of resistance; policies learned with it."""
MOST_LOST = 12.0
"""Largest exponent of the energy's decay; nothing of the energy is left there."""
LEAST_JPKG = 0.5
"""Kinetic energy that a trainset keeps in the forecast; it would stall."""


@functools.lru_cache
def _up_to(dtype: np.dtype) -> np.ndarray:
    """Matrix that sums the segments up to each node; compiled, it is several times faster than a sum."""
    return np.tri(COAST_SHARES.size, COAST_SHARES.size - 1, -1, dtype=dtype).T


@no_type_check
def _least_so_far(values: Float[Array, "... nodes"]) -> Float[Array, "... nodes"]:
    """Least of the values up to each node."""
    if hasattr(values, "__array_ufunc__"):
        return np.minimum.accumulate(values, -1)
    import jax

    return jax.lax.cummin(values, values.ndim - 1)


@no_type_check
def coast(
    speed_mps: Float[Array, "..."],
    way_m: Float[Array, "... nodes"],
    climb_jpkg: Float[Array, "... nodes"],
    davis_mps2: Sequence[Scalar],
    cap_jpkg: Float[Array, "... nodes"] | None = None,
) -> Float[Array, "... nodes"]:
    """Speeds of a trainset that coasts, at ``COAST_SHARES`` of a distance.

    Kinetic energy falls by resistance and climb. Resistance is linear in the energy about the pass before
    (Newton's method): then the energy at every node is a sum, and two passes are right.

    Args:
        speed_mps: Speeds at the first node.
        way_m: Distance from the first node.
        climb_jpkg: Work of gradients and curves at each node, per effective mass; only differences count.
        davis_mps2: Constant, linear and quadratic resistance over effective mass.
        cap_jpkg: Highest kinetic energy at each node: the trainset brakes to it and coasts on from there.
    """
    xp = namespace(speed_mps, way_m)
    a, b, c = davis_mps2
    step, rise = way_m[..., 1:] - way_m[..., :-1], climb_jpkg[..., 1:] - climb_jpkg[..., :-1]
    start = (0.5 * speed_mps * speed_mps)[..., None]
    sums = xp.asarray(_up_to(np.dtype(start.dtype)))
    energy = xp.maximum(start - (climb_jpkg - climb_jpkg[..., :1]), LEAST_JPKG)
    for _ in range(COAST_PASSES):
        v = xp.sqrt(energy[..., 1:] + energy[..., :-1])
        lost = xp.minimum(((b / v + (2.0 + NEARBY) * c) * step) @ sums, MOST_LOST)
        gain = xp.exp(0.5 * (lost[..., 1:] + lost[..., :-1]))
        spent = (gain * (rise + (a + 0.5 * v * (b - NEARBY * c * v)) * step)) @ sums
        # energy without losses: constant while coasting, and lowered for good where a cap is below it
        free = start
        if cap_jpkg is not None:
            free = xp.minimum(start, _least_so_far(xp.exp(lost) * cap_jpkg + spent))
        energy = xp.maximum(xp.exp(-lost) * (free - spent), LEAST_JPKG)
    return xp.sqrt(2.0 * energy)


STEP_M = 5.0
"""Distance between two nodes of the forecast; it is rounded so that the stop is a node."""
SPEED_STEP_MPS = 0.25
"""Step of the tables over speed."""
BISECTIONS = 14
"""Halvings of the range of cruising speeds; the last is 2 mm/s wide."""
SLOWEST_MPS = 0.3
"""A trainset that drives more slowly than this before the stop does not arrive."""
STALLED_MPS = 1.001 * math.sqrt(2.0 * LEAST_JPKG)
"""A trainset that coasts as slowly as this does not arrive either."""


class Forecast(NamedTuple):
    """Tables of a section for the forecast; lists, as single numbers are read faster from them.

    Attributes:
        node_m: Nodes from the origin to the stop. Shape (N,).
        ceiling_mps: Highest speed at each node under the limits and with service braking to them and the
            stop.
        cap_jpkg: Its kinetic energy, which is linear between nodes while braking. Shape (N,).
        climb_jpkg: Work of gradient, curves and constant resistance up to each node, per effective mass.
            Shape (N,).
        traction_mps2: Largest traction acceleration by speed, in steps of ``SPEED_STEP_MPS``.
        davis_mps2: Linear and quadratic resistance over effective mass.
        most_mps2: Largest acceleration in service.
    """

    node_m: Float[np.ndarray, " nodes"]
    ceiling_mps: list[float]
    cap_jpkg: Float[np.ndarray, " nodes"]
    climb_jpkg: Float[np.ndarray, " nodes"]
    traction_mps2: list[float]
    davis_mps2: tuple[float, float]
    most_mps2: float


class ForecastState(NamedTuple):
    """State at a node of the forecast."""

    position_m: float
    speed_mps: float
    time_s: float


def forecast_of(model: Model, ceiling: Ceiling, deceleration_mps2: float) -> Forecast:
    """Tables of a section for the forecast.

    Args:
        model: Nominal trainset and section.
        ceiling: Speed ceiling.
        deceleration_mps2: Deceleration of the driver's braking.
    """
    vehicle, length = model.vehicle, float(model.track.length_m)
    count = max(math.ceil(length / STEP_M), 2)
    step = length / count
    at = np.linspace(0.0, length, count + 1)
    mass, zero = float(vehicle.effective_mass_kg), np.float64(0.0)
    drag = [sum(resistance_and_gradient(vehicle, model.track, x + 0.5 * step, zero)) / mass for x in at[:-1]]
    top = np.array([ceiling.at(float(x)) for x in at])
    top[-1] = 0.0
    for k in range(count - 1, -1, -1):
        top[k] = min(top[k], math.sqrt(top[k + 1] ** 2 + 2.0 * deceleration_mps2 * step))
    speeds = np.arange(0.0, float(vehicle.max_speed_mps) + 2.0, SPEED_STEP_MPS)
    return Forecast(
        node_m=at,
        ceiling_mps=top.tolist(),
        cap_jpkg=0.5 * top * top,
        climb_jpkg=np.concatenate([[0.0], np.cumsum(drag) * step]),
        traction_mps2=(effort_at(vehicle, speeds).traction_n / mass).tolist(),
        davis_mps2=(float(vehicle.davis_n[1]) / mass, float(vehicle.davis_n[2]) / mass),
        most_mps2=float(vehicle.max_acceleration_mps2),
    )


def hold_speed(
    forecast: Forecast, position_m: float, speed_mps: float, cruise_mps: float, until_m: float
) -> list[ForecastState]:
    """States with full traction to a speed, holding it, and braking, up to the first node from a position on.

    Args:
        forecast: Tables of the section.
        position_m: Position.
        speed_mps: Speed.
        cruise_mps: Speed to hold.
        until_m: Position; the stop at the latest.
    """
    node, top, traction = forecast.node_m.tolist(), forecast.ceiling_mps, forecast.traction_mps2
    climb, (b, c), last = forecast.climb_jpkg, forecast.davis_mps2, len(forecast.traction_mps2) - 1
    x, v, total, step = position_m, speed_mps, 0.0, node[1]
    drags = (np.diff(climb) / step).tolist()
    states = [ForecastState(x, v, total)]
    for k in range(int(position_m / step), len(node) - 1):
        if x >= until_m:
            break
        ds = node[k + 1] - x
        drag = drags[k] + v * (b + v * c)
        rise = min(traction[min(int(v / SPEED_STEP_MPS + 0.5), last)] - drag, forecast.most_mps2)
        # downhill the trainset may get faster than the speed to hold
        cap = max(cruise_mps, math.sqrt(max(v * v - 2.0 * drag * ds, 0.0)))
        after = min(math.sqrt(max(v * v + 2.0 * rise * ds, 0.0)), cap, top[k + 1])
        # the last two steps are excepted: there braking to the stop makes the trainset slow
        slow = v + after < SLOWEST_MPS and k < len(node) - 3
        total = math.inf if slow else total + 2.0 * ds / max(v + after, 1e-3)
        x, v = node[k + 1], after
        states.append(ForecastState(x, v, total))
    return states


def coast_to_stop(forecast: Forecast, position_m: float, speed_mps: float) -> float:
    """Time to the stop of a trainset that coasts, and brakes where the ceiling falls; infinite: it stalls."""
    left = float(forecast.node_m[-1]) - position_m
    if left < forecast.node_m[2]:
        return 2.0 * max(left, 0.0) / max(speed_mps, SLOWEST_MPS)
    way = COAST_SHARES * left
    climb = np.interp(position_m + way, forecast.node_m, forecast.climb_jpkg)
    cap = np.interp(position_m + way, forecast.node_m, forecast.cap_jpkg)
    # the constant resistance is in the climb
    speeds = coast(np.float64(speed_mps), way, climb, (0.0, *forecast.davis_mps2), cap)
    top = np.sqrt(2.0 * cap)
    stalled = speeds < np.minimum(top, STALLED_MPS)
    speeds = np.minimum(speeds, top)
    return math.inf if stalled.any() else float((2.0 * np.diff(way) / (speeds[1:] + speeds[:-1])).sum())


def time_to_go(
    forecast: Forecast, position_m: float, speed_mps: float, cruise_mps: float, coast_from_m: float
) -> float:
    """Time to the stop with full traction to a speed, holding it, coasting from a point, and braking.

    Args:
        forecast: Tables of the section.
        position_m: Position.
        speed_mps: Speed.
        cruise_mps: Speed to hold.
        coast_from_m: Position from which the trainset coasts.

    Returns:
        Time, s; infinite if the trainset would not reach the stop.
    """
    x, v, taken = hold_speed(forecast, position_m, speed_mps, cruise_mps, coast_from_m)[-1]
    return taken + coast_to_stop(forecast, x, v)


def cruise_for(
    forecast: Forecast, position_m: float, speed_mps: float, time_left_s: float, coast_from_m: float
) -> float:
    """Slowest cruising speed that arrives in the time left, or the highest one; m/s, by bisection."""
    low, high = 2.0, max(forecast.ceiling_mps)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        late = time_to_go(forecast, position_m, speed_mps, middle, coast_from_m) > time_left_s
        low, high = (middle, high) if late else (low, middle)
    return high


def coast_point_for(
    forecast: Forecast, position_m: float, speed_mps: float, time_left_s: float, cruise_mps: float
) -> float:
    """Earliest coasting point, a node or here, that still arrives in the time left; m. Else the stop."""
    states = hold_speed(forecast, position_m, speed_mps, cruise_mps, float(forecast.node_m[-1]))

    def is_late(state: ForecastState) -> bool:
        return state.time_s + coast_to_stop(forecast, state.position_m, state.speed_mps) > time_left_s

    # the later the coasting begins, the earlier the arrival
    first = bisect.bisect_left(range(len(states) - 1), True, key=lambda k: not is_late(states[k]))
    return states[first].position_m
