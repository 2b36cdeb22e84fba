"""The least net energy of two trips that receive what the other returns while it draws.

What is received when is a matter of time, the programme of a plan one over distance. A drive that costs
little more than the least is nearly fixed in time, though: how early and how late it can be at a place
follows from the same programme with a bound on a partial sum of its time. So two trips are one programme in
which groups of segments that can be passed at the same moment exchange energy; or they cost more by the
excess allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Int
from metropilot.physics import Track, Vehicle
from metropilot.planning.cone_program import Exchange, TimeBound
from metropilot.planning.optimal import solve_together_until_settled, solve_until_settled
from metropilot.planning.received import ReceivedEnergy

GROUP_S = 5.0
"""Time in which a plan passes a group of segments, about."""
PROBE_S, EVERY = 6.0, 2
"""How much earlier or later than the plan a drive is asked to be, at every second edge of a group."""
SPARE = 1.08
"""Share of the time of the flat-out run below which nobody is asked to be."""


class Passing(NamedTuple):
    """Passing times of a drive through each group of segments.

    Attributes:
        after_s: Earliest time after the departure at which it is there. Shape (G,).
        before_s: Latest time before the arrival, positive, from which on it is there no more. Shape (G,).
    """

    after_s: Float[ndarray, " groups"]
    before_s: Float[ndarray, " groups"]


class ExchangeTrip:
    """One trip: its least energy with all received, its groups, and when it passes them.

    Args:
        vehicle: Trainset, its efficiencies constant.
        track: Section.
        time_s: Planned running time.
        changes_s: Changes of it that a timetable may make, increasing.

    Attributes:
        time_s: Planned running time.
        least_j: Least energy by change.
        group: Group of each segment. Shape (N,).
    """

    def __init__(
        self, vehicle: Vehicle, track: Track, time_s: float, changes_s: Sequence[int] = (0,)
    ) -> None:
        energy = ReceivedEnergy(vehicle, track, time_s)
        self.time_s, self.longest_s = time_s, time_s + changes_s[-1]
        self.programme, self.flat_s = energy.programme, energy.clock_s
        self.mass_kg = float(self.programme.table.mass_kg)
        answer, _ = solve_until_settled(self.programme, energy.energy)
        self.energy = answer.energy
        self.second_w = answer.second * self.mass_kg
        self.least_j = {change: self._least_j(change) for change in changes_s}
        clock = np.concatenate([[0.0], np.cumsum(answer.time)])
        self._clock_s = clock * time_s / clock[-1]
        count = answer.time.size
        inner = np.searchsorted(self._clock_s, np.arange(GROUP_S, time_s - 0.5 * GROUP_S, GROUP_S))
        self._edges = np.unique(np.clip(inner, 1, count - 1))
        self.group = np.searchsorted(self._edges, np.arange(count), side="right")
        self._early = [self._probe(0, int(edge)) for edge in self._edges[::EVERY]]
        self._late = [self._probe(int(edge), count) for edge in self._edges[::EVERY]]

    def _least_j(self, change_s: int) -> float:
        """Least energy in another running time."""
        bounds = (TimeBound(0, self.programme.mesh.length_m.size, None, self.time_s + change_s),)
        return solve_until_settled(replace(self.programme, bounds=bounds), self.energy)[0].dual * self.mass_kg

    @property
    def edges_m(self) -> Float[ndarray, " edges"]:
        """Positions at which groups meet."""
        return self.programme.mesh.node_m[self._edges]

    @property
    def groups(self) -> int:
        """Number of groups."""
        return self._edges.size + 1

    def _probe(self, first: int, last: int) -> tuple[float, float, float, float]:
        """Time on a part, least energy of drives that take no longer there, and what a second saves there."""
        flat_s = float(self.flat_s[last] - self.flat_s[first])
        asked_s = float(self._clock_s[last] - self._clock_s[first]) - PROBE_S
        if asked_s < SPARE * flat_s + 0.2:
            return flat_s, 0.0, 0.0, 0.0
        whole = TimeBound(0, self._clock_s.size - 1, None, self.time_s)
        bounds = whole, TimeBound(first, last, None, asked_s)
        answer, _ = solve_until_settled(replace(self.programme, bounds=bounds), self.energy)
        whole_w, part_w = (second * self.mass_kg for second in answer.seconds)
        return asked_s, answer.dual * self.mass_kg, part_w, whole_w

    def passing(self, excess_j: float) -> Passing:
        """Find when drives of at most so much more than the least pass the groups, in any time allowed."""
        edges = self._edges
        after, before = self.flat_s[edges].copy(), self.flat_s[-1] - self.flat_s[edges]
        for least_s, probes in ((after, self._early), (before, self._late)):
            found = [self._least_s(probe, excess_j) for probe in probes]
            least_s[::EVERY] = np.maximum(least_s[::EVERY], found)
        return Passing(
            np.concatenate([[0.0], np.maximum.accumulate(after)]),
            np.concatenate([np.maximum.accumulate(before[::-1])[::-1], [0.0]]),
        )

    def _least_s(self, probe: tuple[float, float, float, float], excess_j: float) -> float:
        """Least time on a part: the cost is convex in it and in the running time, so above its tangent."""
        asked_s, energy_j, part_w, whole_w = probe
        if part_w <= 0.0:
            return 0.0
        # the excess is that over the least energy in the same running time
        most_j = excess_j + max(least_j + whole_w * change for change, least_j in self.least_j.items())
        return asked_s - (most_j - energy_j) / part_w


class PairBound(NamedTuple):
    """Net energy of two trips that no drives undercut, and what one more second of each saves."""

    bound_j: float
    second_w: tuple[float, float]


def exchange_bound(
    trips: Sequence[ExchangeTrip], pairs: Int[ndarray, "pairs 2"], taken_w: Float[ndarray, " groups"]
) -> PairBound:
    """Least net energy of two trips that exchange energy.

    Args:
        trips: Both.
        pairs: Group that returns and group that draws, where they can be passed at the same moment; groups of
            the second trip follow those of the first.
        taken_w: Power that each group's returns find in any case. Shape (G,).
    """
    first, second = trips
    group = np.concatenate([first.group, second.group + first.groups])
    exchange = Exchange(group, pairs, taken_w[group] / first.mass_kg)
    answers, dual = solve_together_until_settled(
        [each.programme for each in trips], [each.energy for each in trips], exchange
    )
    for trip, answer in zip(trips, answers, strict=True):
        trip.energy = answer.energy
    seconds = [each.second * first.mass_kg for each in answers]
    return PairBound(dual * first.mass_kg, (seconds[0], seconds[1]))
