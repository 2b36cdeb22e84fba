"""Tables and picture of a campaign of lines in operation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from metropilot.campaign.line_sweep import COMPUTED, OPTIONS, LineSweep
from metropilot.campaign.report import DASH, inline_svg, markdown_table, number
from metropilot.operation import saved_percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = Mapping[str, Any]
SCATTERED = "energy_kwh", "deviation_kwh"
DRIVINGS = "cruise_kwh", "driving_only_kwh", "timetable_only_kwh", "energy_kwh"
ABOUT = """\
Energies in kWh: of a headway those of one train in a round trip, of a day those of all journeys; those of a
DC network where one feeds the line, else those of the zones. Plain: planned running times and even dwells,
mean over the offset between the directions. Found: the timetable found for cruise and brake, or for optimal
driving. The floor is that of the zones; of a network there is none."""


def read_energies(row: Row) -> dict[str, float | None]:
    """Energies by driving and timetable, of the network where there is one."""
    return {name: row[name if row["network"] is None else f"network_{name}"] for name in DRIVINGS}


def name_feeding(row: Row) -> str:
    """Feeding of a row in words."""
    zones = f"{row['zones']} zones" if row["zones"] != 1 else "1 zone"
    return zones if row["network"] is None else f"DC network {row['network'].rpartition('/')[2]}"


def table_of_lines(sweep: LineSweep, rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Heads and cells of a table, a row each; axes with one value are left out."""
    named = _names(rows)
    heads = [*named, "cruise, plain", "optimal, plain", "cruise, found", "optimal, found", "floor"]
    heads += ["driving alone saves %", "timetable alone %", "both %", "gap %"]
    if sweep.driver is not None:
        heads += [f"{sweep.driver}, plain", f"{sweep.driver}, found", f"timetable, {sweep.driver} %"]
    heads += [f"optimal, found, ±{seconds:g} s" for seconds in sweep.scatter_s]
    cells = []
    for row in rows:
        name = [words(row) for words in named.values()]
        values = _values(sweep, row) if row["outcome"] == COMPUTED else [str(row["error"])]
        cells.append([*name, *values, *[""] * (len(heads) - len(name) - len(values))])
    return heads, cells


def _names(rows: Sequence[Row]) -> dict[str, Callable[[Row], str]]:
    shown: dict[str, Callable[[Row], str]] = {"headway or day": lambda row: row["service"].rpartition("/")[2]}
    for name in ("line", "trainset", "load", *OPTIONS):
        if len({row[name] for row in rows}) > 1:
            shown[name] = lambda row, name=name: _name(row[name])
    return shown | {"feeding": name_feeding}


def _name(value: str | float | None) -> str:
    if value is None:
        return DASH
    return value.rpartition("/")[2] if isinstance(value, str) else f"{value:g}"


def _values(sweep: LineSweep, row: Row) -> list[str]:
    energies, own = read_energies(row), row["network"] is None
    cruise, *others = energies.values()
    floor, gap = (row[name] if own else None for name in ("floor_kwh", "gap_percent"))
    values = [number(each, 1) for each in (*energies.values(), floor)]
    values += [*(number(saved_percent(each, cruise), 1) for each in others), number(gap, 2)]
    if sweep.driver is not None:
        plain, found = row["driver_plain_kwh"], row["driver_energy_kwh"]
        values += [number(plain, 1), number(found, 1), number(saved_percent(found, plain), 1)]
    scattered = row["scattered"] or ()
    return [*values, *(" ± ".join(number(each[name], 1) for name in SCATTERED) for each in scattered)]


def report_lines(sweep: LineSweep, rows: Sequence[Row]) -> list[str]:
    """Parts of the report: the table, and what driving and timetable save."""
    heads, cells = table_of_lines(sweep, rows)
    head = "".join(f"<th class='text'>{escape(each)}</th>" for each in heads)
    lines = ["".join(f"<td>{escape(each)}</td>" for each in row) for row in cells]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    parts = [f"<p>{escape(ABOUT)}</p>", f"<div class='wide'><table><tr>{head}</tr>{body}</table></div>"]
    computed = any(row["outcome"] == COMPUTED for row in rows)
    return [*parts, inline_svg(lambda: saved_figure(sweep, rows))] if computed else parts


def page_of_lines(sweep: LineSweep, rows: Sequence[Row], written: str) -> list[str]:
    """Lines of the page, after its title."""
    heads, cells = table_of_lines(sweep, rows)
    words = f"{sweep.matrix_words[:1].upper()}{sweep.matrix_words[1:]}."
    return [words, "", written, "", ABOUT, "", *markdown_table(heads, cells)]


def saved_figure(sweep: LineSweep, rows: Sequence[Row]) -> Figure:
    """Picture of the savings of driving, of the timetable and of both, row by row.

    To be drawn within the house style.
    """
    import numpy as np

    from metropilot.evaluate import SERIES_STYLES, add_headline, new_panels

    rows = [row for row in rows if row["outcome"] == COMPUTED]
    series: dict[str, list[float | None]] = {"driving": [], "timetable": [], "both": []}
    for row in rows:
        cruise, *others = read_energies(row).values()
        for name, each in zip(("driving", "timetable", "both"), others, strict=True):
            series[name].append(saved_percent(each, cruise))
    for k, seconds in enumerate(sweep.scatter_s):
        series[f"both, ±{seconds:g} s"] = [
            saved_percent(row["scattered"][k]["energy_kwh"], read_energies(row)["cruise_kwh"]) for row in rows
        ]
    if sweep.driver is not None:
        series[f"timetable, {sweep.driver}"] = [
            saved_percent(row["driver_energy_kwh"], row["driver_plain_kwh"]) for row in rows
        ]
    figure, (axes,) = new_panels(max(6.4, 1.2 + 0.75 * len(rows)), 4.4, (1.0,))
    width = 0.8 / len(series)
    for k, (name, shares) in enumerate(series.items()):
        colour, _ = SERIES_STYLES[k % len(SERIES_STYLES)]
        at = np.arange(len(rows)) + width * (k - 0.5 * (len(series) - 1))
        heights = [float("nan") if each is None else each for each in shares]
        axes.bar(at, heights, width=0.95 * width, color=colour, label=name)
    names = [f"{name_feeding(row)}\n{row['service'].rpartition('/')[2]}" for row in rows]
    axes.set_xticks(np.arange(len(rows)), [name.replace("DC network ", "DC ") for name in names])
    axes.set_ylabel("saved, %")
    below = "against cruise and brake with even dwells, mean offset"
    below += "" if sweep.driver is None else f"; {sweep.driver} against itself"
    add_headline(axes, "Worth of driving and of the timetable", below)
    return figure
