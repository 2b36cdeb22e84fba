"""Energy of a line at several headways beside its floor: the table of the page on lines.

python -m benchmarks.line --write docs/line.md
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, write_section
from metropilot.operation import (
    LineOperation,
    OperationOptions,
    Profiles,
    TripFloors,
    find_timetable,
    operation_energy,
    plan_trips,
)
from metropilot.railway import load_line, load_trainset
from metropilot.units import J_PER_KWH

LINE, TRAINSET, LOAD = "yizhuang", "dkz32", "AW2"
HEADWAYS_S, ZONES = (90, 120, 180, 300, 600), (4, 13)
OPTIONS = OperationOptions(efficiency_traction=0.9, efficiency_braking=0.76)
SEED = 0
SEARCH = inspect.signature(find_timetable).parameters
COLUMNS = (
    "zones",
    "headway s",
    "cruise and brake kWh",
    "driving only kWh",
    "timetable only kWh",
    "both kWh",
    "floor, all received kWh",
    "floor kWh",
    "saved by driving %",
    "by timetable %",
    "by both %",
    "gap %",
)


def measure() -> tuple[list[list[str]], float]:
    """Rows of the table, and the floor with all received at planned running times, kWh."""
    operation = LineOperation(load_line(LINE), load_trainset(TRAINSET, LOAD), OPTIONS)
    plans, floors = plan_trips(operation, windows=True), TripFloors(operation)
    rows = [measure_row(zones, headway_s, plans, floors) for zones, headway_s in product(ZONES, HEADWAYS_S)]
    return rows, planned_floor_kwh(operation, plans)


def planned_floor_kwh(operation: LineOperation, plans: Mapping[str, Sequence[Profiles]]) -> float:
    """Floor with all received at planned running times."""
    trips = zip(operation.trips, plans["optimal"][0], strict=True)
    return operation.floor_j([{trip.planned_s: of[trip.planned_s]} for trip, of in trips]) / J_PER_KWH


def measure_row(
    zones: int, headway_s: int, plans: Mapping[str, Sequence[Profiles]], floors: TripFloors
) -> list[str]:
    """Row of the table."""
    options = replace(OPTIONS, zones=zones, headway_s=headway_s)
    operation = LineOperation(load_line(LINE), load_trainset(TRAINSET, LOAD), options)
    found = operation_energy(operation, searched=True, seed=SEED, plans=plans, floors=floors)
    energies = found.driving_only_kwh, found.timetable_only_kwh, found.energy_kwh
    saved = [f"{100.0 * (1.0 - each / found.cruise_kwh):.1f}" for each in energies]
    columns = (found.cruise_kwh, *energies, found.all_received_floor_kwh, found.floor_kwh)
    kwh = [f"{each:.1f}" for each in columns]
    return [f"{zones}", f"{headway_s}", *kwh, *saved, f"{found.gap_percent:.2f}"]


def describe(rows: list[list[str]], planned_kwh: float) -> str:
    """Part of the page."""
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    return "\n".join(
        [
            "## Energy beside the floor",
            "",
            f"`{LINE}`, `{TRAINSET}` {LOAD}, dwells of 30 s, efficiencies 0.9 and 0.76, transfer loss 10 %,",
            f"auxiliaries 120 kW. Running times move by {OPTIONS.time_window_s} s and dwells by",
            f"{OPTIONS.dwell_window_s} s either way, in whole seconds at the same sums in each direction;",
            f"at planned times the floor with all received is {planned_kwh:.1f} kWh. Cruise and brake",
            f"and driving only are means over 60 offsets between the directions. Searches: seed {SEED},",
            f"{SEARCH['restarts'].default} starts of {SEARCH['moves'].default} moves.",
            "",
            table(COLUMNS, rows),
            "",
            f"`python -m benchmarks.line --write docs/line.md`; {about}.",
        ]
    )


def main() -> None:
    """Compute everything; print the part of the page or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    write_section(parser.parse_args().write, "line", describe(*measure()))


if __name__ == "__main__":
    main()
