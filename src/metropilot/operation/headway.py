"""Least technical headway of a timetable, and the longest dwells that a headway leaves.

The blocking times of :mod:`metropilot.convoy.blocking` for the trips as they are planned. Trains of a
direction are a headway apart, so what one needs of the one ahead follows from the trips themselves: a longer
dwell blocks the platform longer by as much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.convoy import (
    BlockingTimes,
    Member,
    ServiceRun,
    blocking_times,
    first_times,
    reach_m,
    sample_run,
    trainset_behind,
)
from metropilot.errors import InputError
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.power import PowerProfile

OVERLAP_M = 100.0
"""No supervisor asks for so much beyond a stop: who has left it so far behind disturbs nobody there."""
PLACE_M = 2.0
ROUNDING_S = 1e-6


def line_headways(
    operation: LineOperation, timetable: Timetable, profiles: Profiles
) -> tuple[BlockingTimes, BlockingTimes]:
    """Blocking times of a timetable forward and backward, with the headway of every section and station.

    Args:
        operation: Line in operation.
        timetable: Timetable.
        profiles: Its trips.
    """
    options, members = operation.options, _Members(operation)
    found = []
    for first in (0, operation.count):
        of = range(first, first + operation.count)
        sections = [operation.trips[k].section for k in of]
        from_m = np.cumsum([0.0, *(section.length_m for section in sections[:-1])])
        nodes = []
        for i, k in enumerate(of):
            profile = profiles[k][int(timetable.running_time_s[k])]
            departs_s = float(timetable.departure_s[k] - timetable.departure_s[first])
            nodes.append(_nodes(profile, departs_s, float(from_m[i]), i))
        blocks_m = None if options.blocks is None else [each.length_m / options.blocks for each in sections]
        found.append(
            blocking_times(
                sample_run(nodes, from_m),
                [members[k] for k in of],
                sections,
                operation.trainset.length_m,
                options.age_s,
                blocks_m,
            )
        )
    return found[0], found[1]


def _nodes(
    profile: PowerProfile, departs_s: float, from_m: float, section: int
) -> tuple[ndarray, ndarray, ndarray, ndarray, ndarray]:
    """Time, position, speed, acceleration and section; after the last node the train stands."""
    lasts_s = np.diff(profile.time_s)
    rate = np.divide(np.diff(profile.speed_mps), lasts_s, out=np.zeros_like(lasts_s), where=lasts_s > 0)
    speed = np.append(profile.speed_mps[:-1], 0.0)
    time, position = departs_s + profile.time_s, from_m + profile.position_m
    return time, position, speed, np.append(rate, 0.0), np.full(time.size, section)


def check_headway(operation: LineOperation, timetable: Timetable, profiles: Profiles) -> None:
    """Refuse a headway at which trains disturb one another.

    Args:
        operation: Line in operation.
        timetable: Timetable.
        profiles: Its trips.

    Raises:
        InputError: Naming the section or station that binds, its least headway and the direction.
    """
    options, running_s = operation.options, timetable.running_time_s
    both_s = running_s + np.roll(running_s, -1) + operation.dwells_s(timetable)
    if options.headway_s >= options.age_s + float(both_s.max()):
        # the train ahead is two stations on when the next one sets out
        return
    found = line_headways(operation, timetable, profiles)
    backward = found[1].headway_s > found[0].headway_s
    least = found[backward].bottleneck
    if operation.options.headway_s < least.headway_s - ROUNDING_S:
        block = "a moving block" if operation.options.blocks is None else "fixed blocks"
        way = ("forward", "backward")[backward]
        raise InputError(
            f"trains disturb one another at {least.kind} {least.name}, {way}",
            field="headway_s",
            value=operation.options.headway_s,
            unit="s",
            allowed=f"at least {math.ceil(least.headway_s)} s with {block}",
        )


class _Members:
    """A trainset behind another on the section of each trip, made when asked for."""

    def __init__(self, operation: LineOperation) -> None:
        self._operation = operation
        # the protection of a section takes some tenths of a second, and no headway or dwell changes it
        self._made = operation.members

    def __getitem__(self, trip: int) -> Member:
        if trip not in self._made:
            section = self._operation.trips[trip].section
            self._made[trip] = trainset_behind(section, self._operation.trainset)
        return self._made[trip]


class LongestDwells:
    """Longest dwell after each trip with which trains a headway apart do not disturb one another.

    By running time and plan of the trip, whatever those of the next one: it leaves as the slowest does.

    Args:
        operation: Line in operation.
        plans: Profiles to choose from.
    """

    def __init__(self, operation: LineOperation, plans: Sequence[Profiles]) -> None:
        self._operation, self._plans, self._members = operation, plans, _Members(operation)
        self._found: dict[tuple[int, int, int], float] = {}
        beyond = np.arange(0.0, operation.trainset.length_m + OVERLAP_M, PLACE_M)
        self._beyond_m = np.append(beyond, beyond[-1] + PLACE_M)
        self._leaves_s = [self._leave(k) for k in range(len(operation.trips))]

    def _leave(self, trip: int) -> Float[ndarray, " places"]:
        """Time from the departure of a trip to each distance, of the slowest of its drives."""
        drives = [each for of in self._plans for each in of[trip].values()]
        return np.max([first_times(p.time_s, p.position_m, self._beyond_m) for p in drives], axis=0)

    def __call__(self, trip: int, running_s: int, plan: int) -> float:
        """Longest dwell after a trip; minus infinity if it disturbs the next train even without one."""
        key = trip, running_s, plan
        if key not in self._found:
            self._found[key] = self._longest(*key)
        return self._found[key]

    def _longest(self, trip: int, running_s: int, plan: int) -> float:
        operation, options = self._operation, self._operation.options
        last = trip in {operation.count - 1, len(operation.trips) - 1}
        leaves_s = np.zeros_like(self._beyond_m) if last else self._leaves_s[trip + 1]
        far_s = options.headway_s - options.age_s - running_s - float(leaves_s[-1])
        if far_s >= options.dwell_s + options.dwell_window_s:
            # the train ahead has left the next station when this one sets out
            return math.inf
        profile, length_m = self._plans[plan][trip][running_s], operation.trainset.length_m
        run = sample_run([_nodes(profile, 0.0, 0.0, 0)], np.zeros(1))
        to_m, from_s = self._blocks(run, trip)
        end_m = float(profile.position_m[-1])
        behind = to_m > end_m - length_m
        passes_s = first_times(run.time_s, run.position_m - length_m, to_m)
        after_s = running_s + np.interp(to_m - end_m + length_m, self._beyond_m, leaves_s)
        held_s = np.where(behind, after_s, passes_s) - from_s + options.age_s
        if held_s[~behind].max(initial=0.0) > options.headway_s + ROUNDING_S:
            return -math.inf
        return options.headway_s - float(held_s[behind].max(initial=0.0)) + ROUNDING_S

    def _blocks(self, run: ServiceRun, trip: int) -> tuple[ndarray, ndarray]:
        """End and first time of the blocks of a trip, and of what is asked for beyond its end."""
        reach, end_m = reach_m(run, [self._members[trip]]), float(run.position_m[-1])
        if self._operation.options.blocks is None:
            from_m = to_m = np.arange(reach[0], max(reach[-1], end_m), PLACE_M)
        else:
            edges = np.linspace(0.0, end_m, self._operation.options.blocks + 1)
            edges = np.append(edges, max(reach[-1], end_m + PLACE_M))
            from_m, to_m = edges[:-1], edges[1:]
        return to_m, first_times(run.time_s, reach, from_m)
