"""The timetable of least energy on a line where energy adds up over sections: a shortest path.

The backward train arrives ``a`` seconds after the departure of the forward one, and the forward one arrives
the sum of both running times less ``a`` after the departure of the backward one. In the next section the
backward train has arrived so much, and both dwells at the station, before the forward one departs. So ``a``
in one section follows from that of the section before and the changes of dwells and running times, which add
up to none over the line.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray
from scipy.ndimage import minimum_filter1d

from metropilot._typing import Float, Int


class SectionCost(NamedTuple):
    """Energy of both trips of a section.

    Attributes:
        energy_j: By ``a`` modulo the headway, whole seconds, and by the sum of both running times.
            Shape (H, C).
        least_s: The first of these sums.
        planned_s: The planned one.
    """

    energy_j: Float[ndarray, "headway sums"]
    least_s: int
    planned_s: int

    @classmethod
    def divide(
        cls,
        energies_j: Iterable[Float[ndarray, "headway other"]],
        changes_s: tuple[range, range],
        planned_s: int,
    ) -> SectionCost:
        """Least energy however the sum of both running times is divided.

        Args:
            energies_j: By ``a`` and by the change of the second running time, for each change of the first.
            changes_s: Changes of both.
            planned_s: Planned sum.
        """
        count = len(changes_s[1])
        least_j = np.empty((0, 0))
        for first, energy_j in enumerate(energies_j):
            if not first:
                least_j = np.full((energy_j.shape[0], len(changes_s[0]) + count - 1), np.inf)
            here = least_j[:, first : first + count]
            np.minimum(here, energy_j, out=here)
        return cls(least_j, planned_s + changes_s[0][0] + changes_s[1][0], planned_s)

    def add_price(self, price_w: float) -> SectionCost:
        """The same with every second more than planned at a price."""
        change_s = self.least_s - self.planned_s + np.arange(self.energy_j.shape[1])
        return self._replace(energy_j=self.energy_j + price_w * change_s)


class LeastPath(NamedTuple):
    """Path of least energy.

    Attributes:
        energy_j: Its energy.
        arrives_s: ``a`` in each section, modulo the headway. Shape (S,).
        running_change_s: Change of the sum of running times in each section. Shape (S,).
        dwell_change_s: Change of the sum of dwells at each station on the way. Shape (S-1,).
    """

    energy_j: float
    arrives_s: Int[ndarray, " sections"]
    running_change_s: Int[ndarray, " sections"]
    dwell_change_s: Int[ndarray, " stations"]


def find_least_path(sections: Sequence[SectionCost], dwell_s: int, window_s: int) -> LeastPath:
    """Find the path of least energy over all ``a`` in the first section.

    Args:
        sections: Energies, in the order of the line.
        dwell_s: Planned sum of both dwells at a station.
        window_s: Most by which it may change.
    """
    headway_s = sections[0].energy_j.shape[0]
    *_, last = _sweep(sections, dwell_s, window_s, np.arange(headway_s))
    none = last.shape[1] // 2
    start = int(np.argmin(last[:, none]))
    stages = [stage[0] for stage in _sweep(sections, dwell_s, window_s, np.array([start]))]
    changes: list[int] = []
    arrives: list[int] = []
    at = none
    planned_s = _planned_before(sections, dwell_s)
    for k in range(len(stages) - 1, 0, -1):
        section, on_way = divmod(k - 1, 2)
        if on_way:
            by = np.arange(-window_s, window_s + 1)
            cost = stages[k - 1][np.clip(at - by, 0, 2 * none)]
        else:
            here = sections[section]
            by = here.least_s - here.planned_s + np.arange(here.energy_j.shape[1])
            from_ = np.clip(at - by, 0, 2 * none)
            a = (start - planned_s[section] - (from_ - none)) % headway_s
            cost = stages[k - 1][from_] + here.energy_j[a, np.arange(by.size)]
            arrives.append(int(a[np.argmin(cost)]))
        changes.append(int(by[np.argmin(cost)]))
        at -= changes[-1]
    changes.reverse()
    arrives_s = np.array(arrives[::-1], int)
    return LeastPath(
        float(last[start, none]), arrives_s, np.array(changes[::2], int), np.array(changes[1::2], int)
    )


def _planned_before(sections: Sequence[SectionCost], dwell_s: int) -> list[int]:
    """Planned sums of times before each section: by so much ``a`` falls."""
    return np.cumsum([0, *(each.planned_s + dwell_s for each in sections[:-1])]).tolist()


def _sweep(
    sections: Sequence[SectionCost], dwell_s: int, window_s: int, starts: Int[ndarray, " starts"]
) -> Iterator[Float[ndarray, "starts changes"]]:
    """Least energy so far by ``a`` in the first section and by the change so far.

    At the departure, and then after each section and each station.
    """
    headway_s = sections[0].energy_j.shape[0]
    firsts = [each.least_s - each.planned_s for each in sections]
    counts = [each.energy_j.shape[1] for each in sections]
    most = sum(max(-first, first + count - 1) for first, count in zip(firsts, counts, strict=True))
    most += (len(sections) - 1) * window_s
    change_s = np.arange(-most, most + 1)
    least = np.where(change_s == 0, 0.0, np.inf) + np.zeros((starts.size, 1))
    yield least
    for k, before_s in enumerate(_planned_before(sections, dwell_s)):
        if k:
            if window_s:
                least = minimum_filter1d(least, 2 * window_s + 1, axis=1, mode="constant", cval=np.inf)
            yield least
        arrives_s = (starts[:, None] - before_s - change_s) % headway_s
        moved = np.full_like(least, np.inf)
        for column, cost in enumerate(sections[k].energy_j.T):
            # nothing within reach is rolled round the ends
            np.minimum(moved, np.roll(least + cost[arrives_s], firsts[k] + column, axis=1), out=moved)
        least = moved
        yield least
