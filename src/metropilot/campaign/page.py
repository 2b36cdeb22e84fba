"""The report of a campaign: one self-contained HTML file, and a folder for each worst run."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metropilot._io import atomic_write
from metropilot.campaign.declared import Campaign
from metropilot.campaign.store import stored_campaign
from metropilot.campaign.summary import open_database, query_rows
from metropilot.campaign.worst import drive_worst, worst_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    campaign = stored_campaign(folder)
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
    axes = ("drivers", "sections", "trainsets and loads", "times", "disturbances", "seeds")
    matrix = " × ".join(f"{count} {name}" for count, name in zip(campaign.axes, axes, strict=True))
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


def _legend() -> str:
    return (
        "<p>On time: arrived, safe and within 3 s, out of the runs whose time was possible, with the 95 % "
        "interval. Gap: energy over the certified optimum for the time achieved, median with its "
        "95 % interval, 95th percentile and worst. Time and stop: error of the runs that arrived.</p>"
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
