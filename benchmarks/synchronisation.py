"""Worth of synchronisation: driving alone, timetable alone, both; with a driver and departures that scatter.

Reads a folder of the shipped campaign, which can be stopped and goes on:

metropilot campaign synchronisation --out FOLDER
python -m benchmarks.synchronisation --campaign FOLDER --write docs/line.md
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, write_section
from metropilot.campaign import LineSweep, campaign_of_folder, saved_figure, summarise, table_of_lines
from metropilot.errors import InputError
from metropilot.evaluate import house_style

ABOUT = """\
`yizhuang`, `dkz32` AW2, planned running times, dwells of 30 s, efficiencies 0.9 and 0.76, transfer loss
10 %; kWh a round trip. Plain: even dwells, mean over the offset between the directions. Found: dwells, offset
and plans, searched for cruise and brake by itself, for optimal driving and for `{driver}` with optimal
driving; with the network from the timetable of four zones on, that of cruise and brake for the zones alone.
`{driver}` is driven {runs} times a trip under protection, and each trip of each train draws one of these
runs; it is a surrogate of a human driver, not a measured one. ± s: every departure moves by up to so many
seconds, evenly drawn, and dwells take it up: mean and standard deviation of 4 hours."""


def describe(folder: Path, command: str) -> str:
    """Part of the page.

    Args:
        folder: Folder of the campaign.
        command: Command that writes it.

    Raises:
        InputError: Not the folder of a finished campaign of lines.
    """
    sweep, summary = campaign_of_folder(folder), summarise(folder)
    if not isinstance(sweep, LineSweep) or summary["done"] < summary["rows"]:
        raise InputError("not a finished campaign of lines", file=folder, field="campaign")
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    written = (
        f"`metropilot campaign {sweep.name} --out FOLDER`, {summary['cost']['processor_s']:.0f} s of "
        f"processor time, and `{command}`; {about}."
    )
    heads, cells = table_of_lines(sweep, summary["lines"])
    picture = "![Saved by driving, by the timetable and by both, by headway.](images/synchronisation.png)"
    parts = [
        ABOUT.format(driver=sweep.driver, runs=sweep.runs),
        table(tuple(heads), cells),
    ]
    return "\n\n".join(["## Worth of synchronisation", *parts, picture, written])


def main() -> None:
    """Print the part of the page or write it, with its picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaign", type=Path, metavar="FOLDER", required=True)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    given = parser.parse_args()
    command = "python -m benchmarks.synchronisation --campaign FOLDER --write docs/line.md"
    write_section(given.write, "synchronisation", describe(given.campaign, command))
    sweep = campaign_of_folder(given.campaign)
    if given.write is not None and isinstance(sweep, LineSweep):
        with house_style():
            figure = saved_figure(sweep, summarise(given.campaign)["lines"])
            figure.savefig(given.write.parent / "images" / "synchronisation.png", dpi=110)


if __name__ == "__main__":
    main()
