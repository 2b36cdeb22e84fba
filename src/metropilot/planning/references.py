"""Speed references drawn by hand: the trapezoid and the S-curve with bounded jerk.

A reference is a list of phases of constant jerk, so position, speed and acceleration are polynomials of time
and everything about it has a closed form. With distance ``D``, cruising speed ``V``, acceleration ``A``,
deceleration ``B`` and jerk ``J``:

* from standstill to ``V`` it takes ``V/A + A/J`` if ``V >= A^2/J`` (the limit is reached), else
  ``2 sqrt(V/J)``, and ``V/2`` times that of way, since the speed is symmetric about its middle;
* the whole takes ``D/V + (T_up + T_down)/2``;
* a trapezoid is the limit of infinite jerk.

Source: own. The profile Cheng23 follows is not printed; 0.5 m/s^3, 0.9 and 0.8 m/s^2, cruise 18.3 m/s over
1280 m is what this project assumes for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.errors import Infeasible, InputError

BISECTIONS = 200


@dataclass(frozen=True)
class ReferenceShape:
    """Bounds of a reference.

    Attributes:
        acceleration_mps2: Acceleration while speeding up.
        deceleration_mps2: Deceleration while slowing down, positive.
        jerk_mps3: Bound on the change of acceleration (infinite: a trapezoid).
    """

    acceleration_mps2: float
    deceleration_mps2: float
    jerk_mps3: float = math.inf

    def __post_init__(self) -> None:
        for name, unit in (
            ("acceleration_mps2", "m/s^2"),
            ("deceleration_mps2", "m/s^2"),
            ("jerk_mps3", "m/s^3"),
        ):
            value = getattr(self, name)
            if not value > 0 or (name != "jerk_mps3" and not math.isfinite(value)):
                raise InputError("out of range", field=name, value=value, unit=unit, allowed="> 0")

    def change_s(self, speed_mps: float) -> float:
        """Time to reach a speed from standstill plus time to stand again from it."""
        return sum(sum(ramp) for ramp in _ramps(speed_mps, self))

    def shortest_m(self, speed_mps: float) -> float:
        """Distance to reach a speed from standstill and to stand again, without any cruising."""
        return 0.5 * speed_mps * self.change_s(speed_mps)

    def time_s(self, distance_m: float, speed_mps: float) -> float:
        """Running time over a distance at a cruising speed that fits into it."""
        return distance_m / speed_mps + 0.5 * self.change_s(speed_mps)


@dataclass(frozen=True, eq=False)
class Reference:
    """Speed, acceleration and position over time, in phases of constant jerk.

    Attributes:
        shape: Its bounds.
        cruise_mps: Highest speed.
        time_s: Start of each phase, and the end. Shape (P + 1,).
        position_m: Position there.
        speed_mps: Speed there.
        acceleration_mps2: Acceleration just after (0 at the end).
        jerk_mps3: Jerk of each phase, 0 at the end.
    """

    shape: ReferenceShape
    cruise_mps: float
    time_s: Float[ndarray, " phases"]
    position_m: Float[ndarray, " phases"]
    speed_mps: Float[ndarray, " phases"]
    acceleration_mps2: Float[ndarray, " phases"]
    jerk_mps3: Float[ndarray, " phases"]

    @property
    def duration_s(self) -> float:
        """Running time."""
        return float(self.time_s[-1])

    @property
    def distance_m(self) -> float:
        """Distance from standstill to standstill."""
        return float(self.position_m[-1])

    def at(self, time_s: Float[ndarray, "*times"] | float) -> tuple[ndarray, ndarray, ndarray]:
        """Position, speed and acceleration at each time; standing at either end outside the run."""
        t = np.clip(np.asarray(time_s, dtype=np.float64), 0.0, self.time_s[-1])
        k = np.clip(np.searchsorted(self.time_s, t, side="right") - 1, 0, self.time_s.size - 1)
        d, v, a, j = t - self.time_s[k], self.speed_mps[k], self.acceleration_mps2[k], self.jerk_mps3[k]
        position = self.position_m[k] + d * (v + d * (a / 2 + d * j / 6))
        return (
            np.asarray(position),
            np.asarray(np.maximum(v + d * (a + d * j / 2), 0.0)),
            np.asarray(a + d * j),
        )

    def time_at(self, position_m: Float[ndarray, "*places"] | float) -> ndarray:
        """Time at which each position is passed, s (bisection: position never falls)."""
        place = np.clip(np.asarray(position_m, dtype=np.float64), 0.0, self.position_m[-1])
        low, high = np.zeros(place.shape), np.full(place.shape, self.time_s[-1])
        for _ in range(60):
            middle = 0.5 * (low + high)
            before = self.at(middle)[0] < place
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return high


def reference(distance_m: float, cruise_mps: float, shape: ReferenceShape) -> Reference:
    """The reference over a distance; a distance too short for the cruising speed gets a lower peak.

    Args:
        distance_m: From standstill to standstill, m.
        cruise_mps: Speed not to exceed, m/s.
        shape: Acceleration, deceleration and jerk.

    Raises:
        Infeasible: Distance or speed is not positive.
    """
    _positive("distance", distance_m, "m")
    _positive("cruise", cruise_mps, "m/s")
    return _lay_phases(distance_m, min(cruise_mps, peak_speed(distance_m, shape)), shape)


def reference_for_time(
    distance_m: float, time_s: float, shape: ReferenceShape, fastest_mps: float
) -> Reference:
    """The reference that takes a scheduled time: its cruising speed is what is solved for.

    Args:
        distance_m: From standstill to standstill, m.
        time_s: Scheduled running time, s.
        shape: Acceleration, deceleration and jerk.
        fastest_mps: Speed not to exceed, m/s.

    Raises:
        Infeasible: The time is shorter than at the highest speed (the message names it).
    """
    _positive("distance", distance_m, "m")
    _positive("time", time_s, "s")
    _positive("fastest", fastest_mps, "m/s")
    high = min(fastest_mps, peak_speed(distance_m, shape))
    least = shape.time_s(distance_m, high)
    if time_s < least - 1e-9:
        raise Infeasible(
            "the reference cannot be this fast",
            field="time",
            value=time_s,
            unit="s",
            allowed=f">= {least:.1f} s",
        )
    low = distance_m / time_s * 1e-3
    return _lay_phases(distance_m, _bisect(lambda v: shape.time_s(distance_m, v) > time_s, low, high), shape)


def peak_speed(distance_m: float, shape: ReferenceShape) -> float:
    """The highest speed a distance leaves room for, m/s."""
    high = 1.0
    while shape.shortest_m(high) < distance_m:
        high *= 2.0
    return _bisect(lambda v: shape.shortest_m(v) < distance_m, 0.0, high)


def _bisect(below: Callable[[float], bool], low: float, high: float) -> float:
    """The point where a condition that holds to the left stops to hold, from the left."""
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if below(middle) else (low, middle)
    return high


def _ramp(speed_mps: float, rate_mps2: float, jerk_mps3: float) -> tuple[float, float, float]:
    """Durations of the three phases between standstill and a speed: jerk, constant rate, jerk back; s."""
    if not math.isfinite(jerk_mps3):
        return 0.0, speed_mps / rate_mps2, 0.0
    build = min(rate_mps2 / jerk_mps3, math.sqrt(speed_mps / jerk_mps3))
    return build, max(speed_mps / (jerk_mps3 * build) - build, 0.0), build


def _ramps(speed_mps: float, shape: ReferenceShape) -> tuple[tuple[float, float, float], ...]:
    """:func:`_ramp` up to a speed and down from it."""
    rates = (shape.acceleration_mps2, shape.deceleration_mps2)
    return tuple(_ramp(speed_mps, rate, shape.jerk_mps3) for rate in rates)


def _lay_phases(distance_m: float, cruise_mps: float, shape: ReferenceShape) -> Reference:
    """Lay the seven phases end to end; standstill and distance at the end are set exactly."""
    jerk = shape.jerk_mps3
    up, down = _ramps(cruise_mps, shape)
    hold_m = max(distance_m - shape.shortest_m(cruise_mps), 0.0)
    durations = np.array([*up, hold_m / cruise_mps, *down])
    finite = jerk if math.isfinite(jerk) else 0.0
    jerks = finite * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
    rate_up = min(shape.acceleration_mps2, jerk * up[0]) if finite else shape.acceleration_mps2
    rate_down = min(shape.deceleration_mps2, jerk * down[0]) if finite else shape.deceleration_mps2
    starts = np.array([0.0, rate_up, rate_up, 0.0, 0.0, -rate_down, -rate_down])
    keep = durations > 0
    durations, jerks, starts = durations[keep], jerks[keep], starts[keep]
    t = durations
    speeds = np.concatenate([[0.0], np.cumsum(t * (starts + t * jerks / 2))])
    places = np.concatenate([[0.0], np.cumsum(t * (speeds[:-1] + t * (starts / 2 + t * jerks / 6)))])
    speeds[-1], places[-1] = 0.0, distance_m
    return Reference(
        shape=shape,
        cruise_mps=cruise_mps,
        time_s=np.concatenate([[0.0], np.cumsum(t)]),
        position_m=places,
        speed_mps=speeds,
        acceleration_mps2=np.append(starts, 0.0),
        jerk_mps3=np.append(jerks, 0.0),
    )


def _positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0):
        raise Infeasible("must be positive", field=name, value=value, unit=unit, allowed="> 0, finite")
