"""Campaigns of lines in operation: headways and days x lines x trainsets x feedings x options, a row each.

A row is what ``metropilot line`` computes. Plans, bounds and a driver's runs depend on neither headway nor
zones, so a worker makes them once for all its rows.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from math import prod
from pathlib import Path
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from metropilot._schema import field_specs, field_type
from metropilot.campaign.matrix import (
    LINE,
    AbstractCampaign,
    CellRow,
    capture_errors,
    content_key,
    count_axes,
    peak_memory_mb,
)
from metropilot.operation import (
    DayEnergy,
    LineOperation,
    OperationEnergy,
    OperationOptions,
    Profiles,
    ServiceScatter,
    TripDrives,
    TripFloors,
    day_energy,
    feed_day,
    feed_line,
    operation_energy,
    plan_trips,
)
from metropilot.railway import load_day, load_feeding, load_line, load_trainset

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

COMPUTED = "computed"
ZONES = 4
"""Zones for which a timetable is sought that a network feeds, where the file names none."""
PER_CELL = ("headway_s", "zones")
"""Fields of an operation that the matrix gives each cell."""
OPTIONS = tuple(name for name in field_specs(OperationOptions) if name not in PER_CELL)
Number = float | int | None


class FeedingCase(NamedTuple):
    """Feeding of a line.

    Attributes:
        zones: Feeding zones.
        network: DC network that feeds them, whose timetable is found for the zones first; None: the zones.
    """

    zones: int
    network: str | None = None


class LineCase(NamedTuple):
    """One row: the cell of the matrix.

    Attributes:
        row: Number of the row.
        service: Headway, s, or day.
        line: Line.
        trainset: Trainset.
        load: Load aboard.
        feeding: Feeding.
        options: Fields of the operation.
    """

    row: int
    service: int | str
    line: str
    trainset: str
    load: str
    feeding: FeedingCase
    options: Mapping[str, Number]


IDENTITY = {
    "cell": "BIGINT",
    **dict.fromkeys(("service", "day", "line", "trainset", "load", "network", "driver"), "VARCHAR"),
    **{
        name: "INTEGER" if field_type(OperationOptions, name) is int else "DOUBLE"
        for name in field_specs(OperationOptions)
    },
    **dict.fromkeys(("optimised", "sharp"), "BOOLEAN"),
    "seed": "BIGINT",
}
ENERGIES = (
    *("cruise_kwh", "driving_only_kwh", "timetable_only_kwh", "energy_kwh", "floor_kwh"),
    *("all_received_floor_kwh", "gap_percent", "returned_kwh", "received_kwh", "unreceived_kwh"),
    *("technical_headway_s", "peak_minute_w"),
)
DRIVEN = ("plain_kwh", "energy_kwh", "mean_late_s", "scatter_s")
NETWORK = (
    *("cruise_kwh", "driving_only_kwh", "timetable_only_kwh", "energy_kwh", "zones_timetable_kwh"),
    *("rail_loss_kwh", "substation_loss_kwh", "squeezed_kwh", "lowest_v", "peak_w"),
)
RESULTS: Mapping[str, str] = {
    **IDENTITY,
    "outcome": "VARCHAR",
    **dict.fromkeys(("fleet", "journeys"), "INTEGER"),
    **dict.fromkeys(ENERGIES, "DOUBLE"),
    **{f"driver_{name}": "DOUBLE" for name in DRIVEN},
    "scattered": "STRUCT(seconds DOUBLE, energy_kwh DOUBLE, deviation_kwh DOUBLE)[]",
    **{f"network_{name}": "DOUBLE" for name in NETWORK},
    "error": "VARCHAR",
}
TIMINGS: Mapping[str, str] = {
    "cell": "BIGINT",
    "service": "VARCHAR",
    **dict.fromkeys(("processor_s", "wall_s", "worker_mb"), "DOUBLE"),
}


@dataclass(frozen=True)
class LineSweep(AbstractCampaign):
    """A matrix of lines in operation. Headways and days may be added to a folder.

    Attributes:
        name: Of the campaign.
        services: Headways, s, and days.
        lines: Lines.
        trainsets: Trainset and load of each.
        feedings: Feedings.
        options: Fields of the operation, by name; those not given have their defaults.
        optimise: Search dwells and running times too, not only the offset of the directions.
        sharp: Sharpen the floor, where each section is a zone.
        seed: Seed of the search, and of a driver's first run.
        driver: Driver who drives every trip besides; None: nobody.
        runs: Runs of every trip by that driver.
        scatter_s: Seconds by which departures scatter, each reported.
    """

    kind: ClassVar[str] = LINE
    group_column: ClassVar[str] = "service"
    most_rows: ClassVar[int] = 100_000
    name: str
    services: tuple[int | str, ...]
    lines: tuple[str, ...]
    trainsets: tuple[tuple[str, str], ...]
    feedings: tuple[FeedingCase, ...] = (FeedingCase(ZONES),)
    options: tuple[Mapping[str, Number], ...] = ({},)
    optimise: bool = False
    sharp: bool = False
    seed: int = 0
    driver: str | None = None
    runs: int = 1
    scatter_s: tuple[float, ...] = ()

    @property
    def groups(self) -> tuple[str, ...]:
        """Headways and days."""
        return tuple(name_service(each) for each in self.services)

    @property
    def axes(self) -> tuple[Sequence[Any], ...]:
        """Axes of a group; the last varies fastest."""
        return self.lines, self.trainsets, self.options, self.feedings

    @property
    def cells(self) -> int:
        """Number of rows of one headway or day."""
        return prod(len(each) for each in self.axes)

    def shard_rows(self, group: str) -> int:  # noqa: ARG002 (as of any campaign)
        """One: a row takes seconds to minutes."""
        return 1

    def case(self, row: int) -> LineCase:
        """The cell of a row."""
        group, cell = divmod(row, self.cells)
        indices = []
        for axis in reversed(self.axes):
            cell, index = divmod(cell, len(axis))
            indices.append(axis[index])
        feeding, options, (trainset, load), line = indices
        return LineCase(row, self.services[group], line, trainset, load, feeding, options)

    @property
    def text(self) -> str:
        """The whole campaign as JSON, keys sorted."""
        return json.dumps({"kind": LINE, **asdict(self)}, sort_keys=True)

    @property
    def identity(self) -> str:
        """The text without headways and days, and with the content of files instead of their paths."""
        lines = tuple(map(content_key, self.lines))
        trainsets = tuple((content_key(name), load) for name, load in self.trainsets)
        feedings = tuple(
            each if each.network is None else each._replace(network=content_key(each.network))
            for each in self.feedings
        )
        return replace(self, services=(), lines=lines, trainsets=trainsets, feedings=feedings).text

    @property
    def group_files(self) -> Mapping[str, str]:
        """Days that are files."""
        found = {each: content_key(each) for each in self.services if isinstance(each, str)}
        return {name: content for name, content in found.items() if content != name}

    @property
    def columns(self) -> Mapping[str, str]:
        """Columns of the results."""
        return RESULTS

    @property
    def timing_columns(self) -> Mapping[str, str]:
        """Columns of measured times."""
        return TIMINGS

    @property
    def matrix_words(self) -> str:
        """Axes with their sizes."""
        names = "headways and days", "lines", "trainsets and loads", "options", "feedings"
        sizes = (len(self.services), *(len(each) for each in self.axes))
        return count_axes(list(zip(names, sizes, strict=True)))

    def compute_rows(self, rows: range) -> list[CellRow]:
        """Results and timings of the rows of a shard."""
        return [compute_case(self, row) for row in rows]

    def statistics(self, database: DuckDBPyConnection | None) -> dict[str, Any]:
        """``lines``: the results, row by row."""
        from metropilot.campaign.report import query_rows

        names = ", ".join(RESULTS)
        found = [] if database is None else query_rows(database, f"SELECT {names} FROM runs ORDER BY row")
        return {"lines": found}

    def succeeds(self, summary: Mapping[str, Any]) -> bool:
        """True if every row was computed."""
        return all(row["outcome"] == COMPUTED for row in summary["lines"])

    def report_parts(self, folder: Path, summary: Mapping[str, Any]) -> list[str]:  # noqa: ARG002 (as of any)
        """Energies row by row, and what driving and timetable save."""
        from metropilot.campaign.line_page import report_lines

        return report_lines(self, summary["lines"])

    def page_parts(self, folder: Path, summary: Mapping[str, Any], written: str) -> list[str]:  # noqa: ARG002
        """Energies row by row."""
        from metropilot.campaign.line_page import page_of_lines

        return page_of_lines(self, summary["lines"], written)


def name_service(service: int | str) -> str:
    """Name of a headway or a day in the results."""
    return f"{service} s" if isinstance(service, int) else service


class _Prepared(NamedTuple):
    """Plans, bounds and runs that the rows of a line share, whatever their headway and zones."""

    operation: LineOperation
    plans: Mapping[str, Sequence[Profiles]]
    floors: TripFloors
    drives: TripDrives | None


@lru_cache(maxsize=4)
def _prepare(
    line: str,
    trainset: str,
    load: str,
    options: OperationOptions,
    driver: tuple[str, int, int] | None,
    windows: bool,
) -> _Prepared:
    operation = LineOperation(load_line(line), load_trainset(trainset, load), options)
    drives = None
    if driver is not None:
        name, seed, runs = driver
        drives = TripDrives(operation, name, range(seed, seed + runs))
    return _Prepared(operation, plan_trips(operation, windows=windows), TripFloors(operation), drives)


def compute_case(sweep: LineSweep, row: int) -> CellRow:
    """Result and timing of one row."""
    began, spent = perf_counter(), process_time()
    case, cell = sweep.case(row), row % sweep.cells
    given = {name: value for name, value in case.options.items() if value is not None}
    service = name_service(case.service)
    headway = {"headway_s": case.service} if isinstance(case.service, int) else {}
    result: dict[str, Any] = {
        "cell": cell,
        "service": service,
        "day": None if headway else case.service,
        "line": case.line,
        "trainset": case.trainset,
        "load": case.load,
        "network": case.feeding.network,
        "driver": sweep.driver,
        "optimised": sweep.optimise,
        "sharp": sweep.sharp,
        "seed": sweep.seed,
    }
    with capture_errors(result):
        options = OperationOptions(**given, **headway, zones=case.feeding.zones)
        result |= asdict(options) | ({} if headway else {"headway_s": None, "dwell_s": None})
        result |= _compute(sweep, case, options) | {"outcome": COMPUTED}
    timing = {"cell": cell, "service": service, "worker_mb": peak_memory_mb()}
    return result, timing | {"wall_s": perf_counter() - began, "processor_s": process_time() - spent}


def _compute(sweep: LineSweep, case: LineCase, options: OperationOptions) -> dict[str, Any]:
    driver = None if sweep.driver is None else (sweep.driver, sweep.seed, sweep.runs)
    shared = replace(options, headway_s=OperationOptions().headway_s, zones=1)
    made = _prepare(case.line, case.trainset, case.load, shared, driver, sweep.optimise)
    operation = made.operation.with_zones(options.zones).with_headway(options.headway_s)
    network = None if case.feeding.network is None else load_feeding(case.feeding.network)
    more: dict[str, Any] = {
        "searched": sweep.optimise,
        "seed": sweep.seed,
        "plans": made.plans,
        "scatter": ServiceScatter(made.drives, sweep.scatter_s, sweep.seed),
    }
    found: OperationEnergy | DayEnergy
    if isinstance(case.service, str):
        found = day_energy(operation, load_day(case.service), **more)
        fed = None if network is None else feed_day(found.day, network, found.links)
        counts = {"journeys": found.day.timetable.journeys}
    else:
        found = operation_energy(operation, floors=made.floors, feeding=network, sharp=sweep.sharp, **more)
        fed = None if network is None else feed_line(operation, found.timetable, found.profiles, network)
        counts = {}
    told = found.as_dict(fed)
    driven, of_network = told["driver"] or {}, told["feeding"].get("network", {})
    return {
        **counts,
        "fleet": told["fleet"],
        **{name: told.get(name) for name in ENERGIES},
        **{f"driver_{name}": driven.get(name) for name in DRIVEN},
        "scattered": told["scattered"],
        **{f"network_{name}": of_network.get(name) for name in NETWORK},
    }
