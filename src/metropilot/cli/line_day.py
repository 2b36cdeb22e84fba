"""A day of `metropilot line`: table, JSON and folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from metropilot.cli.console import console, number, table
from metropilot.errors import InputError

if TYPE_CHECKING:
    from metropilot.operation import (
        DayEnergy,
        FeedingEnergy,
        LineOperation,
        OperationEnergy,
        ServiceScatter,
    )


@dataclass(frozen=True)
class DayRequest:
    """Options of a day.

    Attributes:
        day: Day: id of the catalogue, or file; None: the timetable is given.
        timetable: GTFS feed with its timetable; None: it is found.
        service: Service of that feed.
        driver: Driver id of a driver who drives the trips besides.
        runs: His runs of every trip.
        scatter: Seconds by which departures scatter; None: they do not.
        optimise: Search dwells and running times too.
        seed: Seed.
    """

    day: str | None
    timetable: Path | None
    service: str | None
    driver: str | None
    runs: int
    scatter: float | None
    optimise: bool
    seed: int


def check_day_options(request: DayRequest) -> None:
    """Refuse options that do not go together.

    Raises:
        InputError: A day and a timetable, or an option of a day without one.
    """
    if request.day is not None and request.timetable is not None:
        raise InputError("a day and a timetable at once", field="timetable", allowed="--day or --timetable")
    if request.timetable is not None and request.optimise:
        raise InputError("a timetable that is given is not searched", field="optimise", allowed="--day FILE")
    if request.service is not None and request.timetable is None:
        raise InputError("needs a timetable", field="service", allowed="--timetable FOLDER|FILE.zip")
    if request.driver is None and request.runs != 1:
        raise InputError("needs a driver", field="runs", value=request.runs, allowed="--driver ID")
    if request.driver is not None:
        from metropilot.evaluate import make_driver

        make_driver(request.driver)


def make_scatter(operation: LineOperation, request: DayRequest) -> ServiceScatter:
    """Make the deviations from the plan: a driver, and departures that scatter."""
    from metropilot.operation import ServiceScatter, TripDrives

    seeds = range(request.seed, request.seed + request.runs)
    drives = None if request.driver is None else TripDrives(operation, request.driver, seeds)
    return ServiceScatter(drives, () if request.scatter is None else (request.scatter,), request.seed)


def compute_day(operation: LineOperation, request: DayRequest) -> DayEnergy:
    """Compute the energy of a day.

    Args:
        operation: Line in operation.
        request: Options.

    Raises:
        InputError: A day of another line, or a timetable that cannot be used.
    """
    from metropilot.operation import day_energy, read_gtfs, timetable_energy
    from metropilot.railway import load_day

    scatter = make_scatter(operation, request)
    line = operation.line
    if request.timetable is not None:
        given = read_gtfs(request.timetable, line, request.service)
        return timetable_energy(operation, given, str(request.timetable), scatter=scatter)
    assert request.day is not None
    day = load_day(request.day)
    day.check_line(line)
    return day_energy(operation, day, searched=request.optimise, seed=request.seed, scatter=scatter)


def energy_cells(
    found: OperationEnergy | DayEnergy, rows: Sequence[tuple[str, str, float | None]], digits: int
) -> list[tuple[str, ...]]:
    """Cells of energies: driving, timetable, kWh, saved against cruise and brake, above the floor."""
    from metropilot.operation import saved_and_gap_percent

    bounds = found.cruise_kwh, found.floor_kwh
    return [
        (*words, number(kwh, digits), *(number(each) for each in saved_and_gap_percent(kwh, *bounds)))
        for *words, kwh in rows
    ]


def print_day(found: DayEnergy, fed: FeedingEnergy | None) -> None:
    """Print the energies of a day, its hours and what a network makes of it."""
    operation, timetable, driven = found.day.operation, found.day.timetable, found.driven
    given = not found.period_names
    rows: list[tuple[str, str, float | None]] = [
        ("cruise and brake", "given" if given else "plain, mean offset", found.cruise_kwh),
        ("optimal driving", "given" if given else "plain, mean offset", found.driving_only_kwh),
    ]
    if not given:
        rows += [
            ("cruise and brake", "best found", found.timetable_only_kwh),
            ("optimal driving", "best found", found.energy_kwh),
        ]
    if driven is not None:
        if not given:
            rows.append((driven.driver, "plain, mean offset", driven.plain_kwh))
        rows.append((driven.driver, "given" if given else "best found", driven.energy_kwh))
    rows.append(("floor, all received", "given running times" if given else "any", found.floor_kwh))
    cells = energy_cells(found, rows, 0)
    ways = " + ".join(str(each.period.size) for each in timetable)
    title = (
        f"{operation.line.id}, {operation.trainset.id} {operation.trainset.load}, {found.name}; "
        f"{ways} journeys, {found.links.fleet} trains"
    )
    columns = ("driving", "timetable", "kWh a day", "saved %", "gap %")
    out = console()
    out.print(table(title, columns, cells, right=(2, 3, 4)))
    told = found.as_dict(fed)
    out.print(
        f"First departure {told['first_departure']}, last arrival {told['last_arrival']}; "
        f"trains leave the depot {told['pull_outs']} times in all. Highest minute "
        f"{told['peak_minute_w'] / 1e6:.1f} MW; "
        f"{told['unreceived_kwh']:.0f} of {told['returned_kwh']:.0f} kWh returned are not received."
    )
    hours = "  ".join(f"{each['from'][:2]} h {each['energy_kwh']:.0f}" for each in told["hours"])
    out.print(f"Energy by hours, kWh: {hours}")
    print_scatter(found)
    if fed is not None:
        flow = told["feeding"]["network"]
        out.print(
            f"Feeding {flow['id']}: {flow['energy_kwh']:.0f} kWh a day; {flow['rail_loss_kwh']:.0f} are "
            f"lost in the rails, {flow['substation_loss_kwh']:.0f} in substations, "
            f"{flow['squeezed_kwh']:.0f} squeezed; lowest voltage {flow['lowest_v']:.0f} V, peak of all "
            f"substations {flow['peak_w'] / 1e6:.1f} MW."
        )


def print_scatter(found: DayEnergy | OperationEnergy) -> None:
    """Print how late a driver arrives, and what departures that scatter cost."""
    driven, out = found.driven, console()
    if driven is not None:
        out.print(
            f"{driven.driver}: {number(driven.plain_kwh, 1)} kWh with the plain timetable, "
            f"{number(driven.energy_kwh, 1)} with the one found; arrives "
            f"{driven.mean_late_s:+.1f} s after the timetable, standard deviation {driven.scatter_s:.1f} s."
        )
    for each in found.scattered:
        out.print(
            f"Departures that scatter by {each.seconds:g} s: {number(each.energy_kwh, 1)} kWh with optimal "
            f"driving, standard deviation {number(each.deviation_kwh, 1)}."
        )
    known = [each.energy_kwh for each in found.scattered]
    known += [] if driven is None else [driven.plain_kwh, driven.energy_kwh]
    if None in known:
        out.print("–: the network cannot carry the load of that hour.")
