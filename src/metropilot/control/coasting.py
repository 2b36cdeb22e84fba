"""Coasting: the speeds of a trainset without effort, and the time to the stop with a coasting point.

:func:`coast` is the one forecast of coasting; features of policies, the experts of Huang25 and the surrogate
of a human driver use it.
"""

from __future__ import annotations

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
def coast(
    speed_mps: Float[Array, "..."],
    way_m: Float[Array, "... nodes"],
    climb_jpkg: Float[Array, "... nodes"],
    davis_mps2: Sequence[Scalar],
) -> Float[Array, "... nodes"]:
    """Speeds of a trainset that coasts, at ``COAST_SHARES`` of a distance.

    Kinetic energy falls by resistance and climb. Resistance is linear in the energy about the pass before
    (Newton's method): then the energy at every node is a sum, and two passes are right.

    Args:
        speed_mps: Speeds at the first node.
        way_m: Distance from the first node.
        climb_jpkg: Work of gradients and curves at each node, per effective mass; only differences count.
        davis_mps2: Constant, linear and quadratic resistance over effective mass.
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
        energy = xp.maximum(xp.exp(-lost) * (start - spent), LEAST_JPKG)
    return xp.sqrt(2.0 * energy)


STEP_M = 5.0
"""Distance between two nodes of the forecast; it is rounded so that the stop is a node."""
SPEED_STEP_MPS = 0.25
"""Step of the tables over speed."""
SLOWEST_MPS = 0.3
"""A trainset that coasts to less than this before the stop does not arrive."""


class Forecast(NamedTuple):
    """Tables of a section for the forecast; lists, as single numbers are read faster from them.

    Attributes:
        step_m: Distance between two nodes.
        length_m: Distance from the origin to the stop.
        ceiling_mps: Highest speed at each node under the limits and with service braking to them and the
            stop.
        drag_mps2: Deceleration by gradient, curves and the constant resistance at each node.
        traction_mps2: Largest traction acceleration by speed, in steps of ``SPEED_STEP_MPS``.
        davis_mps2: Speed-dependent resistance by speed, per effective mass.
        most_mps2: Largest acceleration in service.
    """

    step_m: float
    length_m: float
    ceiling_mps: list[float]
    drag_mps2: list[float]
    traction_mps2: list[float]
    davis_mps2: list[float]
    most_mps2: float


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
    mass = float(vehicle.effective_mass_kg)
    zero = np.float64(0.0)
    drag = [
        float(sum(resistance_and_gradient(vehicle, model.track, x + 0.5 * step, zero))) / mass for x in at
    ]
    top = np.array([ceiling.at(float(x)) for x in at])
    top[-1] = 0.0
    for k in range(count - 1, -1, -1):
        top[k] = min(top[k], math.sqrt(top[k + 1] ** 2 + 2.0 * deceleration_mps2 * step))
    speeds = np.arange(0.0, float(vehicle.max_speed_mps) + 2.0, SPEED_STEP_MPS)
    return Forecast(
        step_m=step,
        length_m=length,
        ceiling_mps=top.tolist(),
        drag_mps2=drag,
        traction_mps2=(effort_at(vehicle, speeds).traction_n / mass).tolist(),
        davis_mps2=(speeds * (vehicle.davis_n[1] + speeds * vehicle.davis_n[2]) / mass).tolist(),
        most_mps2=float(vehicle.max_acceleration_mps2),
    )


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
    step, length = forecast.step_m, forecast.length_m
    top, traction, davis = forecast.ceiling_mps, forecast.traction_mps2, forecast.davis_mps2
    v, x, total = speed_mps, position_m, 0.0
    last = len(traction) - 1
    for k in range(int(position_m / step), len(top) - 1):
        ds = (k + 1) * step - x
        row = min(int(v / SPEED_STEP_MPS + 0.5), last)
        drag = forecast.drag_mps2[k] + davis[row]
        coasting = x >= coast_from_m
        a = -drag if coasting else min(traction[row] - drag, forecast.most_mps2)
        after = math.sqrt(max(v * v + 2.0 * a * ds, 0.0))
        cap = (
            top[k + 1]
            if coasting
            else max(min(cruise_mps, top[k + 1]), math.sqrt(max(v * v - 2.0 * drag * ds, 0.0)))
        )
        after = min(after, cap, top[k + 1])
        # the last two steps are excepted: there braking to the stop makes the trainset slow
        if v + after < SLOWEST_MPS and k < len(top) - 3:
            return math.inf
        total += 2.0 * ds / max(v + after, 1e-3)
        v, x = after, (k + 1) * step
    return total + max(length - x, 0.0) / SLOWEST_MPS


def cruise_for(
    forecast: Forecast, position_m: float, speed_mps: float, time_left_s: float, coast_from_m: float
) -> float:
    """Slowest cruising speed that arrives in the time left, or the highest one; m/s, by bisection."""
    low, high = 2.0, max(forecast.ceiling_mps)
    for _ in range(20):
        middle = 0.5 * (low + high)
        late = time_to_go(forecast, position_m, speed_mps, middle, coast_from_m) > time_left_s
        low, high = (middle, high) if late else (low, middle)
    return high


def coast_point_for(
    forecast: Forecast, position_m: float, speed_mps: float, time_left_s: float, cruise_mps: float
) -> float:
    """Earliest coasting point that still arrives in the time left, or the stop; m, by bisection."""
    low, high = position_m, forecast.length_m
    if time_to_go(forecast, position_m, speed_mps, cruise_mps, low) <= time_left_s:
        return low
    for _ in range(12):
        middle = 0.5 * (low + high)
        late = time_to_go(forecast, position_m, speed_mps, cruise_mps, middle) > time_left_s
        low, high = (middle, high) if late else (low, middle)
    return high
