"""Energy of a day by driving and timetable, beside its floor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from metropilot.errors import Infeasible, rename_fields
from metropilot.evaluate import make_driver
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
from metropilot.operation.headway import check_headway
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.network import solve_network
from metropilot.operation.power import profile_of_trajectory
from metropilot.operation.report import plan_trips
from metropilot.operation.search import MOVES, best_offset, choose_plans, find_timetable
from metropilot.railway import LONGEST_WAIT_S, Feeding, Period, ServiceDay
from metropilot.sim import Outcome, Run, drive
from metropilot.units import J_PER_KWH, format_clock

PHASES = 4
"""Offsets between the directions over which a plain day is averaged."""


def drive_trips(
    operation: LineOperation,
    driver: str,
    *,
    seeds: Sequence[int] = (0,),
    times_s: Sequence[Iterable[int]] | None = None,
) -> list[Profiles]:
    """Power of every trip as a driver drives it under protection, once for each seed.

    Args:
        operation: Line in operation.
        driver: Driver id.
        seeds: Seeds of the runs.
        times_s: Running times of each trip; None: the planned one.

    Raises:
        InputError: No such driver.
        Infeasible: A run does not arrive.
    """
    acting = make_driver(driver)
    times_s = times_s or [(trip.planned_s,) for trip in operation.trips]
    driven = []
    for seed in seeds:
        profiles = []
        for trip, times in zip(operation.trips, times_s, strict=True):
            of = {}
            for time_s in times:
                done = drive(Run(trip.section, operation.trainset, float(time_s), seed=seed), acting)
                if done.outcome is not Outcome.ARRIVED:
                    raise Infeasible(
                        f"{driver} does not arrive, {trip.section.name} in {time_s} s, seed {seed}",
                        field="driver",
                        value=done.outcome.value,
                        allowed="arrived",
                    )
                of[time_s] = profile_of_trajectory(done.trajectory, operation.silent)
            profiles.append(of)
        driven.append(profiles)
    return driven


@dataclass(frozen=True)
class DrivenDay:
    """A day as a driver drives it.

    Attributes:
        driver: Driver id.
        plain_kwh: Energy with the plain timetable, mean over the offset.
        energy_kwh: Energy with the timetable found.
        mean_late_s: Mean arrival after the timetable.
        scatter_s: Standard deviation of it.
    """

    driver: str
    plain_kwh: float
    energy_kwh: float
    mean_late_s: float
    scatter_s: float


@dataclass(frozen=True, kw_only=True)
class DayEnergy(ComparedEnergy):
    """Energy of all journeys of a day; its floor is that of all received at the same journey times.

    Attributes:
        name: Name of the day.
        day: The day with the timetable found, driven by its plans.
        links: Trains.
        power: Power of the day.
        driven: The same day with a driver, where one was asked for.
        period_names: Names of the periods; none where the timetable was given.
    """

    name: str
    day: LineDay
    links: TrainLinks
    power: DayPower
    driven: DrivenDay | None = None
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
            "driver": None if self.driven is None else vars(self.driven),
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
    searched: bool = False,
    seed: int = 0,
    moves: int = MOVES,
) -> DayTimetable:
    """Find the timetable of a day: for each headway and dwell that of least energy, and its plans.

    Args:
        operation: Line in operation.
        day: Periods.
        plans: Profiles to choose from.
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
                check_headway(periodic, periodic.plain_timetable(), plans[0])
            if searched:
                timetable, chosen = find_timetable(periodic, plans, seed=seed, moves=moves)
            else:
                timetable = best_offset(periodic, plans[0])
                chosen, _ = choose_plans(periodic, timetable, plans)
            numbers = [
                next(i for i, each in enumerate(plans) if each[k] is of) for k, of in enumerate(chosen)
            ]
            found[key] = timetable, numbers
        timetable, numbers = found[key]
        parts.append(PeriodicPart(period.from_s, period.to_s, period.headway_s, timetable, np.array(numbers)))
    return repeat_timetables(parts)


def plain_days(operation: LineOperation, day: ServiceDay, phases: int = PHASES) -> list[DayTimetable]:
    """Timetables at planned running times and dwells, by equal steps of the offset of the directions."""
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
        days.append(repeat_timetables(parts))
    return days


def _periodic(operation: LineOperation, day: ServiceDay) -> list[tuple[Period, LineOperation]]:
    return [(period, operation.with_headway(period.headway_s, period.dwell_s)) for period in day.periods]


def day_floor_j(
    operation: LineOperation, timetable: DayTimetable, profiles: Profiles, *, windows: bool = False
) -> float:
    """Energy that a day does not undercut, however its trains are driven, all that is returned received.

    Args:
        operation: Line in operation.
        timetable: Timetable; each journey keeps the time that it takes from end to end.
        profiles: Optimal profiles at its running times.
        windows: True for journeys that may choose among these running times, at their planned sum.
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
    driver: str | None = None,
    runs: int = 1,
    plans: Mapping[str, Sequence[Profiles]] | None = None,
) -> DayEnergy:
    """Compute the energy of a day by driving and timetable, and its floor.

    Args:
        operation: Line in operation.
        day: Day of that line.
        searched: Search dwells and running times too, within their windows; else only the offset.
        seed: Seed of the search, and of the first run of a driver.
        moves: Moves that the search tries from each start.
        driver: A driver who drives the same trips besides.
        runs: His runs of every trip, by seeds; every journey draws its own.
        plans: What :func:`plan_trips` gave, if it is there.

    Raises:
        Infeasible: More trains are needed than there are.
    """
    plans = plans or plan_trips(operation, windows=searched)
    plain = plain_days(operation, day)
    best, cruise = (
        lay_out_day(operation, day, plans[driving], searched=searched, seed=seed, moves=moves)
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
    mean = {name: np.mean([_kwh(operation, each, plans[name]) for each in plain]) for name in plans}
    driven = None
    if driver is not None:
        driven = _driven(operation, driver, range(seed, seed + runs), plain, best)
    power = found.power()
    return DayEnergy(
        name=day.name,
        day=found,
        links=links,
        power=power,
        balance=found.energy(power),
        searched=searched,
        cruise_kwh=float(mean["cruise"]),
        driving_only_kwh=float(mean["optimal"]),
        timetable_only_kwh=_kwh(operation, cruise, plans["cruise"]),
        floor_kwh=day_floor_j(operation, best, plans["optimal"][0], windows=searched) / J_PER_KWH,
        driven=driven,
        period_names=tuple(each.name for each in day.periods),
    )


def timetable_energy(
    operation: LineOperation,
    timetable: DayTimetable,
    name: str,
    *,
    longest_wait_s: int = LONGEST_WAIT_S,
    seed: int = 0,
    driver: str | None = None,
    runs: int = 1,
) -> DayEnergy:
    """Compute the energy of a day whose timetable is given, and its floor at these running times.

    Args:
        operation: Line in operation.
        timetable: Timetable.
        name: Name of the day.
        longest_wait_s: A train that would wait longer at a terminal station goes to the depot.
        seed: Seed of the first run of a driver.
        driver: A driver who drives the same trips besides.
        runs: His runs of every trip, by seeds; every journey draws its own.

    Raises:
        Infeasible: A running time is below the minimum.
    """
    times_s = [
        sorted({int(s) for s in running_s}) for each in timetable for running_s in each.running_time_s.T
    ]
    optimal, cruise = (operation.profiles(driving, times_s=times_s) for driving in ("optimal", "cruise"))
    found = LineDay(operation, timetable, [optimal])
    driven = None
    if driver is not None:
        driven = _driven(operation, driver, range(seed, seed + runs), [timetable], timetable, times_s)
    power, cruise_kwh = found.power(), _kwh(operation, timetable, [cruise])
    balance = found.energy(power)
    return DayEnergy(
        name=name,
        day=found,
        links=link_trains(timetable, operation.options.turnround_s, longest_wait_s),
        power=power,
        balance=balance,
        searched=False,
        cruise_kwh=cruise_kwh,
        driving_only_kwh=balance.supplied_kwh,
        timetable_only_kwh=cruise_kwh,
        floor_kwh=day_floor_j(operation, timetable, optimal) / J_PER_KWH,
        driven=driven,
    )


def _kwh(operation: LineOperation, timetable: DayTimetable, plans: Sequence[Profiles]) -> float:
    return float(LineDay(operation, timetable, plans).power().supplied_w.sum()) * MINUTE_S / J_PER_KWH


def _driven(
    operation: LineOperation,
    driver: str,
    seeds: Sequence[int],
    plain: Sequence[DayTimetable],
    best: DayTimetable,
    times_s: Sequence[Iterable[int]] | None = None,
) -> DrivenDay:
    """A driver on plain days and on the day found, at the running times of each."""
    if times_s is None:
        both = [np.concatenate([each[way].running_time_s for each in (plain[0], best)]) for way in (0, 1)]
        times_s = [sorted({int(s) for s in running_s}) for each in both for running_s in each.T]
    runs, random = (
        drive_trips(operation, driver, seeds=seeds, times_s=times_s),
        np.random.default_rng(seeds[0]),
    )
    late_s = [profile.running_time_s - time_s for run in runs for of in run for time_s, profile in of.items()]
    return DrivenDay(
        driver,
        float(np.mean([_kwh(operation, each.with_plans(len(runs), random), runs) for each in plain])),
        _kwh(operation, best.with_plans(len(runs), random), runs),
        float(np.mean(late_s)),
        float(np.std(late_s)),
    )


def feed_day(day: LineDay, feeding: Feeding) -> FeedingEnergy:
    """Feed all trains of a day by a DC network.

    Args:
        day: Day of a line.
        feeding: Network.

    Raises:
        InputError: A substation off the line.
        Infeasible: The network cannot carry the load.
    """
    feeding.check_line(day.operation.line)
    flow = solve_network(feeding, *day.loads())
    flow.check_served()
    return FeedingEnergy(feeding, flow)
