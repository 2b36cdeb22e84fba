"""A line in operation: trips of both directions at a headway, feeding zones, energy and its floor."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._schema import check_fields, declare
from metropilot._typing import Float, Int
from metropilot.convoy import AGE_S, Member, ServiceRun
from metropilot.errors import Infeasible, InputError
from metropilot.operation.power import PeriodicPower, PowerProfile, add_periodic, profile_of_plan
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import (
    PlanOptions,
    ReceivedEnergy,
    coast_plan,
    cruise_plan,
    minimum_running_time,
    plan_arrays,
)
from metropilot.railway import Efficiency, Line, Section, Trainset
from metropilot.units import J_PER_KWH

Driving = Literal["optimal", "cruise", "coast"]
"""How trips are driven: by the plan of least net energy, or to one speed, which is held or coasted from, with
full service braking."""


@dataclass(frozen=True, kw_only=True)
class OperationOptions:
    """Operation of a line at a periodic headway.

    Attributes:
        headway_s: Time between two trains of a direction.
        dwell_s: Planned time at every platform on the way.
        dwell_window_s: Most by which a timetable may change a dwell.
        time_window_s: Most by which a timetable may change a running time.
        turnround_s: Least time between arrival and departure at a terminal station.
        reserve: Running time over the minimum running time, less 1, on a line without planned times.
        zones: Feeding zones. They meet at stations; one zone for each section is the most.
        age_s: Age of what a train knows of the one ahead.
        blocks: Fixed blocks of each section; None: a moving block.
        transfer_loss: Share of the returned power that is lost on the way to another train of the zone.
        efficiency_traction: Wheel over line power in traction; None: the trainset's.
        efficiency_braking: Line over wheel power in electric braking; None: the trainset's.
    """

    headway_s: int = declare(
        180,
        "Time between two trains of a direction.",
        unit="s",
        low=10.0,
        high=7200.0,
        label="Headway",
        step=5.0,
    )
    dwell_s: int = declare(
        30,
        "Planned time at every platform on the way.",
        unit="s",
        low=0.0,
        high=600.0,
        label="Dwell",
        step=5.0,
    )
    dwell_window_s: int = declare(
        10,
        "Most by which a search may change a dwell.",
        unit="s",
        low=0.0,
        high=300.0,
        label="Dwell, most change",
        step=1.0,
    )
    time_window_s: int = declare(
        4,
        "Most by which a search may change a running time.",
        unit="s",
        low=0.0,
        high=60.0,
        label="Running time, most change",
        step=1.0,
    )
    turnround_s: int = declare(
        120,
        "Least time at a terminal station.",
        unit="s",
        low=0.0,
        high=3600.0,
        label="Least turn-round",
        step=10.0,
    )
    reserve: float = declare(
        0.1,
        "Running time over the minimum, less 1, on a line without planned times.",
        low=0.0,
        high=2.0,
        label="Running time reserve, share",
        step=0.01,
    )
    zones: int = declare(
        4, "Feeding zones, which meet at stations.", low=1, high=1000, label="Feeding zones", step=1.0
    )
    age_s: float = declare(
        AGE_S,
        "Age of what a train knows of the one ahead.",
        unit="s",
        low=0.0,
        high=60.0,
        option="age",
        label="Age of messages",
        step=0.1,
    )
    blocks: int | None = declare(
        None,
        "Fixed blocks of each section; a moving block if not given.",
        low=1,
        high=1000,
        label="Fixed blocks of a section",
        step=1.0,
    )
    transfer_loss: float = declare(
        0.1,
        "Share of the returned power lost on the way to another train.",
        low=0.0,
        high=1.0,
        label="Transfer loss, share",
        step=0.01,
    )
    efficiency_traction: float | None = declare(
        None,
        "Wheel over line power in traction; that of the trainset if not given.",
        low=0.01,
        high=1.0,
        label="Traction efficiency",
        step=0.01,
    )
    efficiency_braking: float | None = declare(
        None,
        "Line over wheel power in electric braking; that of the trainset if not given.",
        low=0.01,
        high=1.0,
        label="Braking efficiency",
        step=0.01,
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.dwell_window_s > self.dwell_s:
            raise InputError(
                "a dwell window that is longer than the dwell",
                field="dwell_window_s",
                value=self.dwell_window_s,
                unit="s",
                allowed=f"at most the dwell, {self.dwell_s:g} s",
            )

    @classmethod
    def fitting(cls, line: Line, given: Mapping[str, Any]) -> dict[str, Any]:
        """Give defaults that fit a line and the options given, in place of those that may not.

        Args:
            line: Line, which has no more feeding zones than sections.
            given: Options given, by the names of the fields; a dwell window is no longer than the dwell.
        """
        usual = {
            "zones": min(cls.zones, len(line.stations) - 1),
            "dwell_window_s": min(cls.dwell_window_s, given.get("dwell_s", cls.dwell_s)),
        }
        return {name: value for name, value in usual.items() if name not in given}


class Trip(NamedTuple):
    """One section of a line in one direction.

    Attributes:
        section: Section.
        backward: True in the direction of falling positions.
        zone: Feeding zone, counted from 0 along the line.
        planned_s: Planned running time, whole seconds.
        allowed_s: Running times that a timetable may give it, increasing, whole seconds.
    """

    section: Section
    backward: bool
    zone: int
    planned_s: int
    allowed_s: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Timetable:
    """Periodic timetable: everything repeats every headway.

    Attributes:
        departure_s: Departure of each trip of one train each way, forward and then backward. Shape (M,).
        running_time_s: Running time of each trip, a key of its profiles. Shape (M,).
    """

    departure_s: Float[ndarray, " trips"]
    running_time_s: Int[ndarray, " trips"]

    @property
    def arrival_s(self) -> Float[ndarray, " trips"]:
        """Arrival of each trip."""
        return self.departure_s + self.running_time_s


@dataclass(frozen=True)
class EnergyBalance:
    """Energy of all trains in one headway, which is that of one train in a round trip, or in a day.

    Attributes:
        supplied_j: From the substations.
        drawn_j: Drawn by the trains: traction and auxiliaries.
        returned_j: Returned by braking trains.
        received_j: The part of it that other trains received.
        transferred_loss_j: The part lost on the way to them.
        unreceived_j: The part that no train of the zone could take.
    """

    supplied_j: float
    drawn_j: float
    returned_j: float
    received_j: float
    transferred_loss_j: float
    unreceived_j: float

    @classmethod
    def from_sums(
        cls, *, supplied_j: float, unused_j: float, drawn_j: float, returned_j: float, through: float
    ) -> EnergyBalance:
        """Balance of what is drawn and returned.

        Args:
            supplied_j: From the substations.
            unused_j: What nobody takes of that which comes through.
            drawn_j: Drawn by the trains.
            returned_j: Returned by braking trains.
            through: Share of it that comes through, the transfer loss left out.
        """
        received_j = through * returned_j - unused_j
        return cls(
            supplied_j=supplied_j,
            drawn_j=drawn_j,
            returned_j=returned_j,
            received_j=received_j,
            transferred_loss_j=received_j / through - received_j if through else returned_j,
            unreceived_j=unused_j / through if through else 0.0,
        )

    @property
    def supplied_kwh(self) -> float:
        """Energy from the substations, kWh."""
        return self.supplied_j / J_PER_KWH


Profiles = Sequence[Mapping[int, PowerProfile]]
"""Power of each trip by its running time."""


def divide_zones(line: Line, zones: int) -> Int[ndarray, " sections"]:
    """Zone of each section: zones meet at the stations nearest to an even division of the line.

    Raises:
        InputError: More zones than sections, or none.
    """
    position = np.array([station.position_m for station in line.stations])
    sections = position.size - 1
    allowed = f"1 to {sections}, one for each section"
    if zones > sections:
        raise InputError("too many feeding zones", field="zones", value=zones, allowed=allowed)
    if zones < 1:
        raise InputError("a line needs a feeding zone", field="zones", value=zones, allowed=allowed)
    edges = [0]
    for k in range(1, zones):
        target = position[0] + (position[-1] - position[0]) * k / zones
        nearest = int(np.argmin(np.abs(position - target)))
        edges.append(min(max(nearest, edges[-1] + 1), sections - (zones - k)))
    return np.searchsorted(np.array(edges), np.arange(sections), side="right") - 1


class LineOperation:
    """A line in operation at a periodic headway.

    Args:
        line: Line; every station is a stop.
        trainset: Trainset with its load.
        options: Headway, dwells, windows, feeding.

    Attributes:
        line: Line.
        trainset: Trainset, its net energy counted as if every returned joule reached another train.
        options: Options.
        silent: The same without auxiliaries.
        trips: Trips of one train, forward and then backward.
        count: Trips in one direction.
        members: Trainsets behind another on the section of a trip, as far as they are made.
        motions: Motion of each profile and how far ahead it needs the way free, as far as they are known.

    Raises:
        InputError: More zones than sections.
        Infeasible: A planned running time is below the minimum.
    """

    def __init__(self, line: Line, trainset: Trainset, options: OperationOptions) -> None:
        self.line, self.options = line, options
        given = {
            name: Efficiency.constant(value)
            for name in ("efficiency_traction", "efficiency_braking")
            if (value := getattr(options, name)) is not None
        }
        self.trainset = replace(trainset, receptivity=1.0 - options.transfer_loss, **given)
        # The time of a trip is given, and with it what auxiliaries take: without them a plan uses all of it.
        self.silent = replace(self.trainset, auxiliary_w=0.0)
        zones = divide_zones(line, options.zones)
        self.count = zones.size
        self.members: dict[int, Member] = {}
        self.motions: dict[PowerProfile, tuple[ServiceRun, Float[ndarray, " times"]]] = {}
        both = [
            *((section, False, zone) for section, zone in zip(line.sections(), zones.tolist(), strict=True)),
            *(
                (section, True, zone)
                for section, zone in zip(line.sections(backward=True), zones[::-1].tolist(), strict=True)
            ),
        ]
        self.trips = tuple(self._trip(*each) for each in both)

    def _trip(self, section: Section, backward: bool, zone: int) -> Trip:
        minimum_s = minimum_running_time(section, self.trainset)
        if not math.isfinite(minimum_s):
            what = f"minimum running time of {section.name}"
            raise Infeasible(f"{what} is without end: the trainset stalls on the way", field="line")
        planned = section.planned_time_s
        planned_s = math.ceil(minimum_s * (1.0 + self.options.reserve)) if planned is None else round(planned)
        if planned_s < minimum_s:
            raise Infeasible(
                f"planned running time {section.name} is below the minimum",
                field="line",
                value=planned_s,
                unit="s",
                allowed=f">= {minimum_s:.1f} s",
            )
        window = self.options.time_window_s
        allowed = range(max(planned_s - window, math.ceil(minimum_s)), planned_s + window + 1)
        return Trip(section, backward, zone, planned_s, tuple(allowed))

    def with_headway(self, headway_s: int, dwell_s: int | None = None) -> LineOperation:
        """The same at another headway, and dwell where one is given; its window is no longer."""
        dwell_s = self.options.dwell_s if dwell_s is None else dwell_s
        window_s = min(self.options.dwell_window_s, dwell_s)
        other = copy(self)
        other.options = replace(self.options, headway_s=headway_s, dwell_s=dwell_s, dwell_window_s=window_s)
        return other

    def with_zones(self, zones: int) -> LineOperation:
        """The same with other feeding zones.

        Raises:
            InputError: More zones than sections.
        """
        forward = divide_zones(self.line, zones).tolist()
        other = copy(self)
        other.options = replace(self.options, zones=zones)
        both = zip(self.trips, forward + forward[::-1], strict=True)
        other.trips = tuple(trip._replace(zone=zone) for trip, zone in both)
        return other

    @property
    def planned_s(self) -> Int[ndarray, " trips"]:
        """Planned running times."""
        return np.array([trip.planned_s for trip in self.trips])

    def journey_s(self, *, backward: bool) -> int:
        """Planned time from the departure at one terminal station to the arrival at the other."""
        running = sum(trip.planned_s for trip in self.trips if trip.backward == backward)
        return running + (self.count - 1) * self.options.dwell_s

    def drive(
        self, trip: Trip, time_s: int, driving: Driving = "optimal", *, received_w: float = math.inf
    ) -> PowerProfile:
        """Power of a trip driven in a running time; see :meth:`profiles`."""
        options = PlanOptions(objective="line")
        if driving != "optimal":
            plan_of = cruise_plan if driving == "cruise" else coast_plan
            return profile_of_plan(plan_of(trip.section, self.silent, float(time_s), options), self.silent)
        vehicle, track = vehicle_arrays(self.silent), track_arrays(trip.section, self.silent)
        if math.isfinite(received_w):
            plan = ReceivedEnergy(vehicle, track, float(time_s)).plan(received_w)
        else:
            plan = plan_arrays(vehicle, track, float(time_s), options)
        return profile_of_plan(plan, self.silent)

    def profiles(
        self,
        driving: Driving = "optimal",
        *,
        windows: bool = False,
        times_s: Sequence[Iterable[int]] | None = None,
        received_w: float = math.inf,
    ) -> Profiles:
        """Power of every trip at its planned running time, or at every running time of its window.

        Args:
            driving: How trips are driven.
            windows: True for every running time of the window.
            times_s: Running times of each trip, instead of these.
            received_w: Power up to which optimal driving counts on being received. The floor asks for plans
                that count on all of it.
        """
        times_s = times_s or [trip.allowed_s if windows else (trip.planned_s,) for trip in self.trips]
        return [
            {time_s: self.drive(trip, time_s, driving, received_w=received_w) for time_s in times}
            for trip, times in zip(self.trips, times_s, strict=True)
        ]

    def plain_timetable(self, offset_s: float = 0.0) -> Timetable:
        """Planned running times and dwells.

        Args:
            offset_s: Departure of the first backward trip after that of a forward one.
        """
        running = self.planned_s
        steps = running + self.options.dwell_s
        starts = [
            np.concatenate([[0], np.cumsum(part[:-1])]) for part in (steps[: self.count], steps[self.count :])
        ]
        return Timetable(np.concatenate([starts[0], starts[1] + offset_s]).astype(float), running)

    def zone_power(self, timetable: Timetable, profiles: Profiles) -> tuple[PeriodicPower, ...]:
        """Net power of the trains in each zone: drawn, less what is returned after the transfer loss.

        A train at a platform is fed by the zone that it has come from.
        """
        return tuple(self.power_in(zone, timetable, profiles) for zone in range(self.options.zones))

    def power_in(self, zone: int, timetable: Timetable, profiles: Profiles) -> PeriodicPower:
        """Net power of the trains in one zone."""
        start: list[ndarray] = []
        lasts: list[ndarray] = []
        power: list[ndarray] = []
        dwell = self.dwells_s(timetable)
        for k in (k for k, trip in enumerate(self.trips) if trip.zone == zone):
            profile = profiles[k][int(timetable.running_time_s[k])]
            time = np.append(profile.time_s, profile.running_time_s + dwell[k])
            net = profile.net_w(self.options.transfer_loss)
            start.append(timetable.departure_s[k] + time[:-1])
            lasts.append(np.diff(time))
            power.append(np.append(net, np.zeros((1, 2)), axis=0) + self.trainset.auxiliary_w)
        pieces = np.concatenate(start), np.concatenate(lasts), np.concatenate(power)
        return add_periodic(*pieces, float(self.options.headway_s))

    def dwells_s(self, timetable: Timetable) -> Float[ndarray, " trips"]:
        """Time at the platform after each trip; none at the terminal stations, where trains are shut down."""
        dwell = np.append(timetable.departure_s[1:], 0.0) - timetable.arrival_s
        dwell[[self.count - 1, -1]] = 0.0
        return dwell

    def energy(self, timetable: Timetable, profiles: Profiles) -> EnergyBalance:
        """Energy of all trains in one headway, exact up to rounding."""
        zones = self.zone_power(timetable, profiles)
        driven = [of[int(s)] for of, s in zip(profiles, timetable.running_time_s, strict=True)]
        standing_s = float(self.dwells_s(timetable).sum())
        aboard_j = self.trainset.auxiliary_w * (sum(each.running_time_s for each in driven) + standing_s)
        returned_j = sum(each.returned_j for each in driven)
        return EnergyBalance.from_sums(
            supplied_j=sum(zone.positive_j for zone in zones),
            unused_j=sum(zone.negative_j for zone in zones),
            drawn_j=sum(each.drawn_j for each in driven) + aboard_j,
            returned_j=returned_j,
            through=1.0 - self.options.transfer_loss,
        )

    def mean_energy_j(self, profiles: Profiles) -> float:
        """Mean energy of the plain timetable over the offset between the directions."""
        offsets = self.options.headway_s * (np.arange(60) + 0.5) / 60
        return float(
            np.mean([self.energy(self.plain_timetable(each), profiles).supplied_j for each in offsets])
        )

    def floor_j(self, profiles: Profiles) -> float:
        """Energy that no timetable undercuts, however the trains are driven.

        The sum of the certified bounds of all trips with every returned joule received behind the transfer
        loss, and the auxiliaries. Where the profiles have several running times, a timetable may choose
        among them as long as the running times of a direction keep their sum: the bound is then the best of
        the Lagrangian, which holds for every price of a second.

        Args:
            profiles: Optimal profiles at the planned running times, or at all of their windows.
        """
        aboard_j = self.trainset.auxiliary_w * sum(self.journey_s(backward=b) for b in (False, True))
        return aboard_j + sum(self.trips_floor_j(profiles, backward=b) for b in (False, True))

    def trips_floor_j(self, profiles: Profiles, *, backward: bool) -> float:
        """The part of the floor that the trips of one direction have, without auxiliaries."""
        of = [k for k, trip in enumerate(self.trips) if trip.backward == backward]
        bounds = [{s: each.bound_j for s, each in profiles[k].items()} for k in of]
        total_s = sum(self.trips[k].planned_s for k in of)
        prices = [0.0]
        for each in bounds:
            times = sorted(each)
            prices += [(each[a] - each[b]) / (b - a) for a, b in pairwise(times)]
        return max(
            sum(min(j + price * s for s, j in each.items()) for each in bounds) - price * total_s
            for price in prices
        )

    def fleet(self, timetable: Timetable) -> int:
        """Trains in operation with the shortest turn-rounds that the timetable and their least time allow."""
        headway_s, least_s = self.options.headway_s, self.options.turnround_s
        arrival = timetable.arrival_s
        there_s, back_s = arrival[self.count - 1], arrival[-1] - timetable.departure_s[self.count]
        wait_s = least_s + (timetable.departure_s[self.count] - there_s - least_s) % headway_s
        return math.ceil((there_s + wait_s + back_s + least_s - timetable.departure_s[0]) / headway_s - 1e-9)
