"""Statistics of a campaign of drives, and the parts of its report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from metropilot._io import check_writable
from metropilot.campaign.declared import Campaign
from metropilot.campaign.matrix import FAILED, INFEASIBLE
from metropilot.campaign.report import DASH, inline_svg, number, open_database, query_rows
from metropilot.campaign.rows import request_of_row
from metropilot.errors import MetropilotError
from metropilot.evaluate import Optimum, kpis_of, optimum_of, write_run, write_run_toml
from metropilot.sim import Drive, drive

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection
    from matplotlib.figure import Figure


CONFIDENCE = 0.95
WORST = 10
DRIVEN = f"outcome <> '{INFEASIBLE}'"
POSSIBLE = f"{DRIVEN} AND coalesce(scheduled_time_s >= minimum_running_time_s, true)"
"""Condition that the true plant can keep the scheduled time with all restrictions known in advance."""
NUMBERS = f"""
    count(*) AS runs,
    count(*) FILTER ({DRIVEN}) AS driven,
    count(*) FILTER (NOT ({POSSIBLE})) AS impossible,
    count(*) FILTER (outcome = '{FAILED}') AS failed,
    count(*) FILTER ({POSSIBLE}) AS possible,
    count(*) FILTER ({POSSIBLE} AND success) AS successes,
    count(*) FILTER ({DRIVEN} AND coalesce(safe, false)) AS safe,
    count(*) FILTER (outcome = 'arrived') AS arrived,
    count(*) FILTER (outcome = 'arrived' AND punctual) AS punctual,
    count(*) FILTER (interventions > 0) AS intervened,
    count(optimality_gap_percent) AS compared,
    median(optimality_gap_percent) AS gap_median,
    quantile_cont(optimality_gap_percent, 0.95) AS gap_95,
    max(optimality_gap_percent) AS gap_worst,
    median(trainset_gap_percent) AS trainset_median,
    median(driver_gap_percent) AS driver_median,
    max(driver_gap_percent) AS driver_worst,
    median(abs(time_error_s)) FILTER (outcome = 'arrived' AND {POSSIBLE}) AS late_median_s,
    max(abs(time_error_s)) FILTER (outcome = 'arrived' AND {POSSIBLE}) AS late_worst_s,
    max(abs(stopping_error_m)) FILTER (outcome = 'arrived') AS stop_worst_m,
    median(comfort_huang2025) FILTER (outcome = 'arrived') AS comfort_median,
    max(max_jerk_mps3) FILTER (outcome = 'arrived') AS jerk_worst_mps3,
    max(max_overspeed_mps) AS overspeed_worst_mps,
    median(decision_us_median) AS decision_us_median,
    max(decision_us_max) AS decision_us_worst,
    median(processor_s) AS processor_s_median
"""
WORST_FIRST = f"""
    SELECT * FROM runs WHERE {DRIVEN} ORDER BY
        (outcome = '{FAILED}') DESC, coalesce(safe, false), success OR NOT ({POSSIBLE}),
        CASE WHEN success OR NOT ({POSSIBLE}) THEN NULL ELSE abs(time_error_s) END DESC NULLS LAST,
        optimality_gap_percent DESC NULLS LAST, row
    LIMIT {WORST}
"""


def drive_statistics(database: DuckDBPyConnection | None) -> dict[str, Any]:
    """Statistics by driver, by driver and disturbance, and the worst runs."""
    if database is None:
        return {"drivers": [], "cells": [], "worst": []}
    return {
        "drivers": group_statistics(database, "driver"),
        "cells": group_statistics(database, "driver", "disturbance"),
        "worst": query_rows(database, WORST_FIRST),
    }


def group_statistics(database: DuckDBPyConnection, *by: str) -> list[dict[str, Any]]:
    """Statistics by group, with 95 % intervals of the shares and of the median gap."""
    keys = ", ".join(by)
    rows = query_rows(database, f"SELECT {keys}, {NUMBERS} FROM runs GROUP BY ALL ORDER BY min(row)")
    for row in rows:
        row["success_low"], row["success_high"] = share_interval(row["successes"], row["possible"])
        row["safe_low"], row["safe_high"] = share_interval(row["safe"], row["driven"])
        low, high = median_ranks(row["compared"])
        where = " AND ".join(f"{key} = ?" for key in by)
        ends = database.execute(
            f"SELECT quantile_disc(optimality_gap_percent, [{low}, {high}]) FROM runs WHERE {where}",
            [row[key] for key in by],
        ).fetchone()
        row["gap_low"], row["gap_high"] = ends[0] if ends and ends[0] else (None, None)
    return rows


def share_interval(hits: int, total: int) -> tuple[float | None, float | None]:
    """95 % interval of a share. Source: Wilson (1927), from SciPy."""
    if total == 0:
        return None, None
    from scipy.stats import binomtest

    found = binomtest(hits, total).proportion_ci(CONFIDENCE, method="wilson")
    return float(found.low), float(found.high)


def median_ranks(count: int) -> tuple[float, float]:
    """Quantiles between which the median lies with 95 % confidence, whatever the distribution.

    The number of values below the median is binomial. Source: Conover, Practical Nonparametric Statistics
    (1999), section 3.2.
    """
    from scipy.stats import binom

    if count == 0:
        return 0.0, 1.0
    # the middles between the ranks: a quotient of whole numbers may be rounded to the next rank
    rank = max(float(binom.ppf(0.5 * (1.0 - CONFIDENCE), count, 0.5)), 1.0)
    return (rank - 0.5) / count, (count + 0.5 - rank) / count


CLOUD = 3000
PARETO = """
    SELECT driver, time,
        median(running_time_s / minimum_running_time_s) AS at,
        median(energy) AS used, median(optimum) AS best,
        quantile_cont(energy / optimum, 0.25) AS low, quantile_cont(energy / optimum, 0.75) AS high,
        median(energy / optimum) AS ratio
    FROM (
        SELECT *, {energy} / (mass_kg / 1e3 * length_m / 1e3) * 1e3 AS energy,
            optimal_energy_kwh / (mass_kg / 1e3 * length_m / 1e3) * 1e3 AS optimum
        FROM runs WHERE outcome = 'arrived' AND optimal_energy_kwh > 0
    ) GROUP BY ALL ORDER BY min(row)
"""
POINTS = """
    SELECT driver, running_time_s / minimum_running_time_s AS at,
        {energy} / (mass_kg / 1e3 * length_m / 1e3) * 1e3 AS used
    FROM runs WHERE outcome = 'arrived' AND minimum_running_time_s > 0 ORDER BY hash(row), row LIMIT {most}
"""


def report_drives(campaign: Campaign, folder: Path, summary: Mapping[str, Any]) -> list[str]:
    """Parts of the report on drives, and a folder ``worst/NN`` for each of the worst runs.

    Raises:
        InputError: The folder cannot be written.
    """
    worst = drive_worst(folder, campaign, summary["worst"])
    parts = ["<h2>Drivers</h2>", LEGEND, _table(summary["drivers"], ("driver",))]
    if len(campaign.disturbances) > 1:
        parts += ["<h2>By disturbance</h2>", _table(summary["cells"], ("disturbance", "driver"))]
    parts += ["<h2>Energy against time</h2>", _pareto(folder, campaign)]
    return [*parts, "<h2>The worst runs</h2>", worst_table(summary["worst"], worst)]


LEGEND = (
    "<p>On time: arrived, safe and within 3 s, out of the runs whose time was possible, with the 95 % "
    "interval. Gap: energy over the certified optimum for the time achieved, median with its "
    "95 % interval, 95th percentile and worst; of it trainset: what jerk limit, dead time and lag cost "
    "at best under the permitted speed, driver: energy over that attainable optimum. Time and stop: "
    "error of the runs that arrived.</p>"
)

COLUMNS = (
    ("runs", "runs", 0),
    ("impossible", "impossible", 0),
    ("failed", "failed", 0),
    ("safe", "safe %", 1),
    ("success", "on time %", 1),
    ("gap", "gap median %", 2),
    ("gap_95", "95 %", 1),
    ("gap_worst", "worst %", 1),
    ("trainset_median", "trainset median %", 2),
    ("driver_median", "driver median %", 2),
    ("driver_worst", "driver worst %", 1),
    ("late_median_s", "time error median s", 2),
    ("late_worst_s", "worst s", 2),
    ("stop_worst_m", "stop worst m", 3),
    ("jerk_worst_mps3", "jerk worst m/s³", 2),
    ("comfort_median", "Σ|Δu| median", 1),
    ("intervened", "runs with interventions", 0),
    ("overspeed_worst_mps", "overspeed m/s", 2),
    ("decision_us_median", "decision median µs", 0),
    ("decision_us_worst", "worst ms", 1),
)


SHARES = {"safe": ("safe", "driven"), "success": ("successes", "possible")}


def _cell(row: Mapping[str, Any], name: str, digits: int) -> str:
    if name in SHARES:
        hits, total = row[SHARES[name][0]], row[SHARES[name][1]]
        if not total:
            return DASH
        return f"{100 * hits / total:.1f}{_ends(100 * row[f'{name}_low'], 100 * row[f'{name}_high'], 1)}"
    if name == "gap" and row["gap_median"] is not None:
        return f"{row['gap_median']:.2f}{_ends(row['gap_low'], row['gap_high'], 2)}"
    value = row.get(name)
    return number(value / 1e3 if value is not None and name == "decision_us_worst" else value, digits)


def _ends(low: float, high: float, digits: int) -> str:
    """An interval in small type under its number."""
    return f"<br><small>{low:.{digits}f}…{high:.{digits}f}</small>"


def _table(rows: Iterable[Mapping[str, Any]], by: Sequence[str]) -> str:
    heads = "".join(f"<th class='text'>{name}</th>" for name in by) + "".join(
        f"<th>{h}</th>" for _, h, _ in COLUMNS
    )
    lines = []
    for row in rows:
        words = "".join(f"<td class='text'>{escape(str(row[name]))}</td>" for name in by)
        lines.append(
            f"<tr>{words}" + "".join(f"<td>{_cell(row, n, d)}</td>" for n, _, d in COLUMNS) + "</tr>"
        )
    return f"<div class='wide'><table><tr>{heads}</tr>{''.join(lines)}</table></div>"


def _pareto(folder: Path, campaign: Campaign) -> str:
    energy = "energy_wheel_kwh" if campaign.objective == "wheel" else "energy_line_kwh"
    with open_database(folder) as database:
        medians = query_rows(database, PARETO.format(energy=energy))
        cloud = query_rows(database, POINTS.format(energy=energy, most=CLOUD))
    if not medians:
        return "<p>No run arrived.</p>"
    said = (
        "<p>Left: each run that arrived (a sample where there are many) and the median of each driver at "
        "each scheduled time, per tonne and kilometre. Right: the same medians over the optimum for the time "
        "achieved, with the quartiles.</p>"
    )
    return said + inline_svg(partial(pareto_figure, medians, cloud))


def pareto_figure(medians: Sequence[Mapping[str, Any]], cloud: Sequence[Mapping[str, Any]]) -> Figure:
    """Energy per tonne-kilometre and energy above the optimum, both over running time by the minimum."""
    from matplotlib.figure import Figure

    from metropilot.evaluate import GREY, SERIES_STYLES

    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    drivers = list(dict.fromkeys(row["driver"] for row in medians))
    for k, driver in enumerate(drivers):
        colour, dashes = SERIES_STYLES[k % len(SERIES_STYLES)]
        marker = "osD^vP*X"[(k // len(SERIES_STYLES) + k) % 8]
        points = [row for row in cloud if row["driver"] == driver]
        left.scatter(
            [p["at"] for p in points], [p["used"] for p in points], s=7, alpha=0.3, color=colour, lw=0
        )
        rows = sorted((row for row in medians if row["driver"] == driver), key=lambda row: row["at"])
        at = [row["at"] for row in rows]
        left.plot(
            at, [row["used"] for row in rows], color=colour, ls=dashes, marker=marker, ms=4, label=driver
        )
        ratio = [100 * (row["ratio"] - 1) for row in rows]
        ends = [
            [max(100 * (row["ratio"] - row["low"]), 0.0) for row in rows],
            [max(100 * (row["high"] - row["ratio"]), 0.0) for row in rows],
        ]
        right.errorbar(
            at, ratio, yerr=ends, color=colour, ls=dashes, marker=marker, ms=4, capsize=2, label=driver
        )
    best = sorted((row["at"], row["best"]) for row in medians)
    left.scatter(*zip(*best, strict=True), s=22, marker="_", color=GREY, label="optimum", zorder=4)
    left.set(xlabel="running time over the minimum", ylabel="energy, Wh per tonne and km")
    right.set(xlabel="running time over the minimum", ylabel="above the optimum, %")
    right.axhline(0.0, color=GREY, lw=0.9)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=6)
    return figure


WORST_FOLDER = "worst"
WORST_WORDS = {"driver": "driver", "from": "origin", "to": "destination"}
WORST_WORDS |= {name: name for name in ("trainset", "load", "actuation", "time", "disturbance", "outcome")}
WORST_NUMBERS = {
    "time error s": "time_error_s",
    "stop m": "stopping_error_m",
    "gap %": "optimality_gap_percent",
}
WIDTH_IN, HEIGHT_IN = 5.6, 2.5


class Again(NamedTuple):
    """One of the worst runs, driven again.

    Attributes:
        folder: Its folder, relative to that of the campaign; empty if the run has no scheduled time.
        picture: Speed over distance as SVG; empty if the driver failed.
    """

    folder: str
    picture: str


def drive_worst(folder: Path, campaign: Campaign, worst: Sequence[Mapping[str, Any]]) -> list[Again]:
    """Drive the worst runs again and write the folder of a run for each: trajectory, KPIs, picture, request.

    Args:
        folder: The campaign's folder.
        campaign: The campaign.
        worst: Their rows, the worst first.

    Raises:
        InputError: The folder cannot be written.
    """
    found = []
    for place, row in enumerate(worst, 1):
        if row["scheduled_time_s"] is None:
            found.append(Again("", ""))
            continue
        request = request_of_row(campaign, row)
        target = folder / WORST_FOLDER / f"{place:02d}"
        check_writable(target)
        picture = ""
        try:
            driven = drive(request.run(), request.make_driver())
            optimum = optimum_of(driven, campaign.objective)
            write_run(target, request, driven, kpis_of(driven, optimum, campaign.objective), optimum)
            picture = inline_svg(partial(speed_figure, driven, optimum))
        except (MetropilotError, ArithmeticError, ValueError, TypeError, LookupError):
            write_run_toml(target, request)
        found.append(Again(f"{WORST_FOLDER}/{place:02d}", picture))
    return found


def speed_figure(driven: Drive, optimum: Optimum | None) -> Figure:
    """Speed over distance with limit, permitted speed, optimum and interventions of protection."""
    from matplotlib.figure import Figure

    from metropilot.evaluate import draw_speed, set_distance

    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    axes = figure.subplots()
    draw_speed(axes, driven, optimum)
    set_distance(axes, driven.section, float(driven.trajectory.position_m[-1]))
    return figure


def worst_table(worst: Sequence[Mapping[str, Any]], again: Sequence[Again]) -> str:
    """HTML table of the worst runs, then a picture of each."""
    if not worst:
        return "<p>None.</p>"
    names = ("", *WORST_WORDS, *WORST_NUMBERS, "drive it again")
    heads = "".join(f"<th class='text'>{name}</th>" for name in names)
    lines, pictures = [], []
    for place, (row, found) in enumerate(zip(worst, again, strict=True), 1):
        words = [str(place), *(str(row[key] or DASH) for key in WORST_WORDS.values())]
        if row["error"]:
            words[-1] = f"{words[-1]}: {row['error']}"
        numbers = [row[name] for name in WORST_NUMBERS.values()]
        cells = [escape(word) for word in words] + [number(value, 2, "+") for value in numbers]
        link = f"{found.folder}/run.toml"
        cells.append(
            f"<code>metropilot drive --from <a href='{link}'>{link}</a></code>" if found.folder else DASH
        )
        lines.append("<tr>" + "".join(f"<td class='text'>{cell}</td>" for cell in cells) + "</tr>")
        if found.picture:
            said = f"{place}. {row['driver']}, {row['origin']}–{row['destination']}, {row['load']}, "
            time_s, stop_m = (number(value, 2, "+") for value in numbers[:2])
            said += f"{row['disturbance']}: {row['outcome']}, {time_s} s, {stop_m} m"
            pictures.append(f"<figure>{found.picture}<figcaption>{escape(said)}</figcaption></figure>")
    said = "<p>Failed, unsafe and late runs first, then by the gap.</p>"
    table = f"<div class='wide'><table><tr>{heads}</tr>{''.join(lines)}</table></div>"
    return f"{said}{table}<div class='runs'>{''.join(pictures)}</div>"
