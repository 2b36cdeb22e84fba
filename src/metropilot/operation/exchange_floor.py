"""Least energy of the two trips of a section that is a zone of its own, by when their trains meet.

What one train returns the other one receives only at moments at which both can be where they return and draw.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.planning import ExchangeTrip, PairBound, Passing, exchange_bound
from metropilot.units import J_PER_KWH

CELL_S, CELLS, SUM_S = 9, 30, 6
"""Arrivals are bounded together in cells of so many seconds, or so many in a headway if those are longer, and
sums of both running times in cells of so many seconds."""
EXCESS_J = 2.5 * J_PER_KWH
"""Drives of both trips that cost more than the least by this are not looked at: that much they cost."""


class SectionTrips(NamedTuple):
    """The trips of a section.

    Attributes:
        trips: Forward and backward.
        rest_s: Longest dwell after each in this zone.
        own_w: Auxiliary power of a train.
        headway_s: Headway.
    """

    trips: tuple[ExchangeTrip, ExchangeTrip]
    rest_s: tuple[int, int]
    own_w: float
    headway_s: int

    @property
    def sums_s(self) -> Sequence[int]:
        """Sums of both running times, increasing by a second."""
        low, high = (sum(round(t.time_s) + pick(t.least_j) for t in self.trips) for pick in (min, max))
        return range(low, high + 1)


def pair_energies(section: SectionTrips) -> Float[ndarray, "headway sums"]:
    """Least net energy by the second at which the backward train arrives and the sum of both running times.

    The least over how the sum is divided between the trips.
    """
    passing = [trip.passing(EXCESS_J) for trip in section.trips]
    energy_j = np.full((section.headway_s, len(section.sums_s)), np.inf)
    found: dict[bytes, PairBound] = {}
    cell_s = max(CELL_S, math.ceil(section.headway_s / CELLS))
    for rows in _cells(range(section.headway_s), cell_s):
        for columns in _cells(range(len(section.sums_s)), SUM_S):
            arrives_s = float(rows.start), float(rows.stop)
            sums_s = section.sums_s[columns.start], section.sums_s[columns.stop - 1]
            pairs = _pairs(section, passing, arrives_s, sums_s)
            taken_w = section.own_w * (1.0 + _others(section, passing, arrives_s, sums_s))
            # where nobody meets, cells are alike
            key = pairs.tobytes() + taken_w.tobytes()
            if key not in found:
                found[key] = exchange_bound(section.trips, pairs, taken_w)
            for column in columns:
                energy_j[rows.start : rows.stop, column] = _divide(section, found[key], column)
    return energy_j


def _divide(section: SectionTrips, both: PairBound, column: int) -> float:
    """Least energy over how a sum of running times is divided."""
    forward, backward = (trip.least_j for trip in section.trips)
    change = section.sums_s[column] - sum(round(trip.time_s) for trip in section.trips)
    divided = [(own, change - own) for own in forward if change - own in backward]
    return min(_at_least(forward[own] + backward[other], both, own, other) for own, other in divided)


def _cells(whole: range, size: int) -> list[range]:
    return [range(k, min(k + size, whole.stop)) for k in range(whole.start, whole.stop, size)]


def _at_least(least_j: float, both: PairBound, own_s: int, other_s: int) -> float:
    """Energy in other running times: the bound is convex in them, and with more excess they cost it."""
    exchanged_j = both.bound_j - both.second_w[0] * own_s - both.second_w[1] * other_s
    return max(least_j, min(least_j + EXCESS_J, exchanged_j))


def _meet(
    one: tuple[ndarray, ndarray], other: tuple[ndarray, ndarray], headway_s: int
) -> tuple[ndarray, ndarray]:
    """First and last number of headways by which intervals of another train meet those of one."""
    first = np.ceil((one[0][:, None] - other[1]) / headway_s)
    last = np.floor((one[1][:, None] - other[0]) / headway_s)
    return first, last


def _after(section: SectionTrips, which: int, passing: Passing) -> tuple[ndarray, ndarray]:
    """Times after the departure at which groups are passed."""
    return passing.after_s, section.trips[which].longest_s - passing.before_s


def _pairs(
    section: SectionTrips,
    passing: Sequence[Passing],
    arrives_s: tuple[float, float],
    sums_s: tuple[int, int],
) -> ndarray:
    """Groups that can be passed at the same moment."""
    forward, backward = (_after(section, which, passing[which]) for which in (0, 1))
    longest_s, headway_s = [trip.longest_s for trip in section.trips], section.headway_s
    # after the departure of the forward train the backward one is so long before its arrival
    seen = arrives_s[0] - (longest_s[1] - passing[1].after_s), arrives_s[1] - passing[1].before_s
    low, high = _meet(forward, seen, headway_s)
    # and after the departure of the backward one the forward one before its own
    leads_s = sums_s[0] - arrives_s[1], sums_s[1] - arrives_s[0]
    turned = leads_s[0] - (longest_s[0] - passing[0].after_s), leads_s[1] - passing[0].before_s
    other_low, other_high = _meet(backward, turned, headway_s)
    across = (high >= low) & (other_high >= other_low).T
    count = forward[0].size
    size = count + backward[0].size
    may = np.zeros((size, size), dtype=bool)
    may[:count, count:], may[count:, :count] = across, across.T
    for of, own in ((slice(0, count), forward), (slice(count, size), backward)):
        low, high = _meet(own, own, headway_s)
        # a train does not meet itself, but the next one of its direction
        may[of, of] = (high >= np.maximum(low, 1)) | (low <= np.minimum(high, -1))
    return np.argwhere(may)


def _others(
    section: SectionTrips,
    passing: Sequence[Passing],
    arrives_s: tuple[float, float],
    sums_s: tuple[int, int],
) -> ndarray:
    """Most other trains in the zone, under way or at the platform, while each group is passed."""
    leads_s = sums_s[0] - arrives_s[1], sums_s[1] - arrives_s[0]
    counts = []
    for which, comes_s in ((0, arrives_s), (1, leads_s)):
        own, other = _after(section, which, passing[which]), 1 - which
        there_s = comes_s[0] - section.trips[other].longest_s, comes_s[1] + section.rest_s[other]
        low, high = _meet(own, (np.array(there_s[:1]), np.array(there_s[1:])), section.headway_s)
        stays_s = np.array([section.trips[which].longest_s + section.rest_s[which]])
        own_low, own_high = _meet(own, (np.zeros(1), stays_s), section.headway_s)
        counts.append(np.maximum(high - low + 1.0, 0.0)[:, 0] + (own_high - own_low)[:, 0])
    return np.concatenate(counts)
