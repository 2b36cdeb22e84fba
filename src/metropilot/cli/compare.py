"""`metropilot compare`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot.cli import complete
from metropilot.cli import options as opt
from metropilot.cli.console import console, number, print_json, progress, table
from metropilot.errors import InputError, rename_fields

if TYPE_CHECKING:
    from rich.text import Text

    from metropilot.evaluate import Entry, RunSpec

SHOWN: tuple[tuple[str, str, float, int], ...] = (
    ("time_error_s", "time s", 1.0, 2),
    ("stopping_error_m", "stop cm", 100.0, 1),
    ("energy_wheel_kwh", "wheel kWh", 1.0, 2),
    ("energy_line_kwh", "line kWh", 1.0, 2),
    ("optimality_gap_percent", "optimum %", 1.0, 2),
    ("trainset_gap_percent", "trainset %", 1.0, 2),
    ("driver_gap_percent", "driver %", 1.0, 2),
    ("max_jerk_mps3", "jerk m/s³", 1.0, 2),
    ("comfort_huang2025", "Σ|Δu|", 1.0, 2),
    ("regime_switches", "switches", 1.0, 0),
    ("decision_time_us_median", "µs", 1.0, 0),
)
SPARE = ("µs", "switches", "Σ|Δu|", "line kWh", "trainset %", "stop cm")
"""Columns that may be left out on a narrow screen, in this order."""
UNJUDGED = ("trainset_gap_percent",)
"""Columns in which no driver is better than another."""
MAX_SEEDS = 10_000
EXAMPLES = {
    "compare": (
        "metropilot compare yizhuang RJ WYJ --time 101 --drivers optimal,manual,flat_out --out compare",
        "metropilot compare yizhuang RJ WYJ --drivers optimal,manual --seeds 10 --speed-noise 0.05 --json",
    ),
}


@opt.with_run_options("driver", "options")
def compare_command(
    line: opt.LineArgument,
    origin: opt.OriginArgument,
    destination: opt.DestinationArgument,
    drivers: Annotated[
        str,
        typer.Option(
            help="Driver ids, separated by commas.",
            rich_help_panel=opt.ABOUT,
            autocompletion=complete.drivers,
        ),
    ] = "optimal,manual,flat_out",
    seeds: Annotated[
        int, typer.Option(help="Drives of each driver, each with its own seed.", rich_help_panel=opt.WORLD)
    ] = 1,
    out: opt.Out = None,
    as_json: opt.Json = False,
    **given: Any,  # noqa: ANN401 (the fields of a run)
) -> int:
    """Drive the same run with several drivers.

    The best of those that always met every requirement of a drive is highlighted in each column. With
    --seeds the mean over the seeds is shown with its 95 % bootstrap interval. Exit code 0: compared, whatever
    the result (`successes` in the JSON counts the drives that met every requirement); 2: invalid input.
    """
    from metropilot.evaluate import RunSpec

    names = [name.strip() for name in drivers.split(",") if name.strip()]
    if not names:
        raise InputError("no driver given", field="drivers", value=drivers, allowed="ids separated by commas")
    if not 1 <= seeds <= MAX_SEEDS:
        raise InputError("out of range", field="seeds", value=seeds, allowed=f"1 to {MAX_SEEDS}")
    where = {"line": line, "origin": origin, "destination": destination}
    spec = RunSpec.from_values({**where, "driver": names[0], **given})
    return compare_and_report(spec, names, seeds, out, as_json=as_json)


def compare_and_report(
    request: RunSpec, names: Sequence[str], seeds: int, out: Path | None, *, as_json: bool
) -> int:
    """Drive, print and write; return the exit code."""
    from metropilot._io import check_writable
    from metropilot.evaluate import compare, jobs, make_driver, parse_driver, write_comparison

    for name in names:
        with rename_fields({"driver": "drivers", "set": "drivers"}):
            of_options = {f"set {key}": f"drivers {key}" for key in parse_driver(name)[1]}
        with rename_fields({"driver": "drivers", "set": "drivers", **of_options}):
            make_driver(name)
    if out is not None:
        check_writable(out, "comparison.json")
    entries = compare(request, progress(jobs(names, request.seed, seeds), "driving"))
    if out is not None:
        write_comparison(out, request, entries)
    if as_json:
        from metropilot.evaluate import comparison_json

        print_json(comparison_json(request, entries))
        return 0
    report(request, entries, seeds)
    if out is not None:
        console().print(f"Written to {out}: comparison.json comparison.svg comparison.png run.toml")
    return 0


def report(request: RunSpec, entries: Sequence[Entry], seeds: int) -> None:
    """Print the comparison."""
    from metropilot.evaluate import best

    known = request.resolve()
    where = f"{known.line} {known.origin} → {known.destination}, {known.trainset} {known.load}"
    title = f"{where}, scheduled {known.time_s:g} s" + (f", {seeds} seeds" if seeds > 1 else "")
    winners = {name: None if name in UNJUDGED else best(entries, name) for name, *_ in SHOWN}
    rows = []
    for entry in entries:
        cells = [_cell(entry, name, factor, digits, winners[name]) for name, _, factor, digits in SHOWN]
        rows.append([entry.driver, _outcomes(entry), *cells])
    columns = ["driver", "outcome", *(words for _, words, _, _ in SHOWN)]
    out = console()
    out.print(table(title, columns, rows, right=range(2, len(columns)), spare=SPARE))
    legend = (
        "time and stop: error; optimum: energy above it for the time achieved, of which trainset: by its "
        "jerk limit, dead time and lag under protection, driver: the rest; µs: time of a decision"
    )
    out.print(legend + ("; small: 95 % interval over the seeds" if seeds > 1 else ""), style="dim")
    if any(winners.values()):
        out.print("* best of those that always met every requirement", style="dim")


def _cell(entry: Entry, name: str, factor: float, digits: int, winner: str | None) -> str | Text:
    from rich.text import Text

    found = entry.interval(name)
    if found is None:
        return number(None)
    text = Text(f"{factor * found.mean:.{digits}f}")
    if winner == entry.driver:
        text = Text(f"*{text}", style="bold green")
    if found.high > found.low:
        text.append(
            f"\n{factor * found.low:.{digits}f} … {factor * found.high:.{digits}f}", style="not bold dim"
        )
    return text


def _outcomes(entry: Entry) -> str:
    """Outcomes of the drives: one word, or a count of each."""
    from metropilot.evaluate import outcome_words

    said = [outcome_words(k) for k in entry.kpis]
    if len(said) == 1:
        return said[0]
    return "\n".join(f"{said.count(word)} {word}" for word in dict.fromkeys(said))
