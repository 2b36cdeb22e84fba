"""A line at one headway hour after hour, which shows drivers and departures that scatter."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Int
from metropilot.errors import Infeasible
from metropilot.operation.comparison import DrivenEnergy, ScatteredEnergy, mean_of_all
from metropilot.operation.day import (
    HOUR_S,
    DayTimetable,
    LineDay,
    PeriodicPart,
    feed_day,
    link_trains,
    repeat_timetables,
)
from metropilot.operation.feeding import feed_line
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.trip_drives import TripDrives
from metropilot.railway import LONGEST_WAIT_S, Feeding
from metropilot.units import J_PER_KWH

PHASES = 4
"""Offsets between the directions over which a plain timetable is averaged."""
SAMPLES = 4
"""Draws of departures that scatter."""
LATE_S = 600
"""Nobody is later than this."""


class ServiceScatter(NamedTuple):
    """Deviations from the plan: a driver, and departures that scatter.

    Attributes:
        drives: Runs of a driver who drives the trips besides, of which each trip draws one; None: nobody.
        departures_s: Seconds by which departures of optimal driving scatter, each reported.
        seed: Seed of the departures.
    """

    drives: TripDrives | None = None
    departures_s: tuple[float, ...] = ()
    seed: int = 0


AS_PLANNED = ServiceScatter()


class ServiceHours:
    """Trains of both directions at one headway, until an hour is as any other; that one is measured.

    Args:
        operation: Line in operation.
        feeding: Network that feeds it; None: its zones.
    """

    def __init__(self, operation: LineOperation, feeding: Feeding | None = None) -> None:
        self.operation, self.feeding = operation, feeding
        longest_s = max(operation.journey_s(backward=way) for way in (False, True))
        filled_s = longest_s + operation.options.headway_s + LATE_S
        self._hour_s = HOUR_S * math.ceil(filled_s / HOUR_S)

    @property
    def offsets_s(self) -> list[float]:
        """Equal steps of the offset of the directions, whole seconds."""
        return np.round(self.operation.options.headway_s * (np.arange(PHASES) + 0.5) / PHASES).tolist()

    def repeat(self, timetable: Timetable, plan: Int[ndarray, " trips"] | None = None) -> DayTimetable:
        """Journeys of a periodic timetable.

        Args:
            timetable: Timetable of one headway.
            plan: Number of the profiles of each trip; None: the first.
        """
        plan = np.zeros(len(self.operation.trips), dtype=int) if plan is None else plan
        to_s, headway_s = self._hour_s + HOUR_S, self.operation.options.headway_s
        return repeat_timetables([PeriodicPart(0, to_s, headway_s, timetable, plan)])

    def periodic_kwh(self, timetable: Timetable, profiles: Profiles) -> float | None:
        """Energy of one headway of a periodic timetable; None where the network cannot carry the load."""
        if self.feeding is None:
            return self.operation.energy(timetable, profiles).supplied_kwh
        try:
            return feed_line(self.operation, timetable, profiles, self.feeding).energy_kwh
        except Infeasible:
            return None

    def plain_kwh(self, profiles: Profiles) -> float | None:
        """The same with plain timetables, mean over the offset."""
        plain = (self.operation.plain_timetable(each) for each in self.offsets_s)
        return mean_of_all([self.periodic_kwh(each, profiles) for each in plain])

    def scatter(self, timetable: Timetable, profiles: Profiles, scatter: ServiceScatter) -> dict[str, Any]:
        """Energy of a driver and of departures that scatter, as fields of :class:`ComparedEnergy`.

        Raises:
            Infeasible: A run does not arrive.
        """
        plain = [self.repeat(self.operation.plain_timetable(each)) for each in self.offsets_s]
        return scatter_service(scatter, plain, self.repeat(timetable), [profiles], self.energy_kwh)

    def energy_kwh(self, timetable: DayTimetable, plans: Sequence[Profiles]) -> float | None:
        """Energy of one headway, mean over the hour; None where the network cannot carry the load."""
        day = LineDay(self.operation, timetable, plans)
        if self.feeding is None:
            power = day.power()
            hour_kwh = float(power.hourly_kwh[(self._hour_s - power.first_s) // HOUR_S])
        else:
            links = link_trains(day.timetable, self.operation.options.turnround_s, LONGEST_WAIT_S)
            try:
                flow = feed_day(day, self.feeding, links).flow
            except Infeasible:
                return None
            first = self._hour_s - math.floor(day.timetable.span_s[0])
            net_w = (flow.rectifier_w - flow.inverter_w).sum(axis=1)[first : first + HOUR_S]
            hour_kwh = float(net_w.sum()) / J_PER_KWH
        return hour_kwh * self.operation.options.headway_s / HOUR_S


def scatter_service(
    scatter: ServiceScatter,
    plain: Sequence[DayTimetable],
    found: DayTimetable,
    plans: Sequence[Profiles],
    energy_kwh: Callable[[DayTimetable, Sequence[Profiles]], float | None],
) -> dict[str, Any]:
    """Energy of a driver and of departures that scatter, as fields of :class:`ComparedEnergy`.

    Args:
        scatter: What scatters.
        plain: Plain timetables.
        found: Timetable found.
        plans: Powers of its trips by optimal driving.
        energy_kwh: Energy of a timetable and the powers of its trips, None where that is not to be had.

    Raises:
        Infeasible: A run does not arrive.
    """
    scattered = []
    for seconds in scatter.departures_s:
        random = np.random.default_rng([scatter.seed, round(1000 * seconds)])
        drawn = [energy_kwh(found.scatter(seconds, random), plans) for _ in range(SAMPLES)]
        known = [each for each in drawn if each is not None]
        deviation_kwh = float(np.std(known, ddof=1)) if len(known) == SAMPLES else None
        scattered.append(ScatteredEnergy(seconds, mean_of_all(drawn), deviation_kwh))
    driven = None if scatter.drives is None else _driven(scatter.drives, plain, found, energy_kwh)
    return {"driven": driven, "scattered": tuple(scattered)}


def _driven(
    drives: TripDrives,
    plain: Sequence[DayTimetable],
    found: DayTimetable,
    energy_kwh: Callable[[DayTimetable, Sequence[Profiles]], float | None],
) -> DrivenEnergy:
    """Energy of a driver with plain timetables and the one found; every trip draws one of his runs."""
    both = [np.concatenate([each[way].running_time_s for each in (plain[0], found)]) for way in (0, 1)]
    times_s = [sorted({int(s) for s in running_s}) for each in both for running_s in each.T]
    runs, random = drives.profiles(times_s), np.random.default_rng(drives.seeds[0])
    late_s = [profile.running_time_s - time_s for run in runs for of in run for time_s, profile in of.items()]
    return DrivenEnergy(
        drives.driver,
        mean_of_all([energy_kwh(each.with_plans(len(runs), random), runs) for each in plain]),
        energy_kwh(found.with_plans(len(runs), random), runs),
        float(np.mean(late_s)),
        float(np.std(late_s)),
    )
