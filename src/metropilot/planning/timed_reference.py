"""References over time that a real section and trainset allow: limits, gradients, the effort at hand.

The S-curve of :mod:`metropilot.planning.references` is drawn by hand and asks neither limits nor trainset.
Here the trapezoid is laid under the speeds permitted and the effort at hand at each of them (forward for
traction, backward for braking, over space), and a moving average over time bounds its jerk: averaging the
speed over a window ``T`` keeps the distance, lengthens the run by ``T`` and leaves a jerk of at most the rate
over ``T``. A reference that begins on the way begins half a window ahead, so that its average begins here.

Source: own. What Cheng23 follows is not printed; its trainset cannot give 0.9 m/s^2 above 13 m/s nor brake at
0.8 m/s^2 above 15 m/s, so a reference that it can follow needs the effort in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.errors import InputError
from metropilot.physics import Track, Vehicle
from metropilot.planning.effort_table import Specific, specific
from metropilot.planning.fastest import fastest_profile, times
from metropilot.planning.mesh import Mesh, limit_at, mean_slopes_at
from metropilot.planning.references import Reference, ReferenceShape

CELL_M = 1.0
BISECTIONS = 18
"""Halvings of the range of cruising speeds: 0.1 mm/s, or a millisecond of running time."""
SLOWEST_MPS = 0.5
LEAST_RATE_MPS2 = 0.05


@dataclass(frozen=True, eq=False)
class TimedReference:
    """Position, speed and acceleration at equal steps of time, standing at the end.

    Attributes:
        period_s: Step of time.
        position_m: Shape (N,).
        speed_mps: Shape (N,).
        acceleration_mps2: Shape (N,).
        duration_s: Time of the standstill at the end.
    """

    period_s: float
    position_m: Float[ndarray, " times"]
    speed_mps: Float[ndarray, " times"]
    acceleration_mps2: Float[ndarray, " times"]
    duration_s: float

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Position, speed and acceleration at a time, linear between the steps; standing before and after."""
        place = min(max(time_s / self.period_s, 0.0), self.position_m.size - 1.0)
        k = min(int(place), self.position_m.size - 2)
        share = place - k
        x, v, a = (
            float(y[k] + share * (y[k + 1] - y[k]))
            for y in (self.position_m, self.speed_mps, self.acceleration_mps2)
        )
        return x, v, a


@dataclass(frozen=True, eq=False)
class ReferenceTrack:
    """Constraints under which a reference is laid.

    Attributes:
        vehicle: Trainset.
        track: Section.
        cap_m: Positions of a speed to keep under beside the limits, None for none. Shape (G,).
        cap_mps: Those speeds. Shape (G,).
        effort_share: Share of the traction and braking at hand that the reference may use.
        start_m: Initial position.
        start_mps: Initial speed.
    """

    vehicle: Vehicle
    track: Track
    cap_m: ndarray | None = None
    cap_mps: ndarray | None = None
    effort_share: float = 0.9
    start_m: float = 0.0
    start_mps: float = 0.0

    def __post_init__(self) -> None:
        if not 0.1 <= self.effort_share <= 1.0:
            raise InputError(
                "out of range", field="effort_share", value=self.effort_share, allowed="0.1 to 1"
            )


def sample_reference(reference: Reference, period_s: float) -> TimedReference:
    """A reference drawn by hand at equal steps of time."""
    count = int(np.ceil(reference.duration_s / period_s - 1e-9)) + 2
    x, v, a = reference.at(np.arange(count) * period_s)
    return TimedReference(period_s, x, v, np.where(v > 0, a, 0.0), reference.duration_s)


def sample_profile(
    position_m: Float[ndarray, " nodes"],
    speed_mps: Float[ndarray, " nodes"],
    period_s: float,
    window_s: float = 0.0,
) -> TimedReference:
    """A speed profile over space at equal steps of time, its speed averaged over a window of time.

    Args:
        position_m: Nodes; between them the acceleration is constant.
        speed_mps: Speed there, above zero inside.
        period_s: Step of time.
        window_s: Width of the average.
    """
    step, pair = np.diff(position_m), speed_mps[1:] + speed_mps[:-1]
    seconds = 2.0 * step / np.maximum(pair, 1e-6)
    node_s = np.concatenate([[0.0], np.cumsum(seconds)])
    rate = np.append(np.diff(speed_mps) / seconds, 0.0)
    area = position_m[:-1] * seconds + speed_mps[:-1] * seconds**2 / 2 + rate[:-1] * seconds**3 / 6
    areas = np.concatenate([[0.0], np.cumsum(area)])
    duration = float(node_s[-1]) + window_s

    def moments(time_s: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """Integral of position, position and speed; steady before the first node and after the last."""
        k = np.clip(np.searchsorted(node_s, time_s, side="right") - 1, 0, node_s.size - 1)
        d = time_s - node_s[k]
        a = np.where(time_s < 0, 0.0, rate[k])
        x, v = position_m[k], speed_mps[k]
        return areas[k] + d * (x + d * (v / 2 + d * a / 6)), x + d * (v + d * a / 2), v + d * a

    times = np.arange(int(np.ceil(duration / period_s - 1e-9)) + 2) * period_s
    now = moments(np.minimum(times, node_s[-1] + window_s))
    if window_s <= 0:
        x, v = now[1], now[2]
        a = rate[np.clip(np.searchsorted(node_s, times, side="right") - 1, 0, node_s.size - 1)]
    else:
        then = moments(np.minimum(times, node_s[-1] + window_s) - window_s)
        x, v, a = ((p - q) / window_s for p, q in zip(now, then, strict=True))
    over = times >= duration
    x, v, a = np.where(over, position_m[-1], x), np.where(over, speed_mps[-1], v), np.where(over, 0.0, a)
    return TimedReference(period_s, x, np.maximum(v, 0.0), a, duration)


def reference_under(
    constraints: ReferenceTrack, shape: ReferenceShape, cruise_mps: float, period_s: float = 0.05
) -> TimedReference:
    """The fastest reference under a cruising speed, the limits and the effort at hand.

    Args:
        constraints: Section, trainset and what else bounds it.
        shape: Largest acceleration, deceleration and jerk.
        cruise_mps: Speed not to exceed.
        period_s: Step of time of the result.
    """
    table, mesh = _build_problem(constraints, shape)
    speed = _fastest_speeds(constraints, table, mesh, cruise_mps)
    return sample_profile(mesh.node_m, speed, period_s, _window_s(shape))


def reference_under_for_time(
    constraints: ReferenceTrack, shape: ReferenceShape, time_s: float, period_s: float = 0.05
) -> TimedReference:
    """The reference that takes a running time; the fastest there is where that takes longer.

    Args:
        constraints: Section, trainset and what else bounds it.
        shape: Largest acceleration, deceleration and jerk.
        time_s: Running time from here.
        period_s: Step of time of the result.
    """
    table, mesh = _build_problem(constraints, shape)

    def profile(cruise_mps: float) -> tuple[ndarray, float]:
        speed = _fastest_speeds(constraints, table, mesh, cruise_mps)
        return speed, float(times(mesh, 0.5 * speed**2).sum())

    wanted, low, high = time_s - _window_s(shape), SLOWEST_MPS, float(mesh.cap_mps.max())
    best, fastest = profile(high)
    if fastest < wanted:
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            speed, took = profile(middle)
            low, high = (middle, high) if took > wanted else (low, middle)
            best = speed if took <= wanted else best
    return sample_profile(mesh.node_m, best, period_s, _window_s(shape))


def _window_s(shape: ReferenceShape) -> float:
    """Width of the average that keeps the jerk: infinite jerk needs none."""
    return max(shape.acceleration_mps2, shape.deceleration_mps2) / shape.jerk_mps3


def _build_problem(constraints: ReferenceTrack, shape: ReferenceShape) -> tuple[Specific, Mesh]:
    """Effort and rates that a reference may use, and the track ahead in even cells."""
    vehicle, track, table = constraints.vehicle, constraints.track, specific(constraints.vehicle)
    end = float(track.length_m)
    start = min(constraints.start_m + 0.5 * constraints.start_mps * _window_s(shape), end - CELL_M)
    at = np.linspace(start, end, max(int(np.ceil((end - start) / CELL_M)), 2) + 1)
    cap = np.minimum(limit_at(track, at), float(vehicle.max_speed_mps))
    if constraints.cap_m is not None and constraints.cap_mps is not None:
        cap = np.minimum(cap, np.interp(at, constraints.cap_m, constraints.cap_mps))
    slopes = mean_slopes_at(vehicle, track, 0.5 * (at[1:] + at[:-1]))
    ratio = float(vehicle.mass_kg) / table.mass_kg
    mesh = Mesh(
        node_m=at,
        length_m=np.diff(at),
        cap_mps=_narrow(cap, at, _window_s(shape)),
        slope_mps2=ratio * (float(vehicle.gravity_mps2) * slopes[:, 0] + slopes[:, 1]),
        tunnel_n=slopes[:, 2],
        stop=np.array([0, at.size - 1]),
    )
    table = table._replace(
        traction=constraints.effort_share * table.traction,
        braking=constraints.effort_share * table.braking,
        acceleration=min(shape.acceleration_mps2, table.acceleration),
        deceleration=min(shape.deceleration_mps2, table.deceleration),
    )
    return table, mesh


def _narrow(cap: ndarray, at: ndarray, window_s: float) -> ndarray:
    """A cap that the average over the window still keeps: the lowest within the way of one window."""
    if window_s <= 0:
        return cap
    reach = int(np.ceil(float(cap.max()) * window_s / float(at[1] - at[0])))
    padded = np.concatenate([np.full(reach, cap[0]), cap, np.full(reach, cap[-1])])
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).min(axis=1)


def _fastest_speeds(
    constraints: ReferenceTrack, table: Specific, mesh: Mesh, cruise_mps: float
) -> Float[ndarray, " nodes"]:
    """The fastest speeds under a cruising speed; a trainset that would stall creeps on."""
    mesh = mesh._replace(cap_mps=np.minimum(mesh.cap_mps, cruise_mps))
    start_mps = min(constraints.start_mps, float(mesh.cap_mps[0]))
    energy = fastest_profile(table, mesh, start_mps, passes=1)
    energy[1:-1] = np.maximum(energy[1:-1], LEAST_RATE_MPS2 * mesh.length_m[0])
    return np.sqrt(2.0 * energy)
