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
    ServiceRun,
    blocking_times,
    first_times,
    reach_m,
    sample_run,
    trainset_behind,
    watched_places,
)
from metropilot.errors import InputError
from metropilot.operation.day import DayTimetable, PeriodicPart
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.power import PowerProfile
from metropilot.units import format_clock

OVERLAP_M = 100.0
"""No supervisor asks for so much beyond a stop: who has left it so far behind disturbs nobody there."""
PLACE_M = 2.0
SAMPLE_S = 0.5
"""Interval at which motions are looked at."""
ROUNDING_S = 1e-6


class TripMotions:
    """Motion of trips, and how far ahead each must have the way free, whatever headway and dwells.

    Made when asked for, and kept with the operation and whatever is the same at another headway.

    Args:
        operation: Line in operation.
    """

    def __init__(self, operation: LineOperation) -> None:
        self._operation, self._members, self._made = operation, operation.members, operation.motions

    def motion(self, trip: int, profile: PowerProfile) -> tuple[ServiceRun, Float[ndarray, " times"]]:
        """Motion of a trip by itself, and the farthest place that it must have free by each moment."""
        if profile not in self._made:
            section = self._operation.trips[trip].section
            if trip not in self._members:
                self._members[trip] = trainset_behind(section, self._operation.trainset)
            run = sample_run([_nodes(profile)], np.zeros(1))
            self._made[profile] = run, reach_m(run, [self._members[trip]])
        return self._made[profile]

    def blocking(
        self, first: int, departure_s: Float[ndarray, " sections"], profiles: Sequence[PowerProfile]
    ) -> BlockingTimes:
        """Blocking times of a journey from end to end.

        Args:
            first: Its first trip.
            departure_s: Departures of its trips.
            profiles: Powers of its trips.
        """
        options = self._operation.options
        sections = [self._operation.trips[first + i].section for i in range(len(profiles))]
        from_m = np.cumsum([0.0, *(section.length_m for section in sections[:-1])])
        runs: list[ServiceRun] = []
        needs: list[ndarray] = []
        for i, profile in enumerate(profiles):
            own, reach = self.motion(first + i, profile)
            since_s = float(departure_s[i] - departure_s[0])
            if i:
                # until a moment before it leaves, a train at a platform needs no more than when it arrived
                last = runs[-1]
                until_s = max(since_s - SAMPLE_S, float(last.time_s[-1]))
                runs.append(
                    last._replace(
                        time_s=np.array([until_s]),
                        position_m=last.position_m[-1:],
                        speed_mps=last.speed_mps[-1:],
                        acceleration_mps2=last.acceleration_mps2[-1:],
                        section=last.section[-1:],
                    )
                )
                needs.append(needs[-1][-1:])
            position = from_m[i] + own.position_m
            section = np.full(position.size, i)
            runs.append(own._replace(time_s=since_s + own.time_s, position_m=position, section=section))
            needs.append(from_m[i] + reach)
        time, position, speed, rate, at = (
            np.concatenate(each) for each in zip(*(run[:-1] for run in runs), strict=True)
        )
        blocks_m = None if options.blocks is None else [each.length_m / options.blocks for each in sections]
        return blocking_times(
            ServiceRun(time, position, speed, rate, at, from_m),
            np.maximum.accumulate(np.concatenate(needs)),
            sections,
            self._operation.trainset.length_m,
            options.age_s,
            blocks_m,
        )


def line_headways(
    operation: LineOperation, timetable: Timetable, profiles: Profiles
) -> tuple[BlockingTimes, BlockingTimes]:
    """Blocking times of a timetable forward and backward, with the headway of every section and station.

    Args:
        operation: Line in operation.
        timetable: Timetable.
        profiles: Its trips.
    """
    motions, count = TripMotions(operation), operation.count
    found = []
    for first in (0, count):
        of = range(first, first + count)
        driven = [profiles[k][int(timetable.running_time_s[k])] for k in of]
        found.append(motions.blocking(first, timetable.departure_s[first : first + count], driven))
    return found[0], found[1]


def _nodes(profile: PowerProfile) -> tuple[ndarray, ndarray, ndarray, ndarray, ndarray]:
    """Time, position, speed, acceleration and section of a trip; after the last node the train stands."""
    lasts_s = np.diff(profile.time_s)
    rate = np.divide(np.diff(profile.speed_mps), lasts_s, out=np.zeros_like(lasts_s), where=lasts_s > 0)
    speed = np.append(profile.speed_mps[:-1], 0.0)
    return profile.time_s, profile.position_m, speed, np.append(rate, 0.0), np.zeros(speed.size, dtype=int)


def check_headway(operation: LineOperation, timetable: Timetable, *drivings: Profiles) -> None:
    """Refuse a headway at which trains disturb one another.

    Args:
        operation: Line in operation.
        timetable: Timetable.
        drivings: Its trips, one or more ways of driving them; the one that needs most binds.

    Raises:
        InputError: Naming the section or station that binds, its least headway and the direction.
    """
    options, running_s = operation.options, timetable.running_time_s
    both_s = running_s + np.roll(running_s, -1) + operation.dwells_s(timetable)
    if options.headway_s >= options.age_s + float(both_s.max()):
        # the train ahead is two stations on when the next one sets out
        return
    found = [each for driving in drivings for each in line_headways(operation, timetable, driving)]
    # the first of equals
    number = int(np.argmax([each.headway_s for each in found]))
    least = found[number].bottleneck
    if operation.options.headway_s < least.headway_s - ROUNDING_S:
        block = "a moving block" if operation.options.blocks is None else "fixed blocks"
        way = ("forward", "backward")[number % 2]
        raise InputError(
            f"trains disturb one another at {least.kind} {least.name}, {way}",
            field="headway_s",
            value=operation.options.headway_s,
            unit="s",
            allowed=f"at least {math.ceil(least.headway_s)} s with {block}",
        )


def check_day(operation: LineOperation, timetable: DayTimetable, plans: Sequence[Profiles]) -> None:
    """Refuse a day on which a train disturbs the next one of its direction.

    Args:
        operation: Line in operation.
        timetable: Timetable of the day, journeys in the order of their departures.
        plans: Powers of its trips, those that the timetable names by number.

    Raises:
        InputError: Naming the two trains by their departures, the direction and the section or station.
    """
    motions, count = TripMotions(operation), operation.count
    for way, each in enumerate(timetable):
        known: dict[bytes, BlockingTimes] = {}
        before, left_s = None, 0.0
        for departure_s, running_s, plan in zip(*each[:3], strict=True):
            key = (departure_s - departure_s[0]).tobytes() + running_s.tobytes() + plan.tobytes()
            if key not in known:
                driven = [
                    plans[p][count * way + i][int(s)]
                    for i, (p, s) in enumerate(zip(plan, running_s, strict=True))
                ]
                known[key] = motions.blocking(count * way, departure_s, driven)
            own, leaves_s = known[key], float(departure_s[0])
            if before is not None:
                _check_pair(operation, before, own, (left_s, leaves_s), backward=bool(way))
            before, left_s = own, leaves_s


class PeriodLeads:
    """Least time from a journey of a period to the next one, where that is of another period.

    A train that dwells less or runs faster than the one ahead of it comes nearer from station to station.

    Args:
        operation: Line in operation.
        parts: Periods.
        plans: Powers of the trips, those that the periods name by number.
        others: Further powers with which no train may disturb the next one either.
    """

    def __init__(
        self,
        operation: LineOperation,
        parts: Sequence[PeriodicPart],
        plans: Sequence[Profiles],
        others: Sequence[Profiles] = (),
    ) -> None:
        self._operation, self._parts, self._plans, self._others = operation, parts, plans, others
        self._motions = TripMotions(operation)
        self._known: dict[tuple[int, int], list[BlockingTimes]] = {}

    def __call__(self, ahead: int, behind: int, way: int) -> int:
        """Whole seconds from the last departure of a period to the first of a later one.

        Args:
            ahead: Number of the earlier period.
            behind: Number of the later one.
            way: 0 forward, 1 backward.
        """
        both = zip(self._blocking(ahead, way), self._blocking(behind, way), strict=True)
        leads_s = [_least_leads_s(self._operation, *each).max() for each in both]
        return math.ceil(max(leads_s) - ROUNDING_S)

    def _blocking(self, period: int, way: int) -> list[BlockingTimes]:
        """Blocking times of a journey of a period, as it is planned and by all other powers."""
        if (period, way) not in self._known:
            part, count = self._parts[period], self._operation.count
            of = range(count * way, count * (way + 1))
            departure_s = part.timetable.departure_s[of.start : of.stop]
            planned = [self._plans[int(part.plan[k])][k] for k in of]
            self._known[period, way] = [
                self._motions.blocking(
                    of.start,
                    departure_s,
                    [
                        times[int(part.timetable.running_time_s[k])]
                        for k, times in zip(of, driven, strict=True)
                    ],
                )
                for driven in (planned, *([each[k] for k in of] for each in self._others))
            ]
        return self._known[period, way]


def _least_leads_s(
    operation: LineOperation, ahead: BlockingTimes, behind: BlockingTimes
) -> Float[ndarray, " places"]:
    """Least times between the departures of two journeys, of every place that the one ahead blocks."""
    if operation.options.blocks is None:
        asked_s = np.interp(ahead.from_m, behind.from_m, behind.from_s)
    else:
        # overlaps may differ: the block in which this one begins
        asked_s = behind.from_s[np.searchsorted(behind.from_m, ahead.from_m, side="right") - 1]
    return ahead.to_s - asked_s


def _check_pair(
    operation: LineOperation,
    ahead: BlockingTimes,
    behind: BlockingTimes,
    leaves_s: tuple[float, float],
    *,
    backward: bool,
) -> None:
    """Refuse two journeys that follow each other too soon."""
    lead_s = leaves_s[1] - leaves_s[0]
    if lead_s >= float(ahead.to_s[-1] - behind.from_s[0]):
        return
    held_s = _least_leads_s(operation, ahead, behind)
    worst = int(np.argmax(held_s))
    if lead_s >= held_s[worst] - ROUNDING_S:
        return
    stops_m = np.append(ahead.run.from_m[1:], ahead.run.position_m[-1])
    end_m, length_m = float(ahead.to_m[worst]), operation.trainset.length_m
    # the first stop that the rear has yet to leave when it leaves this place
    k = min(int(np.searchsorted(stops_m, end_m - length_m, side="right")), operation.count - 1)
    section = operation.trips[operation.count * backward + k].section
    at_stop = end_m > stops_m[k] - length_m
    where = f"station {section.destination.name}" if at_stop else f"section {section.name}"
    way = "backward" if backward else "forward"
    raise InputError(
        f"trains disturb one another at {where}, {way}, those of {format_clock(leaves_s[0])} and "
        f"{format_clock(leaves_s[1])}",
        field="timetable",
        value=round(lead_s),
        unit="s",
        allowed=f"at least {math.ceil(held_s[worst])} s later",
    )


class LongestDwells:
    """Longest dwell after each trip with which trains a headway apart do not disturb one another.

    By running time and plan of the trip, whatever those of the next one: it leaves as the slowest does.

    Args:
        operation: Line in operation.
        plans: Profiles to choose from.
    """

    def __init__(self, operation: LineOperation, plans: Sequence[Profiles]) -> None:
        self._operation, self._plans, self._motions = operation, plans, TripMotions(operation)
        self._found: dict[tuple[int, int, int], float] = {}
        most_m = operation.trainset.length_m + OVERLAP_M
        # dense at the stop, where the time grows as the square root of the distance
        self._beyond_m = np.linspace(0.0, math.sqrt(most_m), math.ceil(most_m / PLACE_M) + 1) ** 2
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
        run, reach = self._motions.motion(trip, profile)
        to_m, from_s = self._blocks(run, reach)
        end_m = float(profile.position_m[-1])
        behind = to_m > end_m - length_m
        passes_s = first_times(run.time_s, run.position_m - length_m, to_m)
        after_s = running_s + np.interp(to_m - end_m + length_m, self._beyond_m, leaves_s)
        held_s = np.where(behind, after_s, passes_s) - from_s + options.age_s
        if held_s[~behind].max(initial=0.0) > options.headway_s + ROUNDING_S:
            return -math.inf
        return options.headway_s - float(held_s[behind].max(initial=0.0)) + ROUNDING_S

    def _blocks(self, run: ServiceRun, reach: ndarray) -> tuple[ndarray, ndarray]:
        """End and first time of the blocks of a trip, and of what is asked for beyond its end."""
        end_m = float(run.position_m[-1])
        if self._operation.options.blocks is None:
            rears_m = np.array([end_m - self._operation.trainset.length_m])
            from_m = to_m = watched_places(reach, end_m, rears_m, PLACE_M)
        else:
            edges = np.linspace(0.0, end_m, self._operation.options.blocks + 1)
            edges = np.append(edges, max(reach[-1], end_m + PLACE_M))
            from_m, to_m = edges[:-1], edges[1:]
        return to_m, first_times(run.time_s, reach, from_m)
