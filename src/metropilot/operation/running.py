"""A line while it runs: its trains second by second, delays that are injected, and how they die away.

Trains follow one another in a fixed order. One departs when its timetable, its dwell and whoever holds it let
it, and only if the way will be free by the moment at which its supervisor asks for it: the blocking times of
:mod:`metropilot.operation.headway` between it and the train ahead, as that one is then expected to move. If
the train ahead is held meanwhile, the one behind brakes where its supervisor would, stands, and is driven on
from there. Late trains recover with the reserve of running times and dwells.

Conventions: a train that has arrived at a terminal station is out of the way of the next one; speed
restrictions hold for trains that depart after they were told.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._schema import check_fields, declare
from metropilot._typing import Float
from metropilot.convoy import first_times
from metropilot.errors import InputError, rename_fields
from metropilot.operation.headway import TripMotions
from metropilot.operation.line_service import Trip
from metropilot.operation.power import PowerProfile, profile_of_plan
from metropilot.operation.report import OperationEnergy
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import Restriction
from metropilot.units import J_PER_KWH, KINDS, KMH_PER_MPS

STEP_S = 1.0
"""Time between two looks at all trains."""
PUNCTUAL_S = 5.0
"""Delay up to which a train counts as on time."""
SPARE_S = 1
"""Seconds over the minimum running time of the fastest trip."""
RECOVERY_STEP_S = 5
"""Late trains take whole steps off the running time: there are few drives of each trip to plan."""
LATE_W = 1e6
"""Worth of a second where a train that was stopped on the way drives on: it does so as fast as it can."""
LONGEST_HOLD_S = 3600.0
RESTRICTION_KMH = 5.0, 200.0
STANDS_M = 2.0
"""Distance that a train keeps where it is stopped behind another one."""
SAME_M = 1.0
"""Places nearer than this are one: motions are looked at in steps."""


@dataclass(frozen=True, kw_only=True)
class TrainHold:
    """Hold of the next train that departs from a station.

    Attributes:
        station: Code of the station.
        hold_s: Time by which its departure is put back.
        backward: True for the direction of falling positions.
    """

    station: str
    hold_s: float = declare(
        120.0,
        "Time by which a departure is put back.",
        unit="s",
        low=1.0,
        high=LONGEST_HOLD_S,
        label="Hold for",
        step=10.0,
    )
    backward: bool = False

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, kw_only=True)
class SlowSection:
    """Speed restriction of a whole section for some time.

    Attributes:
        station: Code of the station at which the section begins.
        limit_mps: Highest speed.
        lasts_s: Time for which trains that depart keep it.
        backward: True for the direction of falling positions.
    """

    station: str
    limit_mps: float = declare(
        25.0 / KMH_PER_MPS,
        "Highest speed on the section.",
        unit="m/s",
        low=RESTRICTION_KMH[0] / KMH_PER_MPS,
        high=RESTRICTION_KMH[1] / KMH_PER_MPS,
        shown=KINDS["speed"]["km/h"],
        label="Limit",
        step=5.0 / KMH_PER_MPS,
    )
    lasts_s: float = declare(
        600.0,
        "Time for which trains that depart keep it.",
        unit="s",
        low=1.0,
        high=36_000.0,
        label="For",
        step=60.0,
    )
    backward: bool = False

    def __post_init__(self) -> None:
        check_fields(self)


class TrainMotion(NamedTuple):
    """A drive of a trip, from its beginning or from where the train stood.

    Attributes:
        profile: Power, time and place.
        time_s: Time since it set out, in equal steps.
        reach_m: Farthest place that must be free by each of them, from the origin of the trip.
        drawn_j: Energy drawn up to each node of the profile.
        returned_j: Energy returned, the same.
    """

    profile: PowerProfile
    time_s: Float[ndarray, " times"]
    reach_m: Float[ndarray, " times"]
    drawn_j: Float[ndarray, " nodes"]
    returned_j: Float[ndarray, " nodes"]


@dataclass
class RunningTrain:
    """A train of a running line.

    Attributes:
        number: Number of the train, from 1.
        service: Number of its round trip among all; one service departs every headway.
        trip: Trip that it drives, or that it is going to drive.
        motion: Drive of the trip; None at a platform.
        set_out_s: Moment at which the drive began.
        arrived_s: Arrival at the platform at which it stands or stood last.
        held_s: Time by which its next departure is put back.
        stopped_m: Place on the trip where it brakes or stands before the train ahead; None otherwise.
        speed_mps: Speed while it brakes there.
        delay_s: Expected delay of its next arrival, or departure while it stands.
        waits: True while it stands only for the train ahead.
        seen: Service, direction, moment and place, for as long as messages are old.
    """

    number: int
    service: int
    trip: int
    motion: TrainMotion | None = None
    set_out_s: float = 0.0
    arrived_s: float = 0.0
    held_s: float = 0.0
    stopped_m: float | None = None
    speed_mps: float = 0.0
    delay_s: float = 0.0
    waits: bool = False
    seen: deque[tuple[int, bool, float, float]] = field(default_factory=deque)


class RunningLine:
    """All trains of a line in operation from a moment of its timetable on.

    Args:
        found: Timetable with its profiles and floor, of :func:`metropilot.operation.operation_energy`.

    Attributes:
        found: Timetable, profiles, floor.
        trains: Trains in the order in which they follow one another.
        time_s: Time since the beginning.
        supplied_j: Energy from the substations since then.
        gap_percent: Excess of it over the floor when the last whole headway ended; none before the first.
        news: What happened since :meth:`pop_news`, with its time.
        hardest_mps2: Hardest braking of such a stop.
        stops: Stops on the way before a train ahead, so far.
        waits: Departures that waited for the train ahead, so far.
    """

    def __init__(self, found: OperationEnergy) -> None:
        self.found, self.operation = found, found.operation
        operation, table = self.operation, found.timetable
        self.headway_s, self.count = float(operation.options.headway_s), operation.count
        self.motions = TripMotions(operation)
        self.fleet = fleet = operation.fleet(table)
        departure, arrival = table.departure_s - table.departure_s[0], table.arrival_s - table.departure_s[0]
        there_s, least_s = float(arrival[self.count - 1]), operation.options.turnround_s
        # the backward trips of a train follow its forward ones by whole headways
        wait_s = least_s + (departure[self.count] - there_s - least_s) % self.headway_s
        shift_s = np.where(
            np.arange(departure.size) < self.count, 0.0, there_s + wait_s - departure[self.count]
        )
        self.departure_s, self.arrival_s = departure + shift_s, arrival + shift_s
        lengths = np.array([trip.section.length_m for trip in operation.trips])
        self.start_m = np.concatenate(
            [np.cumsum([0.0, *part[:-1]]) for part in (lengths[: self.count], lengths[self.count :])]
        )
        self.lengths_m = lengths
        self.planned = [self._motion(k, self._profile(k)) for k in range(lengths.size)]
        self.drives: dict[tuple[int, int, float | None], TrainMotion] = {}
        self.holds: dict[int, float] = {}
        self.limits: dict[int, tuple[float, float]] = {}
        self.hardest_mps2 = 0.0
        self._expected: dict[int, tuple[ndarray, ndarray]] = {}
        self.edges_m = self._edges()
        self.time_s, self.supplied_j, self.stops, self.waits = 0.0, 0.0, 0, 0
        self.gap_percent: float | None = None
        self.news: list[tuple[float, str]] = []
        self.disturbed_s: float | None = None
        self.recovered_s: float | None = None
        self.largest_delay_s = 0.0
        self.trains = [self._place(j, fleet) for j in range(fleet)]
        self._see()

    def _profile(self, trip: int) -> PowerProfile:
        return self.found.profiles[trip][int(self.found.timetable.running_time_s[trip])]

    def _motion(self, trip: int, profile: PowerProfile) -> TrainMotion:
        run, reach = self.motions.motion(trip, profile)
        lasts = np.diff(profile.time_s)
        sums = [
            np.concatenate([[0.0], np.cumsum(lasts * each.mean(axis=1))])
            for each in (profile.drawn_w, profile.returned_w)
        ]
        return TrainMotion(profile, run.time_s, reach, *sums)

    def _edges(self) -> Float[ndarray, " edges"]:
        """Ends of the fixed blocks from the terminal station, with the overlaps beyond the stops."""
        blocks, edges = self.operation.options.blocks, []
        for k in range(self.count if blocks else 0):
            a, b = float(self.start_m[k]), float(self.start_m[k] + self.lengths_m[k])
            edges += [*np.linspace(a, b, (blocks or 1) + 1), a + float(self.planned[k].reach_m[-1])]
        return np.unique(edges)

    def _place(self, train: int, fleet: int) -> RunningTrain:
        """A train where the timetable has it at the beginning."""
        cycle_s = fleet * self.headway_s
        since_s = (-train * self.headway_s) % cycle_s
        # the round trip that began last, at or before the beginning
        service = train - fleet if train else 0
        made = RunningTrain(train + 1, service, 0)
        k = int(np.searchsorted(self.departure_s, since_s, side="right")) - 1
        if since_s < self.arrival_s[k]:
            made.trip, made.motion = k, self.planned[k]
            made.set_out_s = self._due_s(made)
        else:
            made.arrived_s = float(self.arrival_s[k]) - since_s
            self._go_on(made, k)
        return made

    def _go_on(self, train: RunningTrain, trip: int) -> None:
        """Let a train that has arrived wait for its next trip."""
        train.trip, train.motion, train.stopped_m = trip + 1, None, None
        if train.trip == self.departure_s.size:
            train.trip, train.service = 0, train.service + self.fleet
        train.held_s += self.holds.pop(train.trip, 0.0)

    def _due_s(self, train: RunningTrain) -> float:
        """Scheduled departure of a train's trip."""
        return train.service * self.headway_s + float(self.departure_s[train.trip])

    # ------------------------------------------------------------------------------------------ events
    def hold(self, wanted: TrainHold) -> str:
        """Hold the next train that departs from a station; return it in words.

        Args:
            wanted: Station, direction and time.

        Raises:
            InputError: No trip begins there.
        """
        trip, seconds = self._trip_from(wanted.station, backward=wanted.backward), wanted.hold_s
        train = min(self.trains, key=lambda each: self._trips_to(each, trip))
        name = self.operation.trips[trip].section.origin.name
        self._disturb()
        if self._trips_to(train, trip) > 1:
            self.holds[trip] = self.holds.get(trip, 0.0) + seconds
            return f"the next train at {name} is held for {seconds:g} s"
        train.held_s += seconds
        return f"train {train.number} is held at {name} for {seconds:g} s"

    def _trips_to(self, train: RunningTrain, trip: int) -> int:
        """Trips that a train ends before it stands at the origin of another; itself not begun: 0."""
        behind = (trip - train.trip) % self.departure_s.size
        return behind if train.motion is None or behind else self.departure_s.size

    def slow(self, wanted: SlowSection) -> str:
        """Restrict the speed of a section for some time; return it in words.

        Args:
            wanted: Station at which it begins, direction, speed and time.

        Raises:
            InputError: No trip begins there, or trains never go as fast.
        """
        trip = self._trip_from(wanted.station, backward=wanted.backward)
        section = self.operation.trips[trip].section
        with rename_fields({"restriction": "limit_mps"}):
            section.check_restriction(Restriction(0.0, section.length_m, wanted.limit_mps))
        self.limits[trip] = wanted.limit_mps, self.time_s + wanted.lasts_s
        self._disturb()
        return f"{section.name}: {KMH_PER_MPS * wanted.limit_mps:.0f} km/h for {wanted.lasts_s:g} s"

    def _trip_from(self, station: str, *, backward: bool) -> int:
        stops = [trip.section.origin for trip in self.operation.trips if trip.backward == backward]
        for k, stop in enumerate(stops):
            if stop.code == station:
                return k + self.count * backward
        allowed = ", ".join(stop.code for stop in stops)
        raise InputError("no trip begins there", field="station", value=station, allowed=allowed)

    def _disturb(self) -> None:
        self.disturbed_s, self.recovered_s = self.time_s, None

    def pop_news(self) -> list[tuple[float, str]]:
        """News since the last call, each with its time."""
        news, self.news = self.news, []
        return news

    # ------------------------------------------------------------------------------------------ motion
    def advance(self) -> None:
        """Let ``STEP_S`` pass."""
        until_s = self.time_s + STEP_S
        self._expected.clear()
        net_w = np.zeros(self.operation.options.zones)
        for train in self.trains:
            net_w[self._zone(train)] += self._move(train, until_s) / STEP_S
        self.supplied_j += float(np.maximum(net_w, 0.0).sum()) * STEP_S
        self.time_s = until_s
        if until_s % self.headway_s < STEP_S:  # within a headway power swings about the mean
            self.gap_percent = 100.0 * (self.supplied_j / self.floor_j - 1.0)
        self._see()
        worst = max(train.delay_s for train in self.trains)
        self.largest_delay_s = max(self.largest_delay_s, worst)
        if self.disturbed_s is not None and self.recovered_s is None and not self._is_late():
            self.recovered_s = self.time_s
            after_s = self.time_s - self.disturbed_s
            self.news.append(
                (self.time_s, f"every train is on time again, {after_s:.0f} s after the last event")
            )

    def _is_late(self) -> bool:
        held = bool(self.holds) or any(train.held_s > 0.0 for train in self.trains)
        slow = any(until_s > self.time_s for _, until_s in self.limits.values())
        return held or slow or max(train.delay_s for train in self.trains) > PUNCTUAL_S

    def _zone(self, train: RunningTrain) -> int:
        """Zone that feeds a train: at a platform that which it has come from."""
        trips = self.operation.trips
        return trips[train.trip if train.motion is not None else train.trip - 1].zone

    def _move(self, train: RunningTrain, until_s: float) -> float:
        """Move a train for a step; return the net energy that it takes."""
        own_w = self.operation.trainset.auxiliary_w
        aboard_j = own_w * STEP_S
        if train.motion is None:
            rests = self._at_terminal(train)
            self._depart(train, until_s)
            if train.motion is None:
                return 0.0 if rests else aboard_j
            on_way_j = own_w * (until_s - train.set_out_s)
            return self._net_j(train, train.set_out_s, until_s) + (on_way_j if rests else aboard_j)
        if train.stopped_m is not None:
            self._brake(train)
            drives_on = train.stopped_m is None
            return aboard_j + (self._net_j(train, self.time_s, until_s) if drives_on else 0.0)
        after_s = until_s - train.set_out_s
        if self._is_stopped(train, after_s):
            train.stopped_m, train.speed_mps = self._state(train, self.time_s)
            self.stops += 1
            name = self.operation.trips[train.trip].section.destination.name
            self.news.append((self.time_s, f"train {train.number} is stopped before {name}"))
            self._brake(train)
            return aboard_j
        net_j = self._net_j(train, self.time_s, until_s)
        if after_s >= train.motion.profile.running_time_s:
            self._arrive(train)
            if self._at_terminal(train):
                aboard_j = own_w * (train.arrived_s - self.time_s)
        return net_j + aboard_j

    def _at_terminal(self, train: RunningTrain) -> bool:
        """Tell whether a train at a platform is at a terminal station: there its auxiliaries are off."""
        return train.trip in {0, self.count}

    def _net_j(self, train: RunningTrain, from_s: float, to_s: float) -> float:
        """Energy that a train drives with between two moments, less what is received of it."""
        assert train.motion is not None
        times, span_s = train.motion.profile.time_s, (from_s - train.set_out_s, to_s - train.set_out_s)
        drawn, returned = (
            float(np.diff(np.interp(span_s, times, each))[0])
            for each in (train.motion.drawn_j, train.motion.returned_j)
        )
        return drawn - (1.0 - self.operation.options.transfer_loss) * returned

    def _state(self, train: RunningTrain, time_s: float) -> tuple[float, float]:
        """Place on its trip and speed of a train that drives."""
        assert train.motion is not None
        profile, since_s = train.motion.profile, time_s - train.set_out_s
        place, speed = (
            float(np.interp(since_s, profile.time_s, each))
            for each in (profile.position_m, profile.speed_mps)
        )
        return place, speed

    def _arrive(self, train: RunningTrain) -> None:
        assert train.motion is not None
        trip = train.trip
        train.arrived_s = train.set_out_s + train.motion.profile.running_time_s
        train.delay_s = train.arrived_s - self._due_s(train) - self._runs_s(trip)
        self._go_on(train, trip)

    def _runs_s(self, trip: int) -> float:
        return float(self.arrival_s[trip] - self.departure_s[trip])

    def _least_dwell_s(self, trip: int) -> float:
        """Least time at the platform before a trip."""
        options = self.operation.options
        if trip in {0, self.count}:
            return float(options.turnround_s)
        planned_s = float(self.departure_s[trip] - self.arrival_s[trip - 1])
        return min(planned_s, float(options.dwell_s - options.dwell_window_s))

    def _ready_s(self, train: RunningTrain) -> float:
        """Moment at which a train at a platform may depart, the train ahead left out."""
        due_s = self._due_s(train)
        return max(due_s, train.arrived_s + self._least_dwell_s(train.trip)) + train.held_s

    def _depart(self, train: RunningTrain, until_s: float) -> None:
        ready_s, due_s = self._ready_s(train), self._due_s(train)
        train.delay_s = max(ready_s, self.time_s) - due_s
        if ready_s >= until_s:
            return
        leaves_s = max(ready_s, self.time_s)
        motion = self._drive(train.trip, max(leaves_s - due_s, 0.0))
        if not self._is_clear(train, motion, leaves_s):
            train.delay_s = until_s - due_s
            if not train.waits:
                train.waits = True
                self.waits += 1
                ahead = self._ahead(train)
                name = self.operation.trips[train.trip].section.origin.name
                words = f"train {train.number} waits at {name} for train {ahead.number if ahead else '?'}"
                self.news.append((self.time_s, words))
            return
        train.motion, train.set_out_s, train.held_s, train.waits = motion, leaves_s, 0.0, False
        train.delay_s = leaves_s + motion.profile.running_time_s - due_s - self._runs_s(train.trip)

    def _is_clear(self, train: RunningTrain, motion: TrainMotion, leaves_s: float) -> bool:
        """Tell whether a train can depart; as planned, behind one on time, the headway allows it."""
        ahead = self._ahead(train)
        if ahead is None:
            return True
        as_planned = motion is self.planned[train.trip] and ahead.delay_s < 1.0 and ahead.held_s == 0.0
        return as_planned or leaves_s >= self._free_from_s(train, train.trip, motion)

    def _drive(self, trip: int, late_s: float) -> TrainMotion:
        """Drive of a trip: as planned, faster by as much as it is late, slower where it must be."""
        limit_mps, until_s = self.limits.get(trip, (0.0, 0.0))
        limit = limit_mps if until_s > self.time_s else None
        planned_s = int(self.found.timetable.running_time_s[trip])
        if limit is None and late_s < RECOVERY_STEP_S:
            return self.planned[trip]
        of: Trip = self.operation.trips[trip]
        if limit is not None:
            restricted = of.section.with_restriction(Restriction(0.0, of.section.length_m, limit))
            of = of._replace(section=restricted)
        fastest_s = math.ceil(minimum_running_time(of.section, self.operation.trainset)) + SPARE_S
        time_s = max(planned_s - int(late_s) // RECOVERY_STEP_S * RECOVERY_STEP_S, fastest_s)
        key = trip, time_s, limit
        if key not in self.drives:
            self.drives[key] = self._motion(trip, self.operation.drive(of, time_s))
        return self.drives[key]

    def _brake(self, train: RunningTrain) -> None:
        """Brake a train before the one ahead; from standstill it drives on once the way is free."""
        assert train.stopped_m is not None
        train.delay_s += STEP_S
        if train.speed_mps > 0.0:
            room_m = self._rear_m(train, self.time_s) - self._way_m(train, self.time_s) - STANDS_M
            rate = max(
                self.operation.trainset.max_deceleration_mps2,
                train.speed_mps**2 / (2.0 * max(room_m, SAME_M)),
            )
            self.hardest_mps2 = max(self.hardest_mps2, rate)
            lasts_s = min(STEP_S, train.speed_mps / rate)
            train.stopped_m += lasts_s * (train.speed_mps - 0.5 * rate * lasts_s)
            train.speed_mps = max(train.speed_mps - rate * lasts_s, 0.0)
            return
        motion = self._drive_on(train.trip, train.stopped_m)
        if self.time_s >= self._free_from_s(train, train.trip, motion):
            train.motion, train.set_out_s, train.stopped_m = motion, self.time_s, None
            due_s = self._due_s(train) + self._runs_s(train.trip)
            train.delay_s = self.time_s + motion.profile.running_time_s - due_s
            self.news.append((self.time_s, f"train {train.number} drives on"))

    def _drive_on(self, trip: int, from_m: float) -> TrainMotion:
        """Drive from standstill on the way to the next platform, as fast as it can."""
        key = trip, -1, round(from_m, 1)
        if key not in self.drives:
            section, trainset = self.operation.trips[trip].section, self.operation.silent
            options = PlanOptions(objective="line", start_m=round(from_m, 1), start_mps=0.0, late_w=LATE_W)
            plan = optimal_plan(section, trainset, 1.0, options)  # too soon: as early as it can
            self.drives[key] = self._motion(trip, profile_of_plan(plan, trainset))
        return self.drives[key]

    # ------------------------------------------------------------------------------------------ ahead
    def _ahead(self, train: RunningTrain) -> RunningTrain | None:
        """Train of the service before, while it is on the way of this one."""
        other = self.trains[(train.number - 2) % len(self.trains)]
        same_way = (other.trip < self.count) == (train.trip < self.count)
        if other is train or other.service != train.service - 1 or not same_way:
            return None
        at_terminal = other.motion is None and other.trip in {0, self.count}
        return None if at_terminal and other.trip != train.trip else other

    def _way_m(self, train: RunningTrain, time_s: float) -> float:
        """Place of a train's head from the terminal station of its direction."""
        start_m = float(self.start_m[train.trip])
        if train.stopped_m is not None:
            return start_m + train.stopped_m
        return start_m + (0.0 if train.motion is None else self._state(train, time_s)[0])

    def _see(self) -> None:
        """Keep where every train is, for as long as messages are old."""
        most = math.ceil(self.operation.options.age_s / STEP_S) + 1
        for train in self.trains:
            forward, at_m = train.trip < self.count, self._way_m(train, self.time_s)
            train.seen.append((train.service, forward, self.time_s, at_m))
            while len(train.seen) > most:
                train.seen.popleft()

    def _asked_m(self, needed_m: Float[ndarray, " places"]) -> Float[ndarray, " places"]:
        """Place that the rear of the train ahead must have passed: that needed, or its block's end."""
        if self.operation.options.blocks is None:
            return needed_m
        edges = self.edges_m
        return edges[np.minimum(np.searchsorted(edges, needed_m - SAME_M, side="left"), edges.size - 1)]

    def _rear_m(self, train: RunningTrain, time_s: float) -> float:
        """Place of the rear of the train ahead as a train knows it at a moment; infinite if there is none."""
        ahead = self._ahead(train)
        if ahead is None:
            return math.inf
        way = ahead.service, ahead.trip < self.count
        seen = [(at_s, at_m) for *of, at_s, at_m in ahead.seen if tuple(of) == way]
        known_s = time_s - self.operation.options.age_s
        return float(np.interp(known_s, *np.array(seen).T)) - self.operation.trainset.length_m

    def _is_stopped(self, train: RunningTrain, since_s: float) -> bool:
        """Tell whether the supervisor of a train that drives would stop it now, as far as it knows."""
        motion = train.motion
        assert motion is not None
        rear_m = self._rear_m(train, train.set_out_s + since_s)
        needed_m = self.start_m[train.trip] + np.interp(since_s, motion.time_s, motion.reach_m)
        if needed_m <= rear_m and self.operation.options.blocks is None:
            return False
        return float(self._asked_m(np.array([needed_m]))[0]) > rear_m + SAME_M

    def _free_from_s(self, train: RunningTrain, trip: int, motion: TrainMotion) -> float:
        """Moment from which a train can set out and find its way free whenever its supervisor asks for it."""
        ahead = self._ahead(train)
        if ahead is None:
            return -math.inf
        time, head = self._expect(ahead)
        asked = self._asked_m(self.start_m[trip] + motion.reach_m)
        rear = head - self.operation.trainset.length_m
        passes = first_times(time, rear, np.maximum(asked - SAME_M, rear[0]))
        # beyond what is expected of it the train ahead is gone, or stands where nobody can tell for how long
        passes = np.where(asked > rear[-1] + SAME_M, math.inf if self._stays(ahead) else time[-1], passes)
        passes = np.where(asked <= rear[0] + SAME_M, -math.inf, passes)
        return float(np.max(passes - motion.time_s)) + self.operation.options.age_s

    def _stays(self, train: RunningTrain) -> bool:
        """Tell whether nobody knows when a train drives on."""
        return train.stopped_m is not None

    def _expect(self, train: RunningTrain) -> tuple[Float[ndarray, " times"], Float[ndarray, " times"]]:
        """Times and places of a train's head as it is expected to go on over this trip and the next one."""
        if train.number in self._expected:
            return self._expected[train.number]
        now_s, trip = self.time_s, train.trip
        times, heads = [np.array([now_s])], [np.array([self._way_m(train, now_s)])]
        leaves_s = max(self._ready_s(train), now_s) if train.motion is None else math.inf
        if train.motion is not None and train.stopped_m is None:
            profile = train.motion.profile
            times.append(train.set_out_s + profile.time_s)
            heads.append(self.start_m[trip] + profile.position_m)
            trip += 1
            if trip not in {self.count, self.departure_s.size}:
                due_s = train.service * self.headway_s + float(self.departure_s[trip])
                arrives_s = float(times[-1][-1])
                leaves_s = max(due_s, arrives_s + self._least_dwell_s(trip)) + train.held_s
        if math.isfinite(leaves_s):
            due_s = train.service * self.headway_s + float(self.departure_s[trip])
            motion = self._drive(trip, max(leaves_s - due_s, 0.0))
            leaves_s = max(leaves_s, self._free_from_s(train, trip, motion))
            if math.isfinite(leaves_s):
                times.append(leaves_s + motion.profile.time_s)
                heads.append(self.start_m[trip] + motion.profile.position_m)
        time, head = np.concatenate(times), np.concatenate(heads)
        kept = time >= now_s
        self._expected[train.number] = found = time[kept], np.maximum.accumulate(head[kept])
        return found

    # ------------------------------------------------------------------------------------------ what is seen
    @property
    def positions_m(self) -> list[float]:
        """Place of each train on the line."""
        found = []
        for train in self.trains:
            section = self.operation.trips[train.trip].section
            along = self._way_m(train, self.time_s) - float(self.start_m[train.trip])
            sign = 1.0 if section.destination.position_m > section.origin.position_m else -1.0
            found.append(section.origin.position_m + sign * along)
        return found

    @property
    def delays_s(self) -> list[float]:
        """Expected delay of each train."""
        return [train.delay_s for train in self.trains]

    @property
    def floor_j(self) -> float:
        """Energy that no timetable of this headway undercuts over whole headways, by the time."""
        return self.found.floor_kwh * J_PER_KWH * self.time_s / self.headway_s

    def gaps_m(self) -> Iterator[float]:
        """Distance from each train that drives to the rear of the one ahead, where there is one."""
        for train in self.trains:
            ahead = self._ahead(train)
            if train.motion is not None and ahead is not None:
                rear = self._way_m(ahead, self.time_s) - self.operation.trainset.length_m
                yield rear - self._way_m(train, self.time_s)

    def as_dict(self) -> dict[str, Any]:
        """Values as JSON holds them: energy beside the floor, delays, stops, recovery."""
        return {
            "time_s": self.time_s,
            "trains": len(self.trains),
            "energy_kwh": self.supplied_j / J_PER_KWH,
            "floor_kwh": self.floor_j / J_PER_KWH,
            "gap_percent": self.gap_percent,
            "largest_delay_s": self.largest_delay_s,
            "delay_s": sum(max(each, 0.0) for each in self.delays_s),
            "waits": self.waits,
            "stops": self.stops,
            "disturbed_s": self.disturbed_s,
            "recovered_s": self.recovered_s,
        }
