"""Worth of synchronisation: driving, timetable, both; a driver and departures that scatter; on a network too.

Reads a folder of the shipped campaign, which can be stopped and goes on:

metropilot campaign synchronisation --out FOLDER
python -m benchmarks.synchronisation --campaign FOLDER --write docs/line.md
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from benchmarks.beside_optimum import table
from benchmarks.line import Row, cite_commands, compute_saving, read_rows
from benchmarks.report import write_section
from metropilot.campaign import LineSweep, saved_figure, table_of_lines
from metropilot.evaluate import house_style
from metropilot.operation import SEARCH_NEIGHBOURS, SEARCH_ROUNDS

NETWORK_COLUMNS = (
    "headway s",
    "cruise and brake kWh",
    "driving only kWh",
    "timetable only kWh",
    "both, best for 4 zones kWh",
    "both, sought on the network kWh",
    "saved by both %",
    "of it by seeking on the network %",
    "lowest V",
    "peak MW",
)
ABOUT = """\
`yizhuang`, `dkz32` AW2, planned running times, dwells of 30 s, efficiencies 0.9 and 0.76, transfer loss
10 %; kWh a round trip. Plain: even dwells, mean over the offset between the directions. Found: dwells, offset
and plans, searched for cruise and brake by itself, for optimal driving and for `{driver}` with optimal
driving; with the network from the timetable of four zones on, that of cruise and brake for the zones alone.
`{driver}` is driven {runs} times a trip under protection, and each trip of each train draws one of these
runs; it is a surrogate of a human driver, not a measured one. ± s: every departure moves by up to so many
seconds, evenly drawn, and dwells take it up: mean and standard deviation of 4 hours."""


def describe(sweep: LineSweep, rows: Sequence[Row], written: str) -> str:
    """Part of the page on driving and timetable."""
    heads, cells = table_of_lines(sweep, rows)
    picture = "![Saved by driving, by the timetable and by both, by headway.](images/synchronisation.png)"
    about = ABOUT.format(driver=sweep.driver, runs=sweep.runs)
    return "\n\n".join(["## Worth of synchronisation", about, table(tuple(heads), cells), picture, written])


def describe_network(rows: Sequence[Row], written: str) -> str:
    """Part of the page on timetables sought on the network."""
    cells = []
    for row in sorted(rows, key=lambda row: row["headway_s"]):
        names = ("cruise_kwh", "driving_only_kwh", "timetable_only_kwh", "zones_timetable_kwh", "energy_kwh")
        cruise, _, _, zones, best = energies = [row[f"network_{name}"] for name in names]
        cells.append(
            [
                f"{row['headway_s']}",
                *(f"{each:.1f}" for each in energies),
                f"{compute_saving(row, 'energy_kwh', 'network_'):.1f}",
                f"{100.0 * (zones - best) / cruise:.1f}",
                f"{row['network_lowest_v']:.0f}",
                f"{row['network_peak_w'] / 1e6:.1f}",
            ]
        )
    seed, network = rows[0]["seed"], rows[0]["network"]
    text = (
        f"Energy that `{network}` takes, planned running times, dwells that move by "
        f"{rows[0]['dwell_window_s']} s. Cruise and brake and driving only are means over 4 offsets between "
        "the directions; timetable only is the one found for 4 zones; sought on the network: "
        f"seed {seed}, {SEARCH_ROUNDS} rounds of {SEARCH_NEIGHBOURS} timetables."
    )
    return "\n".join([text, "", table(NETWORK_COLUMNS, cells), "", written])


def main() -> None:
    """Print both parts of the page or write them, with the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaign", type=Path, metavar="FOLDER", required=True)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    given = parser.parse_args()
    sweep, rows, spent_s = read_rows(given.campaign)
    written = cite_commands(sweep.name, spent_s, "benchmarks.synchronisation")
    write_section(given.write, "synchronisation", describe(sweep, rows, written))
    fed = [row for row in rows if row["network"] is not None]
    write_section(given.write, "network-search", describe_network(fed, written))
    if given.write is not None:
        with house_style():
            figure = saved_figure(sweep, rows)
            figure.savefig(given.write.parent / "images" / "synchronisation.png", dpi=110)


if __name__ == "__main__":
    main()
