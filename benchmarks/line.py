"""Energy of a line at several headways beside its floor: the table of the page on lines.

python -m benchmarks.line --write docs/line.md
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, replace_section
from metropilot.operation import LineOperation, OperationOptions
from metropilot.railway import load_line, load_trainset
from metropilot.units import J_PER_KWH

LINE, TRAINSET, LOAD = "yizhuang", "dkz32", "AW2"
HEADWAYS_S, ZONES = (90, 120, 180, 300, 600), (4, 13)
OPTIONS = OperationOptions(efficiency_traction=0.9, efficiency_braking=0.76)
PHASES = 60
COLUMNS = (
    "zones",
    "headway s",
    "cruise and brake kWh",
    "optimal driving kWh",
    "saved %",
    "floor kWh",
    "cruise above floor %",
    "driving above floor %",
)


def measure() -> tuple[list[list[str]], tuple[float, float]]:
    """Rows of the table, and the floors at planned and at free running times, kWh."""
    line, trainset = load_line(LINE), load_trainset(TRAINSET, LOAD)
    operation = LineOperation(line, trainset, OPTIONS)
    windows, cruise = operation.profiles(windows=True), operation.profiles("cruise")
    planned_s = [trip.planned_s for trip in operation.trips]
    optimal = [{s: of[s]} for s, of in zip(planned_s, windows, strict=True)]
    floors = operation.floor_j(optimal) / J_PER_KWH, operation.floor_j(windows) / J_PER_KWH
    rows = []
    for zones in ZONES:
        for headway_s in HEADWAYS_S:
            at = LineOperation(line, trainset, replace(OPTIONS, zones=zones, headway_s=headway_s))
            plain, driven = (at.mean_energy_j(each, PHASES) / J_PER_KWH for each in (cruise, optimal))
            above = [100.0 * (energy / floors[0] - 1.0) for energy in (plain, driven)]
            saved = 100.0 * (1.0 - driven / plain)
            cells = [f"{plain:.1f}", f"{driven:.1f}", f"{saved:.1f}", f"{floors[0]:.1f}"]
            rows.append([f"{zones}", f"{headway_s}", *cells, *(f"{share:.2f}" for share in above)])
    return rows, floors


def main() -> None:
    """Compute everything; print the part of the page or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    page = parser.parse_args().write
    rows, (planned, free) = measure()
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    text = "\n".join(
        [
            "## Energy beside the floor",
            "",
            f"`{LINE}`, `{TRAINSET}` {LOAD}, dwells of 30 s, efficiencies 0.9 and 0.76, transfer loss 10 %,",
            f"auxiliaries 120 kW. Floor {planned:.1f} kWh a round trip at planned running times, {free:.1f}",
            "with running times free by 4 s either way in whole seconds at the same sum in each direction.",
            f"Energies are means over {PHASES} offsets between the directions; nothing is drawn at random.",
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
