"""Summary and report of a campaign: one self-contained HTML file, and a folder for each worst run."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metropilot._io import atomic_write
from metropilot.campaign.declared import AXES, Campaign
from metropilot.campaign.rows import FAILED, INFEASIBLE, RESULTS, TIMINGS
from metropilot.campaign.store import PARTS_FOLDER, TIMINGS_FOLDER, CampaignStore, campaign_of_folder
from metropilot.campaign.worst import drive_worst, worst_table
from metropilot.errors import InputError

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection
    from matplotlib.figure import Figure


CONFIDENCE = 0.95
WORST = 10
RESULTS_FILE, TIMINGS_FILE = "results.parquet", "timings.parquet"
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


def open_database(folder: Path) -> DuckDBPyConnection:
    """Open a database with the view ``runs``: the results of the drivers with their rows and timings."""
    import duckdb

    database = duckdb.connect(config={"memory_limit": "512MB"})
    database.execute(
        f"CREATE VIEW runs AS SELECT * FROM ({_parts(folder, PARTS_FOLDER)}) AS result "
        f"LEFT JOIN ({_parts(folder, TIMINGS_FOLDER)}) AS timing USING (row, driver, cell)"
    )
    return database


def _parts(folder: Path, kind: str) -> str:
    """Query for all parts of one kind, ordered by driver, with the number of the row."""
    campaign = campaign_of_folder(folder)
    quoted = [name.replace("'", "''") for name in campaign.drivers]
    names = ", ".join(f"'{name}'" for name in quoted)
    parts = str(folder / kind / "*" / "*.parquet").replace("'", "''")
    columns = RESULTS if kind == PARTS_FOLDER else TIMINGS
    # parts of an earlier version lack the columns of a later one
    whole = ", ".join(f"NULL::{sql} AS {name}" for name, sql in {"row": "BIGINT", **columns}.items())
    return (
        f"SELECT {whole} WHERE false UNION ALL BY NAME "
        f"SELECT (list_position([{names}], driver) - 1) * {campaign.cells} + cell AS row, * "
        f"FROM read_parquet('{parts}', union_by_name=true) WHERE driver IN ({names})"
    )


def collect_parts(folder: Path) -> None:
    """Write all parts as one file each: ``results.parquet``, ``timings.parquet``, ordered by row.

    Raises:
        InputError: A file cannot be written, or a part cannot be read.
    """
    for kind, target in ((PARTS_FOLDER, RESULTS_FILE), (TIMINGS_FOLDER, TIMINGS_FILE)):
        query = f"SELECT * FROM ({_parts(folder, kind)}) ORDER BY row"
        atomic_write(folder / target, lambda partial, query=query: _copy(query, partial))


def _copy(query: str, partial: Path) -> None:
    """Write a query's rows as Parquet."""
    import duckdb

    place = str(partial).replace("'", "''")
    with duckdb.connect(config={"threads": 1, "memory_limit": "512MB"}) as database:
        try:
            database.execute(f"COPY ({query}) TO '{place}' (FORMAT parquet, COMPRESSION zstd)")
        except duckdb.Error as error:
            words = str(error).splitlines()[0]
            raise InputError("cannot collect the results", file=partial, value=words) from None


def summarise(folder: Path) -> dict[str, Any]:
    """Summarise a campaign as plain values.

    Args:
        folder: Folder of the campaign, which may be unfinished.

    Returns:
        ``campaign, digest, rows, done, checksum``, and lists of rows ``drivers`` (one per driver), ``cells``
        (one per driver and disturbance) and ``worst``; ``cost`` holds processor time and memory.

    Raises:
        InputError: Not the folder of a campaign.
    """
    campaign = campaign_of_folder(folder)
    store = CampaignStore(folder, campaign)
    done = sum(len(campaign.shard(piece)) for piece in store.finished_shards())
    found: dict[str, Any] = {
        "campaign": campaign.name,
        "digest": campaign.digest,
        "rows": campaign.rows,
        "done": done,
        "checksum": store.checksum(),
    }
    if not done:
        return found | {"drivers": [], "cells": [], "worst": [], "cost": {}}
    with open_database(folder) as database:
        drivers = group_statistics(database, "driver")
        cells = group_statistics(database, "driver", "disturbance")
        worst = query_rows(database, WORST_FIRST)
        cost = query_rows(database, COST)[0]
    return found | {"drivers": drivers, "cells": cells, "worst": worst, "cost": cost}


COST = """
    SELECT sum(processor_s) AS processor_s, avg(processor_s) AS processor_s_mean,
        quantile_cont(processor_s, 0.95) AS processor_s_95, max(worker_mb) AS worker_mb FROM runs
"""


def query_rows(database: DuckDBPyConnection, query: str) -> list[dict[str, Any]]:
    """The rows of a query, as dictionaries."""
    answer = database.execute(query)
    names = [column[0] for column in answer.description or ()]
    return [dict(zip(names, row, strict=True)) for row in answer.fetchall()]


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
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = max(float(binom.ppf(tail, count, 0.5)) - 1.0, 0.0) / count
    high = min(float(binom.ppf(1.0 - tail, count, 0.5)) + 1.0, count) / count
    return low, high


CLOUD = 3000
DASH = "–"
REPORT = "report.html"
STYLE = """
body{font:14px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:76rem;padding:0 1rem;color:#202020}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:.6rem 0}
th,td{padding:.25rem .7rem;border-bottom:1px solid #d9d9d9;text-align:right;vertical-align:top}
th:first-child,td:first-child,td.text,th.text{text-align:left}th{border-bottom:2px solid #6b6b6b}
small{color:#6b6b6b}code{background:#efefef;padding:0 .25rem}svg{max-width:100%;height:auto}
.wide{overflow-x:auto}
.runs{display:grid;grid-template-columns:repeat(auto-fill,minmax(26rem,1fr));gap:1.2rem}
figure{margin:0}figcaption{font-size:.9rem}
"""
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


def write_campaign_report(folder: Path, summary: Mapping[str, Any], about: Mapping[str, str]) -> Path:
    """Write ``report.html``, and a folder ``worst/NN`` for each of the worst runs.

    Args:
        folder: The campaign's folder.
        summary: From :func:`summarise`.
        about: Further lines of the head by name: time, machine, commit.

    Raises:
        InputError: The folder cannot be written.
    """
    campaign = campaign_of_folder(folder)
    worst = drive_worst(folder, campaign, summary["worst"])
    parts = [f"<h1>Campaign {escape(campaign.name)}</h1>", _head(campaign, summary, about)]
    parts += ["<h2>Drivers</h2>", _legend(), _table(summary["drivers"], ("driver",))]
    if len(campaign.disturbances) > 1:
        parts += ["<h2>By disturbance</h2>", _table(summary["cells"], ("disturbance", "driver"))]
    parts += ["<h2>Energy against time</h2>", _pareto(folder, campaign)]
    parts += ["<h2>The worst runs</h2>", worst_table(summary["worst"], worst)]
    body = "\n".join(parts)
    head = f"<meta charset='utf-8'><title>{escape(campaign.name)}</title><style>{STYLE}</style>"
    path = folder / REPORT
    text = f"<!doctype html><html lang='en'><head>{head}</head><body>{body}</body></html>\n"
    atomic_write(path, lambda partial: partial.write_text(text, encoding="utf-8"))
    return path


def _head(campaign: Campaign, summary: Mapping[str, Any], about: Mapping[str, str]) -> str:
    matrix = matrix_words(campaign)
    lines = [f"{summary['done']} of {summary['rows']} runs: {matrix}."]
    cost = summary["cost"]
    if cost:
        lines.append(
            f"{cost['processor_s']:.0f} s of processor time, {cost['processor_s_mean']:.3f} s a run "
            f"(95 %: {cost['processor_s_95']:.3f} s); workers used up to {cost['worker_mb']:.0f} MB."
        )
    lines.append(f"Checksum of the results: <code>{summary['checksum']}</code>.")
    lines += [f"{escape(name)}: {escape(text)}." for name, text in about.items()]
    return "".join(f"<p>{line}</p>" for line in lines)


def matrix_words(campaign: Campaign) -> str:
    """The matrix of a campaign in words: its axes with their sizes, and the sample if there is one."""
    sizes = zip(("drivers", *AXES), campaign.axes, strict=True)
    words = " × ".join(f"{count} {name}" for name, count in sizes if count > 1 or name not in SINGLE)
    if campaign.cells < prod(campaign.axes[1:]):
        words += f", a sample of {campaign.combinations} combinations with every driver and actuation"
    return words


SINGLE = ("control periods", "actuations")
"""Axes that most campaigns do not have."""


def _legend() -> str:
    return (
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
    if value is None:
        return DASH
    return f"{value / 1e3 if name == 'decision_us_worst' else value:.{digits}f}"


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
    """Energy against time, as inline SVG."""
    from metropilot.evaluate import house_style

    energy = "energy_wheel_kwh" if campaign.objective == "wheel" else "energy_line_kwh"
    with open_database(folder) as database:
        medians = query_rows(database, PARETO.format(energy=energy))
        cloud = query_rows(database, POINTS.format(energy=energy, most=CLOUD))
    if not medians:
        return "<p>No run arrived.</p>"
    with house_style():
        figure = pareto_figure(medians, cloud)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
    said = (
        "<p>Left: each run that arrived (a sample where there are many) and the median of each driver at "
        "each scheduled time, per tonne and kilometre. Right: the same medians over the optimum for the time "
        "achieved, with the quartiles.</p>"
    )
    return said + "".join(text.getvalue().partition("<svg")[1:])


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
