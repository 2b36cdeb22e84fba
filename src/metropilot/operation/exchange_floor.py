"""Least energy of the two trips of a section that is a zone of its own, by when their trains meet.

What one train returns the other one receives only at moments at which both can be where they return and draw.
How narrowly that is known depends on how narrowly the arrival of the other train and both running times are:
a section is bounded cell by cell, each one more finely where it is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Int
from metropilot.operation.path import SectionCost
from metropilot.planning import ExchangeTrip, PairBound, Passing, exchange_bound
from metropilot.units import J_PER_KWH


class Resolution(NamedTuple):
    """Size of a cell.

    Attributes:
        arrives_s: Arrivals of the backward train that are bounded together.
        running_s: Running times of each trip that are bounded together.
        group_s: Time in which a plan passes a group of segments, about.
    """

    arrives_s: int
    running_s: int
    group_s: float


RESOLUTIONS = (
    Resolution(9, 9, 2.5),
    Resolution(9, 3, 2.5),
    Resolution(3, 3, 2.5),
    Resolution(3, 1, 1.25),
    Resolution(1, 1, 1.25),
)
"""Each finer than the one before."""
CELLS = 30
"""Cells of a headway at the coarsest resolution, at most."""
STEP_J, MORE, NEAR_J, TRIES = 0.8 * J_PER_KWH, 1.25, 0.2 * J_PER_KWH, 2
"""Drives that cost more than the least by an excess are not looked at: both trips cost that much more, or as
much as the others. The excess tried first, or this much more than what is known; how near to the best is near
enough; how many are tried."""


class SectionTrips(NamedTuple):
    """The trips of a section.

    Attributes:
        trips: Forward and backward.
        planned_s: Planned running time of each.
        changes_s: Changes of it that a timetable may make, of each.
        rest_s: Longest dwell after each in this zone.
        own_w: Auxiliary power of a train.
        headway_s: Headway.
    """

    trips: tuple[ExchangeTrip, ExchangeTrip]
    planned_s: tuple[int, int]
    changes_s: tuple[range, range]
    rest_s: tuple[int, int]
    own_w: float
    headway_s: int


class _Cell(NamedTuple):
    """Arrivals of the backward train after the departure of the forward one, and running times of both."""

    arrives_s: tuple[int, int]
    running_s: tuple[range, range]

    @property
    def sums_s(self) -> tuple[int, int]:
        """Least and most sum of both running times."""
        return sum(each[0] for each in self.running_s), sum(each[-1] for each in self.running_s)

    @property
    def leads_s(self) -> tuple[int, int]:
        """Least and most time after the departure of the backward train at which the forward one arrives."""
        return self.sums_s[0] - self.arrives_s[1], self.sums_s[1] - self.arrives_s[0]


class SectionFloor:
    """Least net energy of both trips of a section, sharper cell by cell.

    Args:
        section: Its trips.
        known_j: Energies that are known not to be undercut, in the beginning: see ``energy_j``.

    Attributes:
        energy_j: By the second at which the backward train arrives and the change of each running time.
            Shape (H, A, B).
        solved: Programmes of both trips that were solved.
    """

    def __init__(self, section: SectionTrips, known_j: Float[ndarray, "headway own other"]) -> None:
        self._section = section
        each = zip(section.trips, section.changes_s, strict=True)
        least = [[trip.least_j[change] for change in own] for trip, own in each]
        self._grouped = {
            size.group_s: tuple(trip.regroup(size.group_s) for trip in section.trips) for size in RESOLUTIONS
        }
        self._least_j = np.add.outer(*least)
        self.energy_j = np.maximum(known_j, self._least_j)
        self.solved = 0
        self._level = np.zeros(self.energy_j.shape, dtype=int)
        self._found: dict[tuple[float, tuple[int, int], bytes, bytes], PairBound] = {}
        firsts = [own[0] for own in section.changes_s]
        self._column = np.add.outer(*(np.array(own) - own[0] for own in section.changes_s))
        self._planned_s = sum(section.planned_s)
        self._least_s = self._planned_s + sum(firsts)

    def cost(self) -> SectionCost:
        """Least energy by arrival and sum of both running times, however the sum is divided."""
        by_own_j = np.moveaxis(self.energy_j, 1, 0)
        return SectionCost.divide(by_own_j, self._section.changes_s, self._planned_s)

    def refine(self, arrives_s: int, change_s: int) -> bool:
        """Bound the cell that is least at an arrival and a change of the sum more finely.

        Returns:
            True if it could be.
        """
        row, column = arrives_s % self._section.headway_s, change_s + self._planned_s - self._least_s
        divided = np.where(self._column == column, self.energy_j[row], np.inf)
        own, other = np.unravel_index(int(np.argmin(divided)), divided.shape)
        level = int(self._level[row, own, other])
        if level == len(RESOLUTIONS):
            return False
        size, headway_s = RESOLUTIONS[level], self._section.headway_s
        wide = math.ceil(headway_s / CELLS) if level == 0 else 0
        rows = _around(row, max(size.arrives_s, wide), headway_s)
        changes = [
            _around(int(k), size.running_s, n) for k, n in zip((own, other), divided.shape, strict=True)
        ]
        cut = np.ix_(rows, *changes)
        running_s = [
            range(planned + every[own[0]], planned + every[own[-1]] + 1)
            for planned, every, own in zip(
                self._section.planned_s, self._section.changes_s, changes, strict=True
            )
        ]
        cell = _Cell((rows[0], rows[-1] + 1), (running_s[0], running_s[1]))
        known_j = self.energy_j[cut]
        self.energy_j[cut] = np.maximum(
            known_j, self._bound(cell, changes, known_j.min(axis=0), size.group_s)
        )
        self._level[cut] = np.maximum(self._level[cut], level + 1)
        return True

    def _bound(
        self, cell: _Cell, changes: Sequence[range], known_j: Float[ndarray, "own other"], group_s: float
    ) -> Float[ndarray, "own other"]:
        """Least energies of a cell by the changes of both running times, with the best excess found."""
        least_j = self._least_j[np.ix_(*changes)]
        of = [np.array(every)[list(own)] for every, own in zip(self._section.changes_s, changes, strict=True)]
        middle_s = int(of[0][of[0].size // 2]), int(of[1][of[1].size // 2])
        own_s, other_s = (every - middle for every, middle in zip(of, middle_s, strict=True))
        best_j = known_j - least_j
        low_j, high_j = float(best_j.min()), math.inf
        excess_j = max(MORE * low_j, low_j + STEP_J)
        for _ in range(TRIES):
            both = self._exchange(cell, excess_j, group_s, middle_s)
            # the bound is convex in the running times, so never below its tangent
            sloped_j = np.add.outer(both.second_w[0] * own_s, both.second_w[1] * other_s)
            more_j = both.bound_j - sloped_j - least_j
            best_j = np.maximum(best_j, np.minimum(more_j, excess_j))
            least_more_j = float(more_j.min())
            # the more excess, the less they cost: the best is where both are the same
            if least_more_j >= excess_j:
                low_j = excess_j
                excess_j = 2.0 * excess_j if math.isinf(high_j) else 0.5 * (low_j + high_j)
            else:
                low_j, high_j = max(low_j, least_more_j), excess_j
                excess_j = 0.5 * (low_j + high_j)
            if high_j - low_j < NEAR_J:
                break
        return least_j + best_j

    def _exchange(
        self, cell: _Cell, excess_j: float, group_s: float, changes_s: tuple[int, int]
    ) -> PairBound:
        trips, section = self._grouped[group_s], self._section
        spans = [_Span.of(trip, own, excess_j) for trip, own in zip(trips, cell.running_s, strict=True)]
        pairs = _pairs(cell, spans, section.headway_s)
        taken_w = section.own_w * (1.0 + _others(cell, spans, section))
        # where nobody meets, cells are alike
        key = group_s, changes_s, pairs.tobytes(), taken_w.tobytes()
        if key not in self._found:
            self._found[key] = exchange_bound(trips, pairs, taken_w, changes_s)
            self.solved += 1
        return self._found[key]


def _around(k: int, size: int, count: int) -> range:
    """Cell of so many that one of so many is in."""
    first = k // size * size
    return range(first, min(first + size, count))


class _Span(NamedTuple):
    """Times at which the groups of a trip can be passed.

    Attributes:
        from_s: First time after the departure. Shape (G,).
        to_s: Last one. Shape (G,).
        first_s: First time before the arrival, negative. Shape (G,).
        last_s: Last one. Shape (G,).
        longest_s: Longest running time.
    """

    from_s: Float[ndarray, " groups"]
    to_s: Float[ndarray, " groups"]
    first_s: Float[ndarray, " groups"]
    last_s: Float[ndarray, " groups"]
    longest_s: int

    @classmethod
    def of(cls, trip: ExchangeTrip, running_s: range, excess_j: float) -> _Span:
        """Times of drives that cost no more than the least by an excess."""
        passing: Passing = trip.passing(excess_j, running_s)
        longest_s = running_s[-1]
        return cls(
            passing.after_s,
            longest_s - passing.before_s,
            passing.after_s - longest_s,
            -passing.before_s,
            longest_s,
        )


def _meet(
    one: tuple[ndarray, ndarray], other: tuple[ndarray, ndarray], headway_s: int
) -> tuple[ndarray, ndarray]:
    """First and last number of headways by which intervals of another train meet those of one."""
    first = np.ceil((one[0][:, None] - other[1]) / headway_s)
    last = np.floor((one[1][:, None] - other[0]) / headway_s)
    return first, last


def _pairs(cell: _Cell, spans: Sequence[_Span], headway_s: int) -> Int[ndarray, "pairs 2"]:
    """Groups that can be passed at the same moment."""
    forward, backward = spans
    # the backward train is seen from the departure of the forward one, and the other way round
    across = np.ones((forward.from_s.size, backward.from_s.size), dtype=bool)
    for own, other, comes_s in ((forward, backward, cell.arrives_s), (backward, forward, cell.leads_s)):
        seen = comes_s[0] + other.first_s, comes_s[1] + other.last_s
        low, high = _meet((own.from_s, own.to_s), seen, headway_s)
        across &= (high >= low) if own is forward else (high >= low).T
    count = forward.from_s.size
    size = count + backward.from_s.size
    may = np.zeros((size, size), dtype=bool)
    may[:count, count:], may[count:, :count] = across, across.T
    for of, own in ((slice(0, count), forward), (slice(count, size), backward)):
        low, high = _meet((own.from_s, own.to_s), (own.from_s, own.to_s), headway_s)
        # a train does not meet itself, but the next one of its direction
        may[of, of] = (high >= np.maximum(low, 1)) | (low <= np.minimum(high, -1))
    return np.argwhere(may)


def _others(cell: _Cell, spans: Sequence[_Span], section: SectionTrips) -> Float[ndarray, " groups"]:
    """Most other trains in the zone, under way or at the platform, while each group is passed."""
    counts = []
    for which, comes_s in ((0, cell.arrives_s), (1, cell.leads_s)):
        own, other = (spans[which].from_s, spans[which].to_s), 1 - which
        there_s = comes_s[0] - spans[other].longest_s, comes_s[1] + section.rest_s[other]
        low, high = _meet(own, (np.array(there_s[:1]), np.array(there_s[1:])), section.headway_s)
        stays_s = np.array([spans[which].longest_s + section.rest_s[which]])
        own_low, own_high = _meet(own, (np.zeros(1), stays_s), section.headway_s)
        counts.append(np.maximum(high - low + 1.0, 0.0)[:, 0] + (own_high - own_low)[:, 0])
    return np.concatenate(counts)
