"""Electric power of a train over a trip, linear in time on each segment, and its sums over one headway.

Forces hold over a segment and speed is linear in time, so that power is linear too: integrals are exact,
whatever the instants at which trips begin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.physics import vehicle_arrays
from metropilot.planning import Plan, cost_per_metre, specific
from metropilot.railway import Trainset
from metropilot.sim import Trajectory

SAME_S = 1e-9
"""Instants nearer than this are one."""
ROUNDING = 1e-12
"""Power over the largest one below which it is rounding."""


@dataclass(frozen=True, eq=False)
class PowerProfile:
    """Electric power of a trip without auxiliaries.

    Attributes:
        time_s: Time since departure at the nodes. Shape (N+1,).
        position_m: Position from the section's origin. Shape (N+1,).
        speed_mps: Speed. Shape (N+1,).
        drawn_w: Power that traction draws, at the start and the end of each segment. Shape (N, 2).
        returned_w: Power that the electric brake returns, the same. Shape (N, 2).
        bound_j: Least net energy of any drive in this time; minus infinity where it is not known.
    """

    time_s: Float[ndarray, " nodes"]
    position_m: Float[ndarray, " nodes"]
    speed_mps: Float[ndarray, " nodes"]
    drawn_w: Float[ndarray, "segments 2"]
    returned_w: Float[ndarray, "segments 2"]
    bound_j: float

    @property
    def running_time_s(self) -> float:
        """Running time."""
        return float(self.time_s[-1])

    @property
    def drawn_j(self) -> float:
        """Energy drawn for traction."""
        return _integral(self.time_s, self.drawn_w)

    @property
    def returned_j(self) -> float:
        """Energy returned."""
        return _integral(self.time_s, self.returned_w)

    def net_w(self, transfer_loss: float) -> Float[ndarray, "segments 2"]:
        """Power drawn less the part of the returned power that reaches another train."""
        return self.drawn_w - (1.0 - transfer_loss) * self.returned_w

    def net_until_j(self, transfer_loss: float, at_s: Float[ndarray, " times"]) -> Float[ndarray, " times"]:
        """Integral of the net power from the departure to each time; there is none beside the trip."""
        return integral_until(self.time_s, self.net_w(transfer_loss), at_s)


@dataclass(frozen=True, eq=False)
class PeriodicPower:
    """Power that repeats every headway, linear between knots.

    Attributes:
        time_s: Knots from 0 to the headway, increasing. Shape (K+1,).
        power_w: Power just after the start and just before the end of each interval. Shape (K, 2).
    """

    time_s: Float[ndarray, " knots"]
    power_w: Float[ndarray, "intervals 2"]

    @property
    def positive_j(self) -> float:
        """Integral of the positive part over one headway."""
        return float(np.sum(_positive_parts_j(self.time_s, self.power_w)))

    @property
    def negative_j(self) -> float:
        """Integral of the negative part over one headway, positive."""
        return float(np.sum(_positive_parts_j(self.time_s, -self.power_w)))

    def until_j(self, at_s: Float[ndarray, " times"]) -> Float[ndarray, " times"]:
        """Integral from time zero to each time, over headways before and after too."""
        headways, at_s = np.divmod(at_s, self.time_s[-1])
        return headways * _integral(self.time_s, self.power_w) + integral_until(
            self.time_s, self.power_w, at_s
        )

    def split(self, count: int) -> Float[ndarray, "2 parts"]:
        """Integrals of the positive and the negative part over each of so many equal parts of the headway.

        Args:
            count: Number of parts, each of which begins at a knot.
        """
        middle_s = 0.5 * (self.time_s[:-1] + self.time_s[1:])
        part = np.minimum((middle_s * (count / self.time_s[-1])).astype(int), count - 1)
        energies = (_positive_parts_j(self.time_s, sign * self.power_w) for sign in (1.0, -1.0))
        return np.stack([np.bincount(part, each, count) for each in energies])


def _positive_parts_j(time_s: ndarray, power_w: ndarray) -> Float[ndarray, " intervals"]:
    """Integral of the positive part over each interval."""
    first, last = power_w.T
    high, low = np.maximum(first, last), np.minimum(first, last)
    crosses = (low < 0) & (high > 0)
    # of an interval that crosses zero the part above it is a triangle
    share = np.divide(high, high - low, out=np.ones_like(high), where=crosses)
    above = 0.5 * np.maximum(high, 0.0) * share + 0.5 * np.maximum(low, 0.0)
    return np.diff(time_s) * above


def profile_of_plan(plan: Plan, trainset: Trainset) -> PowerProfile:
    """Electric power of a plan.

    Args:
        plan: Plan of one section.
        trainset: Trainset that it was made for.
    """
    return _profile(
        trainset,
        (plan.time_s, plan.position_m, plan.speed_mps),
        plan.traction_n,
        plan.electric_brake_n,
        plan.bound_j,
    )


def profile_of_trajectory(trajectory: Trajectory, trainset: Trainset) -> PowerProfile:
    """Electric power of a run that a driver has driven.

    Args:
        trajectory: Trajectory of the run.
        trainset: Trainset that drove it.
    """
    motion = trajectory.time_s, trajectory.position_m, trajectory.speed_mps
    traction_n, electric_n = trajectory.traction_n[:-1], trajectory.electric_brake_n[:-1]
    return _profile(trainset, motion, traction_n, electric_n, -np.inf)


def _profile(
    trainset: Trainset,
    motion: tuple[ndarray, ndarray, ndarray],
    traction_n: ndarray,
    electric_n: ndarray,
    bound_j: float,
) -> PowerProfile:
    vehicle = vehicle_arrays(trainset)._replace(receptivity=np.float64(1.0))
    table = specific(vehicle)
    *_, speed_mps = motion
    ends = np.stack([speed_mps[:-1], speed_mps[1:]], axis=1)
    middle, none = 0.5 * ends.mean(axis=1) ** 2, np.zeros(traction_n.size)
    traction, electric = traction_n / table.mass_kg, electric_n / table.mass_kg
    drawn = cost_per_metre(vehicle, table, "line", middle, traction, none) * table.mass_kg
    returned = -cost_per_metre(vehicle, table, "line", middle, none, electric) * table.mass_kg
    return PowerProfile(*motion, drawn[:, None] * ends, returned[:, None] * ends, bound_j)


def _integral(time_s: ndarray, power_w: ndarray) -> float:
    return float(np.sum(np.diff(time_s) * power_w.mean(axis=1)))


def integral_until(time_s: ndarray, power_w: ndarray, at_s: ndarray) -> ndarray:
    """Integral of linear pieces from their first knot to each time."""
    lasts = np.diff(time_s)
    before = np.concatenate([[0.0], np.cumsum(lasts * power_w.mean(axis=1))])
    at_s = np.clip(at_s, time_s[0], time_s[-1])
    j = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, lasts.size - 1)
    since = at_s - time_s[j]
    slope = np.divide(power_w[:, 1] - power_w[:, 0], lasts, out=np.zeros_like(lasts), where=lasts > 0)
    return before[j] + since * (power_w[j, 0] + 0.5 * since * slope[j])


def add_periodic(
    start_s: Float[ndarray, " parts"],
    duration_s: Float[ndarray, " parts"],
    power_w: Float[ndarray, "parts 2"],
    headway_s: float,
) -> PeriodicPower:
    """Sum of linear pieces of power, each repeated every headway.

    Args:
        start_s: Start of each piece, any time.
        duration_s: Its duration.
        power_w: Its power at start and end.
        headway_s: Headway.
    """
    kept = duration_s > SAME_S
    start_s, duration_s, power_w = start_s[kept], duration_s[kept], power_w[kept]
    begin = np.mod(start_s, headway_s)
    slope = (power_w[:, 1] - power_w[:, 0]) / duration_s
    parts: list[tuple[ndarray, ndarray, ndarray, ndarray]] = []
    # a piece longer than what is left of the headway goes on from its beginning
    first, last, level, ramp = begin, begin + duration_s, power_w[:, 0], slope
    while first.size:
        cut = np.minimum(last, headway_s)
        parts.append((first, cut, level, ramp))
        on = last > headway_s
        level = (level + ramp * (headway_s - first))[on]
        first, last, ramp = np.zeros(int(on.sum())), last[on] - headway_s, ramp[on]
    if not parts:
        return PeriodicPower(np.array([0.0, headway_s]), np.zeros((1, 2)))
    first, last, level, ramp = (np.concatenate(part) for part in zip(*parts, strict=True))
    time = np.concatenate([first, last])
    order = np.argsort(time, kind="stable")
    time = time[order]
    jump = np.concatenate([level, -(level + ramp * (last - first))])[order]
    bend = np.concatenate([ramp, -ramp])[order]
    knots = np.concatenate([[0.0], time, [headway_s]])
    gap = np.diff(knots)
    rise = np.concatenate([[0.0], np.cumsum(bend)])
    before = np.concatenate([[0.0], np.cumsum(jump)]) + np.concatenate(
        [[0.0], np.cumsum(rise[:-1] * gap[:-1])]
    )
    power = np.stack([before, before + rise * gap], axis=1)
    # sums that cancel leave their rounding, which is no power: it would be drawn or returned for hours
    power[np.abs(power) <= ROUNDING * np.abs(power).max()] = 0.0
    return PeriodicPower(knots, power)
