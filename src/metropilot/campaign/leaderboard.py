"""The leaderboard: a campaign of drives as a page of the documentation.

One of several trainsets, actuations or control periods has sections by each of them, not by section of line.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from metropilot.campaign.declared import Campaign, CampaignCase, DisturbanceCase
from metropilot.campaign.matrix import FAILED
from metropilot.campaign.page import DRIVEN, POSSIBLE
from metropilot.campaign.report import DASH, markdown_table, number, open_database, query_rows

Row = Mapping[str, Any]
Columns = tuple[tuple[str, Callable[[Row], str]], ...]
"""Heads of a table, each with the words of its cell in a row."""
LEGEND = """\
*Safe*: never above a limit, never beyond the stop. *On time*: also arrived within 0.3 m and 3 s, out of the
runs whose time the true plant could have kept with every restriction known in advance. *Gap*: energy at the
{at} above the certified optimum of the true plant for the running time achieved. *Trainset*: the part of it
that jerk limit, dead time and lag cost at best under the permitted speed; *driver*: energy above that
[attainable optimum](planning.md#the-attainable-optimum). *Comfort*: largest jerk,
and the sum of command changes (Huang25's index, median). *Intervened*: runs in which protection intervened.
*Failed*: the driver ended with an error. Ordered by runs on time, then by the gap.
"""
NAMED = 12
"""Trainsets that are named one by one in the head."""
BY_SECTION = f"""
    SELECT origin || '-' || destination AS section, driver, median(optimality_gap_percent) AS gap,
        count(*) FILTER (success AND {POSSIBLE}) AS hits, count(*) FILTER ({POSSIBLE}) AS possible
    FROM runs WHERE disturbance = ? GROUP BY ALL ORDER BY min(row)
"""


def leaderboard(campaign: Campaign, folder: Path, summary: Row, written: str) -> list[str]:
    """Lines of the page, after its title."""
    sections = len(campaign.sections)
    trainsets = ", ".join(f"{name} {load}" for name, load in campaign.trainsets)
    if len(campaign.trainsets) > NAMED:
        trainsets = f"{len({name for name, _ in campaign.trainsets})} trainsets ({campaign.matrix_words})"
    compared = f"{len(campaign.drivers)} drivers on {sections} sections with {trainsets}"
    lines = [f"This page compares {compared}, all under protection.", ""]
    lines += [
        *find_results(campaign, summary["cells"]),
        "",
        written,
        "",
        LEGEND.format(at=campaign.objective),
    ]
    for disturbance in campaign.disturbances:
        rows = [row for row in summary["cells"] if row["disturbance"] == disturbance.name]
        words = disturbance_words(disturbance)
        lines += [f"## {disturbance.name[:1].upper()}{disturbance.name[1:]}", ""]
        lines += [f"{words}.", ""] if words else []
        lines += [*_table(rows), ""]
    names = {name for name, _ in campaign.trainsets}
    if len(names) > 1 or campaign.actuations != (None,) or campaign.periods:
        return lines + _by_trainset(folder, campaign)
    return lines + _by_section(folder, campaign.disturbances[0].name) + _failures(summary["worst"])


def find_results(campaign: Campaign, cells: Sequence[Row]) -> list[str]:
    """Find what the rows show, as items: safety, who is always on time, and least energy by disturbance.

    Args:
        campaign: The campaign.
        cells: Statistics by driver and disturbance.
    """
    unsafe = {row["driver"]: 0 for row in cells}
    late, intervened = dict(unsafe), dict(unsafe)
    for row in cells:
        unsafe[row["driver"]] += row["driven"] - row["safe"]
        late[row["driver"]] += row["possible"] - row["successes"]
        intervened[row["driver"]] += row["intervened"]
    driven = sum(row["driven"] for row in cells)
    lost = [f"`{name}` in {count}" for name, count in unsafe.items() if count]
    safe = f"all {driven:,} runs were" if not lost else f"not in every run: {', '.join(lost)} runs"
    punctual = ", ".join(f"`{name}`" for name in late if not late[name] and not intervened[name])
    lines = [
        f"- Safe: {safe}.",
        f"- On time in every run in which that was possible, without an intervention: {punctual or 'none'}.",
    ]
    best = []
    for disturbance in campaign.disturbances:
        known = [
            row
            for row in cells
            if row["disturbance"] == disturbance.name
            and row["gap_median"] is not None
            and row["successes"] == row["possible"]
        ]
        if known:
            row = min(known, key=lambda row: row["gap_median"])
            best.append(f"`{row['driver']}` {number(row['gap_median'], 2)} % ({disturbance.name})")
    if best:
        lines.append(f"- Least median gap of those on time in every run: {', '.join(best)}.")
    return lines


def disturbance_words(disturbance: DisturbanceCase) -> str:
    """Words for the fields of a disturbance; empty where it changes nothing."""
    words = [
        f"`{name}` {low:g}" + (f" to {high:g}" if high > low else "")
        for name, (low, high) in disturbance.ranges.items()
    ]
    if disturbance.actuation is not None:
        delay_s, lag_s = disturbance.actuation
        words.append(
            f"declared dead time {delay_s:g} s and lag {lag_s:g} s, which driver and protection know"
        )
    if disturbance.restriction is not None:
        start, end, kmh, announced = disturbance.restriction
        told = "known before departure" if announced is None else f"announced at {announced:g} of the time"
        words.append(f"restriction to {kmh:g} km/h from {start:g} to {end:g} of the section, {told}")
    if disturbance.arrival is not None:
        ratio, announced = disturbance.arrival
        words.append(f"new running time of {ratio:g} of the scheduled one, announced at {announced:g} of it")
    if disturbance.ideal:
        words.append("ideal actuation")
    return "; ".join(words)


COLUMNS: Columns = (
    ("driver", lambda row: f"`{row['driver']}`"),
    ("runs", lambda row: str(row["runs"])),
    ("safe", lambda row: f"{row['safe']} of {row['driven']}"),
    ("on time", lambda row: f"{row['successes']} of {row['possible']}"),
    ("gap median %", lambda row: number(row["gap_median"], 2)),
    ("95th %", lambda row: number(row["gap_95"], 1)),
    ("worst %", lambda row: number(row["gap_worst"], 1)),
    ("trainset median %", lambda row: number(row["trainset_median"], 2)),
    ("driver median %", lambda row: number(row["driver_median"], 2)),
    ("worst %", lambda row: number(row["driver_worst"], 1)),
    ("time error: median s", lambda row: number(row["late_median_s"], 2)),
    ("worst s", lambda row: number(row["late_worst_s"], 2)),
    ("stop: worst m", lambda row: number(row["stop_worst_m"], 3)),
    ("jerk: worst m/s³", lambda row: number(row["jerk_worst_mps3"], 2)),
    ("Σ|Δu|", lambda row: number(row["comfort_median"], 1)),
    ("intervened", lambda row: str(row["intervened"])),
    ("failed", lambda row: str(row["failed"])),
    ("decision: median µs", lambda row: number(row["decision_us_median"], 0)),
    ("worst ms", lambda row: number(row["decision_us_worst"] and row["decision_us_worst"] / 1e3, 1)),
)


def _table(rows: Sequence[Row]) -> list[str]:
    """The drivers by runs on time, then by the gap."""

    def rank(row: Row) -> tuple[float, float]:
        share = row["successes"] / row["possible"] if row["possible"] else 0.0
        return -share, float("inf") if row["gap_median"] is None else row["gap_median"]

    return _cells(COLUMNS, sorted(rows, key=rank))


def _cells(columns: Columns, rows: Sequence[Row]) -> list[str]:
    heads, words = zip(*columns, strict=True)
    return markdown_table(heads, [[each(row) for each in words] for row in rows])


def _by_section(folder: Path, disturbance: str) -> list[str]:
    """Median gap of each driver on each section; in brackets the runs that were not on time."""
    with open_database(folder) as database:
        rows = query_rows(database, BY_SECTION.replace("?", "'" + disturbance.replace("'", "''") + "'"))
    drivers = list(dict.fromkeys(row["driver"] for row in rows))
    cells = {(row["section"], row["driver"]): row for row in rows}
    lines = [f"## Section by section, {disturbance}", ""]
    lines += ["Median gap in percent over the loads; in brackets the runs that did not arrive on time.", ""]
    table = []
    for section in dict.fromkeys(row["section"] for row in rows):
        row = [section]
        for found in (cells[section, name] for name in drivers):
            lost = found["possible"] - found["hits"]
            row.append(number(found["gap"], 1) + (f" ({lost})" if lost else ""))
        table.append(row)
    return [*lines, *markdown_table(["section", *(f"`{name}`" for name in drivers)], table), ""]


def _failures(worst: Sequence[Row]) -> list[str]:
    """The runs that ended with an error, if there are any."""
    failed = [row for row in worst if row["outcome"] == "failed"]
    if not failed:
        return []
    lines = ["## Runs that failed", ""]
    for row in failed:
        where = f"{row['origin']}-{row['destination']} {row['load']}, {row['disturbance']}"
        lines.append(f"- `{row['driver']}` on {where}: {str(row['error'])[:160]}")
    return lines


JERK_MARGIN = 1.05
"""Jerk over the trainset's limit above which a run is counted."""
FOLDERS = re.compile(r"\S*/(?=[^/\s])")
"""Folders of a path in an error: they differ from machine to machine."""
SHOWN = 12
"""Failures listed of each driver."""
NOMINAL = DisturbanceCase("nominal")
EARLY = "outcome = 'arrived' AND coalesce(safe, false) AND time_error_s < 0"
LOST = f"{DRIVEN} AND (NOT coalesce(safe, false) OR (({POSSIBLE}) AND NOT success AND NOT ({EARLY})))"
"""Condition of a run that failed: not safe, or not in time although that was possible."""
TOO_EARLY = f"{DRIVEN} AND ({POSSIBLE}) AND NOT success AND {EARLY}"
"""Condition of a run that is not on time and yet not among those that failed."""
LEFT = "outcome IN ('stalled', 'out_of_time')"
CELL = "line, origin, destination, trainset, load, time, period_s, disturbance, number, driver"
LATE = "SELECT * FROM runs WHERE actuation = '0 s, 0 s'"
TRAINSET_NUMBERS = f"""
    count(*) AS runs, count(*) FILTER ({DRIVEN}) AS driven,
    count(*) FILTER ({DRIVEN} AND coalesce(safe, false)) AS safe,
    count(*) FILTER ({POSSIBLE}) AS possible, count(*) FILTER ({POSSIBLE} AND success) AS successes,
    count(*) FILTER ({LEFT}) AS left_standing, count(*) FILTER (interventions > 0) AS intervened,
    count(*) FILTER (max_jerk_mps3 > {JERK_MARGIN} * jerk_limit_mps3) AS jerky,
    max(max_jerk_mps3 / jerk_limit_mps3) FILTER (outcome = 'arrived') AS jerk_ratio,
    median(optimality_gap_percent) AS gap_median,
    median(gap_more) AS more_median, max(gap_more) AS more_worst
"""
PAIRED = f"""
    SELECT runs.*, CASE WHEN runs.actuation <> '0 s, 0 s' AND runs.outcome = 'arrived'
        AND ideal.outcome = 'arrived' THEN runs.optimality_gap_percent - ideal.optimality_gap_percent
        END AS gap_more
    FROM runs LEFT JOIN ({LATE}) AS ideal USING ({CELL})
"""
TRAINSET_COLUMNS: Columns = (
    *COLUMNS[:4],
    ("left standing", lambda row: str(row["left_standing"])),
    ("intervened", lambda row: str(row["intervened"])),
    ("jerk > 1.05", lambda row: str(row["jerky"])),
    ("jerk worst", lambda row: number(row["jerk_ratio"], 2)),
    ("gap median %", lambda row: number(row["gap_median"], 2)),
    ("gap over no dead time: median", lambda row: number(row["more_median"], 2, "+")),
    ("worst", lambda row: number(row["more_worst"], 2, "+")),
)
TRAINSET_LEGEND = f"""\
*Left standing*: stalled or out of time. *Intervened*: runs in which protection intervened. *Jerk*: runs
above {JERK_MARGIN:g} of the trainset's jerk limit, and the largest jerk over that limit where there is one.
*Gap over no dead time*: the gap less that of the same driver in the same run with neither dead time nor lag,
in percentage points, where both arrived.
"""
LEVELS = {
    "line": "Line by line",
    "actuation": "By declared dead time and lag",
    "period_s": "By control period",
}
"""Columns of the results, each a table of its own, with its title."""


def _by_trainset(folder: Path, campaign: Campaign) -> list[str]:
    """Sections by declared actuation, trainset, line and control period; failures."""
    with open_database(folder) as database:
        select = f"SELECT {{}}, {TRAINSET_NUMBERS} FROM ({PAIRED}) GROUP BY ALL ORDER BY min(row)"
        drivers = query_rows(database, select.format("driver"))
        levels = {key: query_rows(database, select.format(f"{key}, driver")) for key in LEVELS}
        trainsets = query_rows(database, select.format("trainset, driver"))
        lost = query_rows(database, f"SELECT * FROM runs WHERE {LOST} ORDER BY row")
        select = f"SELECT driver, count(*) AS runs FROM runs WHERE {TOO_EARLY} GROUP BY ALL ORDER BY min(row)"
        early = query_rows(database, select)
    lines = ["## Driver by driver", "", TRAINSET_LEGEND, *_cells(TRAINSET_COLUMNS, drivers), ""]
    for key, title in LEVELS.items():
        if len({row[key] for row in levels[key]}) > 1:
            lines += [f"## {title}", "", *_grid(levels[key], key), ""]
    if len({name for name, _ in campaign.trainsets}) > 1:
        lines += ["## Trainset by trainset", "", *_grid(trainsets, "trainset"), ""]
    return lines + _failed_runs(campaign, lost, early)


def _grid(rows: Sequence[Row], key: str) -> list[str]:
    """Runs on time out of those possible, a row for each value and a column for each driver."""
    drivers = list(dict.fromkeys(row["driver"] for row in rows))
    cells = {(row[key], row["driver"]): row for row in rows}
    head = "control period s" if key == "period_s" else key.replace("actuation", "dead time, lag")
    lines = ["On time, out of the runs whose time was possible; in brackets: not safe, left standing.", ""]
    table = []
    values = dict.fromkeys(row[key] for row in rows)
    for value in sorted(values) if key == "period_s" else values:
        words = [f"{value:g}" if isinstance(value, float) else str(value)]
        for name in drivers:
            row = cells.get((value, name))
            if row is None:
                words.append(DASH)
                continue
            unsafe, left = row["driven"] - row["safe"], row["left_standing"]
            bad = f" ({unsafe}, {left})" if unsafe or left else ""
            words.append(f"{row['successes']} of {row['possible']}{bad}")
        table.append(words)
    return [*lines, *markdown_table([head, *(f"`{name}`" for name in drivers)], table)]


def _failed_runs(campaign: Campaign, lost: Sequence[Row], early: Sequence[Row]) -> list[str]:
    """Every driver's failures: outcome, and the command that drives the run again; how many were early."""
    counts = ", ".join(f"`{row['driver']}` {row['runs']}" for row in early)
    told = [f"Not on time because they came too early, and not listed: {counts}.", ""] if early else []
    if not lost:
        return ["## Runs that failed", "", "None.", "", *told]
    lines = ["## Runs that failed", "", *told]
    lines += [f"Not safe, or late although that time was possible; up to {SHOWN} of each driver.", ""]
    for driver, rows in groupby(lost, lambda row: row["driver"]):
        found = list(rows)
        lines += [f"`{driver}`: {len(found)}", "", "```text"]
        lines += [failure_line(campaign.case(row["row"]), row) for row in found[:SHOWN]]
        lines += ["```", ""]
    return lines


def failure_line(case: CampaignCase, row: Row) -> str:
    """Command that drives a failed run again, and what it shows.

    Args:
        case: The cell of the run.
        row: Its result.
    """
    options = {"time": row["scheduled_time_s"], "trainset": case.trainset, "load": case.load}
    options |= {"driver": case.driver, "dt": case.period_s}
    options |= {} if case.disturbance == NOMINAL else {"seed": row["seed"]}
    words = ["metropilot", "drive", case.line, case.origin, case.destination]
    for name, value in options.items():
        words += [f"--{name}", f"{value:.12g}" if isinstance(value, float) else str(value)]
    error = FOLDERS.sub("", str(row["error"] or ""))
    told = error if row["outcome"] == FAILED else outcome_words(row)
    more = "" if case.disturbance == NOMINAL else f"with disturbance {case.disturbance.name}, "
    return f"{shlex.join(words)}  # {more}{row['outcome']}: {told[:100]}"


def outcome_words(row: Row) -> str:
    """Errors of a run in words: time, stop, interventions, overspeed."""
    late, stop, over = row["time_error_s"], row["stopping_error_m"], row["max_overspeed_mps"]
    words = [] if late is None else [f"{late:+.1f} s"]
    words += [] if stop is None else [f"{stop:+.2f} m"]
    words += [f"{row['interventions']} interventions"] if row["interventions"] else []
    words += [f"{over:.2f} m/s too fast"] if over else []
    return ", ".join(words)
