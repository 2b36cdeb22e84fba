"""The least net energy of two trips that receive what the other returns while it draws.

What is received when is a matter of time, the programme of a plan one over distance. A drive that costs
little more than the least is nearly fixed in time, though: how early and how late it can be at a place
follows from the same programme with a bound on a partial sum of its time. So two trips are one programme in
which groups of segments that can be passed at the same moment exchange energy; or they cost more by the
excess allowed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Int
from metropilot.physics import Track, Vehicle
from metropilot.planning.cone_program import Exchange, Programme, TimeBound
from metropilot.planning.optimal import solve_together_until_settled, solve_until_settled
from metropilot.planning.received import ReceivedEnergy

PROBED_S, PROBES_S = 10.0, (1.5, 3.0, 6.0)
"""Every so many seconds of the plan drives are asked to be earlier or later there, by so much."""
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


class _Probe(NamedTuple):
    """Least energy of drives that are no longer on a part of the section than a time.

    Attributes:
        asked_s: Time on the part.
        energy_j: Least energy, in the planned running time.
        part_w: What one second more on the part saves.
        whole_w: What one second more of running time saves.
    """

    asked_s: float
    energy_j: float
    part_w: float
    whole_w: float


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
        energies: Kinetic energy per kg at the nodes of the last answer, by change. Each of shape (N+1,).
        group: Group of each segment. Shape (N,).
    """

    def __init__(
        self, vehicle: Vehicle, track: Track, time_s: float, changes_s: Sequence[int] = (0,)
    ) -> None:
        energy = ReceivedEnergy(vehicle, track, time_s)
        self.time_s = time_s
        self.programme, self.flat_s, self._bounds = energy.programme, energy.clock_s, energy.in_time
        self.mass_kg = float(self.programme.table.mass_kg)
        # near the minimum running time only the curves about the flat-out run have a drive in time
        found = {
            change: solve_until_settled(self.in_time(change), energy.energy)[0] for change in {0, *changes_s}
        }
        self.least_j = {change: found[change].dual * self.mass_kg for change in changes_s}
        self.energies = {change: each.energy for change, each in found.items()}
        answer = found[0]
        self.second_w = answer.second * self.mass_kg
        clock = np.concatenate([[0.0], np.cumsum(answer.time)])
        self._clock_s = clock * time_s / clock[-1]
        count = answer.time.size
        self._probed = self._nodes_every(PROBED_S)
        self._early = [self._probes(0, node) for node in self._probed.tolist()]
        self._late = [self._probes(node, count) for node in self._probed.tolist()]
        self.divide(5.0)

    def regroup(self, group_s: float) -> ExchangeTrip:
        """The same in other groups."""
        other = copy(self)
        other.divide(group_s)
        return other

    def divide(self, group_s: float) -> None:
        """Divide the section into other groups."""
        self._edges = self._nodes_every(group_s)
        self.group = np.searchsorted(self._edges, np.arange(self._clock_s.size - 1), side="right")

    def _nodes_every(self, seconds: float) -> Int[ndarray, " nodes"]:
        """Nodes that the plan passes about so many seconds one after the other, without both ends."""
        at_s = np.arange(seconds, self.time_s - 0.5 * seconds, seconds)
        return np.unique(np.clip(np.searchsorted(self._clock_s, at_s), 1, self._clock_s.size - 2))

    def in_time(self, change_s: int) -> Programme:
        """Programme of another running time."""
        return replace(self.programme, bounds=self._bounds(self.time_s + change_s))

    @property
    def edges_m(self) -> Float[ndarray, " edges"]:
        """Positions at which groups meet."""
        return self.programme.mesh.node_m[self._edges]

    @property
    def groups(self) -> int:
        """Number of groups."""
        return self._edges.size + 1

    def _probes(self, first: int, last: int) -> list[_Probe]:
        """Drives that are faster on a part, as far as the flat-out run allows."""
        flat_s = float(self.flat_s[last] - self.flat_s[first])
        planned_s = float(self._clock_s[last] - self._clock_s[first])
        found: list[_Probe] = []
        for early_s in PROBES_S:
            asked_s = planned_s - early_s
            if asked_s < SPARE * flat_s + 0.2:
                break
            bounds = *self._bounds(self.time_s), TimeBound(first, last, None, asked_s)
            answer, _ = solve_until_settled(replace(self.programme, bounds=bounds), self.energies[0])
            whole_w, part_w = (second * self.mass_kg for second in answer.seconds)
            found.append(_Probe(asked_s, answer.dual * self.mass_kg, part_w, whole_w))
        return found

    def passing(self, excess_j: float, running_s: Iterable[int]) -> Passing:
        """Find when drives of at most so much more than the least pass the groups, in these running times."""
        changes = [s - round(self.time_s) for s in running_s]
        after, before = np.zeros((2, self.flat_s.size))
        for least_s, probes in ((after, self._early), (before, self._late)):
            least_s[self._probed] = [
                max((self._least_s(probe, excess_j, changes) for probe in each), default=0.0)
                for each in probes
            ]
        # from one place to the next none is faster than the flat-out run
        left_s = self.flat_s[-1] - self.flat_s
        after = self.flat_s + np.maximum.accumulate(np.maximum(after - self.flat_s, 0.0))
        before = left_s + np.maximum.accumulate(np.maximum(before - left_s, 0.0)[::-1])[::-1]
        return Passing(
            np.concatenate([[0.0], after[self._edges]]), np.concatenate([before[self._edges], [0.0]])
        )

    def _least_s(self, probe: _Probe, excess_j: float, changes_s: Sequence[int]) -> float:
        """Least time on a part: the cost is convex in it and in the running time, so above its tangent."""
        if probe.part_w <= 0.0:
            return 0.0
        # the excess is that over the least energy in the same running time
        most_j = excess_j + max(self.least_j[change] + probe.whole_w * change for change in changes_s)
        return probe.asked_s - (most_j - probe.energy_j) / probe.part_w


class PairBound(NamedTuple):
    """Net energy of two trips that no drives undercut, and what one more second of each saves."""

    bound_j: float
    second_w: tuple[float, float]


def exchange_bound(
    trips: Sequence[ExchangeTrip],
    pairs: Int[ndarray, "pairs 2"],
    taken_w: Float[ndarray, " groups"],
    changes_s: tuple[int, int] = (0, 0),
) -> PairBound:
    """Least net energy of two trips that exchange energy.

    Args:
        trips: Both.
        pairs: Group that returns and group that draws, where they can be passed at the same moment; groups of
            the second trip follow those of the first.
        taken_w: Power that each group's returns find in any case. Shape (G,).
        changes_s: Changes of the running times of both, each one that its trip allows.
    """
    first, second = trips
    group = np.concatenate([first.group, second.group + first.groups])
    exchange = Exchange(group, pairs, taken_w[group] / first.mass_kg)
    answers, dual = solve_together_until_settled(
        [each.in_time(change) for each, change in zip(trips, changes_s, strict=True)],
        [each.energies[change] for each, change in zip(trips, changes_s, strict=True)],
        exchange,
    )
    for trip, change, answer in zip(trips, changes_s, answers, strict=True):
        trip.energies[change] = answer.energy
    seconds = [each.second * first.mass_kg for each in answers]
    return PairBound(dual * first.mass_kg, (seconds[0], seconds[1]))
