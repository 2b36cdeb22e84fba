"""Energy of a line at several headways beside its floor: the table of the page on lines.

python -m benchmarks.line --write docs/line.md
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, replace_section
from metropilot.operation import LineOperation, OperationOptions, find_timetable, operation_energy
from metropilot.railway import load_line, load_trainset
from metropilot.units import J_PER_KWH

LINE, TRAINSET, LOAD = "yizhuang", "dkz32", "AW2"
HEADWAYS_S, ZONES = (90, 120, 180, 300, 600), (4, 13)
OPTIONS = OperationOptions(efficiency_traction=0.9, efficiency_braking=0.76)
SEED = 0
SEARCH = find_timetable.__kwdefaults__
COLUMNS = (
    "zones",
    "headway s",
    "cruise and brake kWh",
    "driving only kWh",
    "timetable only kWh",
    "both kWh",
    "floor kWh",
    "saved by driving %",
    "by timetable %",
    "by both %",
    "gap %",
)


def measure() -> tuple[list[list[str]], float, float]:
    """Rows of the table, the floor at planned running times in kWh, and the time of the searches."""
    line, trainset = load_line(LINE), load_trainset(TRAINSET, LOAD)
    operation = LineOperation(line, trainset, OPTIONS)
    plans = {driving: operation.profiles(driving, windows=True) for driving in ("optimal", "cruise")}
    planned = [
        {trip.planned_s: of[trip.planned_s]}
        for trip, of in zip(operation.trips, plans["optimal"], strict=True)
    ]
    rows, began = [], time.perf_counter()
    for zones in ZONES:
        for headway_s in HEADWAYS_S:
            at = LineOperation(line, trainset, replace(OPTIONS, zones=zones, headway_s=headway_s))
            found = operation_energy(at, searched=True, seed=SEED, plans=plans)
            cruise = found.cruise_kwh
            energies = found.driving_only_kwh, found.timetable_only_kwh, found.energy_kwh
            saved = [f"{100.0 * (1.0 - each / cruise):.1f}" for each in energies]
            kwh = [f"{each:.1f}" for each in (cruise, *energies, found.floor_kwh)]
            rows.append([f"{zones}", f"{headway_s}", *kwh, *saved, f"{found.gap_percent:.2f}"])
    return rows, operation.floor_j(planned) / J_PER_KWH, time.perf_counter() - began


def main() -> None:
    """Compute everything; print the part of the page or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    page = parser.parse_args().write
    rows, planned, lasted = measure()
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    text = "\n".join(
        [
            "## Energy beside the floor",
            "",
            f"`{LINE}`, `{TRAINSET}` {LOAD}, dwells of 30 s, efficiencies 0.9 and 0.76, transfer loss 10 %,",
            f"auxiliaries 120 kW. Running times move by {OPTIONS.time_window_s} s and dwells by",
            f"{OPTIONS.dwell_window_s} s either way, in whole seconds at the same sums in each direction;",
            f"at planned running times the floor is {planned:.1f} kWh. Cruise and brake and driving only are",
            f"means over 60 offsets between the directions. Searches: seed {SEED},",
            f"{SEARCH['restarts']} starts of {SEARCH['moves']} moves;",
            f"the {2 * len(rows)} of them, with those means, took {lasted:.0f} s.",
            "",
            table(COLUMNS, rows),
            "",
            f"`python -m benchmarks.line --write docs/line.md`; {about}.",
        ]
    )
    if page is None:
        print(text)
    else:
        page.write_text(replace_section(page.read_text(), "line", text))


if __name__ == "__main__":
    main()
