"""Energy of a day by driving and timetable, beside its floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from metropilot.errors import Infeasible, InputError, rename_fields
from metropilot.operation.comparison import ComparedEnergy
from metropilot.operation.day import (
    HOUR_S,
    MINUTE_S,
    DayPower,
    DayTimetable,
    LineDay,
    PeriodicPart,
    TrainLinks,
    link_trains,
    repeat_timetables,
)
from metropilot.operation.feeding import FeedingEnergy
from metropilot.operation.headway import PeriodLeads, check_day, check_headway
from metropilot.operation.line_service import Driving, LineOperation, Profiles, Timetable
from metropilot.operation.power import PowerProfile
from metropilot.operation.report import plan_trips
from metropilot.operation.search import MOVES, best_offset, choose_plans, find_timetable
from metropilot.operation.service_hours import AS_PLANNED, PHASES, ServiceScatter, scatter_service
from metropilot.railway import LONGEST_WAIT_S, Period, ServiceDay
from metropilot.units import J_PER_KWH, format_clock

DRIVINGS: tuple[Driving, ...] = "optimal", "cruise"
RESTARTS = 3
"""Starts of each search: a day has several headways."""


@dataclass(frozen=True, kw_only=True)
class DayEnergy(ComparedEnergy):
    """Energy of all journeys of a day; its floor is that of all received at the same running times.

    Where the timetables compared have other numbers of journeys, their energy is that of as many.

    Attributes:
        name: Name of the day.
        day: The day with the timetable found, driven by its plans.
        links: Trains.
        power: Power of the day.
        period_names: Names of the periods; none where the timetable was given.
    """

    name: str
    day: LineDay
    links: TrainLinks
    power: DayPower
    period_names: tuple[str, ...] = ()

    def as_dict(self, network: FeedingEnergy | None = None) -> dict[str, Any]:
        """Values as JSON holds them.

        Args:
            network: What a network makes of the day, if one feeds the line.
        """
        power = self.power
        first_s, last_s = self.day.timetable.span_s
        shared = self.describe(self.day.operation, None if network is None else network.as_dict())
        return shared | {
            "day": self.name,
            "first_departure": format_clock(first_s),
            "last_arrival": format_clock(last_s),
            "journeys": {
                "forward": self.day.timetable.forward.period.size,
                "backward": self.day.timetable.backward.period.size,
            },
            "fleet": self.links.fleet,
            "pull_outs": self.links.pull_outs,
            "pull_ins": self.links.pull_ins,
            "zones_kwh": (power.supplied_w.sum(axis=0) * MINUTE_S / J_PER_KWH).tolist(),
            "hours": [
                {"from": format_clock(power.first_s + HOUR_S * hour), "energy_kwh": float(kwh)}
                for hour, kwh in enumerate(power.hourly_kwh)
            ],
            "peak_minute_w": float(power.supplied_w.sum(axis=1).max()),
        }


def lay_out_day(
    operation: LineOperation,
    day: ServiceDay,
    plans: Sequence[Profiles],
    *,
    others: Sequence[Profiles] = (),
    searched: bool = False,
    seed: int = 0,
    moves: int = MOVES,
) -> DayTimetable:
    """Find the timetable of a day: for each headway and dwell that of least energy, and its plans.

    A period begins later where its first train would disturb the last one of the period before, or be
    disturbed by it.

    Args:
        operation: Line in operation.
        day: Periods.
        plans: Profiles to choose from.
        others: Profiles with which periods must follow each other as well.
        searched: Search dwells and running times too; else only the offset of the directions.
        seed: Seed of the search.
        moves: Moves that it tries from each start.

    Raises:
        InputError: Trains disturb one another at a headway; names the section or station.
    """
    found: dict[tuple[int, int], tuple[Timetable, list[int]]] = {}
    parts = []
    for period, periodic in _periodic(operation, day):
        key = periodic.options.headway_s, periodic.options.dwell_s
        if key not in found:
            with rename_fields({"headway_s": f"headway of {period.name}"}, day.id):
                check_headway(periodic, periodic.plain_timetable(), plans[0], *others)
            if searched:
                timetable, chosen = find_timetable(periodic, plans, seed=seed, moves=moves, restarts=RESTARTS)
            else:
                timetable = best_offset(periodic, plans[0])
                chosen, _ = choose_plans(periodic, timetable, plans)
            numbers = [
                next(i for i, each in enumerate(plans) if each[k] is of) for k, of in enumerate(chosen)
            ]
            found[key] = timetable, numbers
        timetable, numbers = found[key]
        parts.append(PeriodicPart(period.from_s, period.to_s, period.headway_s, timetable, np.array(numbers)))
    return repeat_timetables(parts, PeriodLeads(operation, parts, plans, others))


def plain_days(
    operation: LineOperation, day: ServiceDay, drivings: Sequence[Profiles], phases: int = PHASES
) -> list[DayTimetable]:
    """Timetables at planned running times and dwells, by equal steps of the offset of the directions.

    Args:
        operation: Line in operation.
        day: Periods.
        drivings: Profiles with all of which one period follows the other.
        phases: Number of steps.
    """
    days = []
    for phase in range(phases):
        parts = [
            PeriodicPart(
                period.from_s,
                period.to_s,
                period.headway_s,
                periodic.plain_timetable(float(round(period.headway_s * (phase + 0.5) / phases))),
                np.zeros(len(operation.trips), dtype=int),
            )
            for period, periodic in _periodic(operation, day)
        ]
        days.append(repeat_timetables(parts, PeriodLeads(operation, parts, drivings[:1], drivings[1:])))
    return days


def _periodic(operation: LineOperation, day: ServiceDay) -> list[tuple[Period, LineOperation]]:
    return [(period, operation.with_headway(period.headway_s, period.dwell_s)) for period in day.periods]


def day_floor_j(
    operation: LineOperation, timetable: DayTimetable, profiles: Profiles, *, windows: bool = False
) -> float:
    """Energy that a day does not undercut, however its trains are driven, all that is returned received.

    Args:
        operation: Line in operation.
        timetable: Timetable; each journey keeps its running times, and its sum of dwells.
        profiles: Optimal profiles at its running times.
        windows: True for journeys that may choose among those of the profiles, at their planned sum.
    """
    total_j = 0.0
    for way, each in enumerate(timetable):
        aboard_s = float(np.sum(each.arrival_s[:, -1] - each.departure_s[:, 0]))
        total_j += operation.trainset.auxiliary_w * aboard_s
        if windows:
            total_j += each.period.size * operation.trips_floor_j(profiles, backward=bool(way))
            continue
        of = profiles[operation.count * way :][: operation.count]
        for bounds, running_s in zip(of, each.running_time_s.T, strict=True):
            total_j += sum(bounds[int(s)].bound_j for s in running_s)
    return total_j


def day_energy(
    operation: LineOperation,
    day: ServiceDay,
    *,
    searched: bool = False,
    seed: int = 0,
    moves: int = MOVES,
    scatter: ServiceScatter = AS_PLANNED,
    plans: Mapping[str, Sequence[Profiles]] | None = None,
) -> DayEnergy:
    """Compute the energy of a day by driving and timetable, and its floor.

    Args:
        operation: Line in operation.
        day: Day of that line.
        searched: Search dwells and running times too, within their windows; else only the offset.
        seed: Seed of the search.
        moves: Moves that the search tries from each start.
        scatter: What does not go as planned, reported besides.
        plans: What :func:`plan_trips` gave, if it is there.

    Raises:
        Infeasible: More trains are needed than there are.
    """
    plans = plans or plan_trips(operation, windows=searched)
    # one timetable whatever the driving, which can be read again from its feed
    drivings = [plans["optimal"][0], *plans["cruise"]]
    plain = plain_days(operation, day, drivings)
    best, cruise = (
        lay_out_day(
            operation, day, plans[driving], others=drivings, searched=searched, seed=seed, moves=moves
        )
        for driving in ("optimal", "cruise")
    )
    links = link_trains(best, operation.options.turnround_s, day.longest_wait_s)
    if day.fleet is not None and links.fleet > day.fleet:
        raise Infeasible(
            "the timetable needs more trains",
            file=day.id,
            field="trains.fleet",
            value=day.fleet,
            allowed=f">= {links.fleet}",
        )
    found = LineDay(operation, best, plans["optimal"])
    kwh, power = partial(_kwh, operation, best.journeys), found.power()
    mean = {name: np.mean([kwh(each, plans[name]) for each in plain]) for name in plans}
    return DayEnergy(
        name=day.name,
        day=found,
        links=links,
        power=power,
        balance=found.energy(power),
        searched=searched,
        cruise_kwh=float(mean["cruise"]),
        driving_only_kwh=float(mean["optimal"]),
        timetable_only_kwh=kwh(cruise, plans["cruise"]),
        floor_kwh=day_floor_j(operation, best, plans["optimal"][0], windows=searched) / J_PER_KWH,
        period_names=tuple(each.name for each in day.periods),
        **scatter_service(scatter, plain, best, plans["optimal"], kwh),
    )


def timetable_energy(
    operation: LineOperation,
    timetable: DayTimetable,
    name: str,
    *,
    scatter: ServiceScatter = AS_PLANNED,
) -> DayEnergy:
    """Compute the energy of a day whose timetable is given, and its floor at these running times.

    Args:
        operation: Line in operation.
        timetable: Timetable.
        name: Name of the day.
        scatter: What does not go as planned, reported besides.

    Raises:
        InputError: A running time is below the minimum or too long, or a train disturbs the next one; names
            the trains by their departures, and the section or station.
    """
    optimal, cruise = (_given_profiles(operation, timetable, driving, name) for driving in DRIVINGS)
    for profiles in (optimal, cruise):
        check_day(operation, timetable, [profiles])
    found, kwh = LineDay(operation, timetable, [optimal]), partial(_kwh, operation, timetable.journeys)
    power, cruise_kwh = found.power(), kwh(timetable, [cruise])
    balance = found.energy(power)
    return DayEnergy(
        name=name,
        day=found,
        links=link_trains(timetable, operation.options.turnround_s, LONGEST_WAIT_S),
        power=power,
        balance=balance,
        searched=False,
        cruise_kwh=cruise_kwh,
        driving_only_kwh=balance.supplied_kwh,
        timetable_only_kwh=cruise_kwh,
        floor_kwh=day_floor_j(operation, timetable, optimal) / J_PER_KWH,
        **scatter_service(scatter, [timetable], timetable, [optimal], kwh),
    )


def _given_profiles(
    operation: LineOperation, timetable: DayTimetable, driving: Driving, name: str
) -> list[dict[int, PowerProfile]]:
    """Profiles of every trip at the running times of a timetable.

    Raises:
        InputError: A running time that cannot be driven; names the train and the section.
    """
    found: list[dict[int, PowerProfile]] = []
    for trip in operation.trips:
        each, k = timetable[trip.backward], len(found) % operation.count
        found.append({})
        for running_s in np.unique(each.running_time_s[:, k]).tolist():
            try:
                found[-1][running_s] = operation.drive(trip, running_s, driving)
            except InputError as error:
                j = int(np.argmax(each.running_time_s[:, k] == running_s))
                clock, way = (
                    format_clock(float(each.departure_s[j, 0])),
                    ("forward", "backward")[trip.backward],
                )
                where = f"train of {clock}, {way}, {trip.section.name}"
                raise error.at(file=name, field=where) from error
    return found


def _kwh(
    operation: LineOperation, journeys: int, timetable: DayTimetable, plans: Sequence[Profiles]
) -> float:
    """Energy of a day, for so many journeys."""
    day_j = float(LineDay(operation, timetable, plans).power().supplied_w.sum()) * MINUTE_S
    return day_j / J_PER_KWH * journeys / timetable.journeys
