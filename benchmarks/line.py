"""Energy of a line beside its floor by headway and feeding zones.

Reads folders of two campaigns, which can be stopped and go on:

metropilot campaign benchmarks/line.toml --out FOLDER
metropilot campaign benchmarks/line-sharp.toml --out SHARP
python -m benchmarks.line --campaign FOLDER SHARP --write docs/line.md
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, write_section
from metropilot.campaign import LineSweep, campaign_of_folder, summarise
from metropilot.errors import InputError
from metropilot.operation import (
    LineOperation,
    OperationOptions,
    find_timetable,
    zone_floor_j,
)
from metropilot.railway import load_line, load_trainset
from metropilot.units import J_PER_KWH

SEARCH = inspect.signature(find_timetable).parameters
PROGRAMMES = inspect.signature(zone_floor_j).parameters["programmes"].default
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
Row = Mapping[str, Any]


def read_rows(folder: Path) -> tuple[LineSweep, list[Row], float]:
    """Campaign of a folder, its rows and its processor time.

    Raises:
        InputError: Not the folder of a finished campaign of lines.
    """
    sweep, summary = campaign_of_folder(folder), summarise(folder)
    if not isinstance(sweep, LineSweep) or summary["done"] < summary["rows"]:
        raise InputError("not a finished campaign of lines", file=folder, field="campaign")
    return sweep, summary["lines"], summary["cost"]["processor_s"]


def compute_saving(row: Row, name: str, of: str = "") -> float:
    """Share of cruise and brake saved, percent."""
    return 100.0 * (1.0 - row[f"{of}{name}"] / row[f"{of}cruise_kwh"])


def cite_commands(campaign: str, spent_s: float, module: str) -> str:
    """Commands that make a part of the page from a campaign of lines, and where they ran."""
    return cite_all({campaign: spent_s}, module)


def cite_all(spent_s: Mapping[str, float], module: str) -> str:
    """The same from several campaigns, with the processor time of each."""
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    folders = [f"FOLDER{k or ''}" for k in range(len(spent_s))]
    campaigns = ", ".join(
        f"`metropilot campaign {campaign} --out {folder}`, {spent:.0f} s of processor time"
        for folder, (campaign, spent) in zip(folders, spent_s.items(), strict=True)
    )
    return (
        f"{campaigns}, and `python -m {module} --campaign {' '.join(folders)} --write docs/line.md`; {about}."
    )


def planned_floor_kwh(row: Row) -> float:
    """Floor with all received at planned running times."""
    names = ("efficiency_traction", "efficiency_braking", "transfer_loss")
    options = OperationOptions(time_window_s=0, **{name: row[name] for name in names})
    operation = LineOperation(load_line(row["line"]), load_trainset(row["trainset"], row["load"]), options)
    return operation.floor_j(operation.profiles()) / J_PER_KWH


def describe(rows: Sequence[Row], planned_kwh: float, written: str) -> str:
    """Part of the page."""
    first = rows[0]
    sharp = sorted({f"{row['zones']}" for row in rows if row["sharp"]})
    names = ("cruise_kwh", "driving_only_kwh", "timetable_only_kwh", "energy_kwh")
    cells = [
        [
            f"{row['zones']}",
            f"{row['headway_s']}",
            *(f"{row[name]:.1f}" for name in (*names, "all_received_floor_kwh", "floor_kwh")),
            *(f"{compute_saving(row, name):.1f}" for name in names[1:]),
            f"{row['gap_percent']:.2f}",
        ]
        for row in sorted(rows, key=lambda row: (row["zones"], row["headway_s"]))
    ]
    return "\n".join(
        [
            "## Energy beside the floor",
            "",
            f"`{first['line']}`, `{first['trainset']}` {first['load']}, dwells of {first['dwell_s']} s,",
            f"efficiencies {first['efficiency_traction']} and {first['efficiency_braking']}, transfer loss",
            f"{100 * first['transfer_loss']:.0f} %,",
            f"auxiliaries 120 kW. Running times move by {first['time_window_s']} s and dwells by",
            f"{first['dwell_window_s']} s either way, in whole seconds at the same sums in each direction;",
            f"at planned times the floor with all received is {planned_kwh:.1f} kWh. Cruise and brake",
            "and driving only are means over 60 offsets between the directions. Searches:",
            f"seed {first['seed']}, {SEARCH['restarts'].default} starts of {SEARCH['moves'].default} moves.",
            f"The floor with {', '.join(sharp)} zones is the sharp one, of at most {PROGRAMMES} programmes.",
            "",
            table(COLUMNS, cells),
            "",
            written,
        ]
    )


def main() -> None:
    """Print the part of the page or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaign", type=Path, metavar="FOLDER", nargs=2, required=True)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    given = parser.parse_args()
    rows, spent_s = list[Row](), dict[str, float]()
    for folder in given.campaign:
        sweep, found, spent = read_rows(folder)
        rows += found
        spent_s[f"benchmarks/{sweep.name}.toml"] = spent
    written = cite_all(spent_s, "benchmarks.line")
    write_section(given.write, "line", describe(rows, planned_floor_kwh(rows[0]), written))


if __name__ == "__main__":
    main()
