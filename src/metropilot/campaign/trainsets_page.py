"""Sections of a campaign's page on its trainsets: by declared actuation, trainset, line, period; failures."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from metropilot.campaign.declared import Campaign, CampaignCase, DisturbanceCase
from metropilot.campaign.matrix import FAILED
from metropilot.campaign.page import DRIVEN, POSSIBLE
from metropilot.campaign.report import open_database, query_rows

DASH = "–"
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
LEFT = "outcome IN ('stalled', 'out_of_time')"
CELL = "line, origin, destination, trainset, load, time, period_s, disturbance, number, driver"
LATE = "SELECT * FROM runs WHERE actuation = '0 s, 0 s'"
NUMBERS = f"""
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
HEADS = (
    *("driver", "runs", "safe", "on time", "left standing", "intervened", "jerk > 1.05", "jerk worst"),
    *("gap median %", "gap over no dead time: median", "worst"),
)
LEGEND = f"""\
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


def trainset_sections(folder: Path, campaign: Campaign) -> list[str]:
    """Lines of the page, in Markdown; empty for a campaign of one trainset as it is.

    Args:
        folder: The campaign's folder.
        campaign: The campaign.
    """
    names = {name for name, _ in campaign.trainsets}
    if len(names) == 1 and campaign.actuations == (None,) and not campaign.periods:
        return []
    with open_database(folder) as database:
        select = f"SELECT {{}}, {NUMBERS} FROM ({PAIRED}) GROUP BY ALL ORDER BY min(row)"
        drivers = query_rows(database, select.format("driver"))
        levels = {key: query_rows(database, select.format(f"{key}, driver")) for key in LEVELS}
        trainsets = query_rows(database, select.format("trainset, driver"))
        lost = query_rows(database, f"SELECT * FROM runs WHERE {LOST} ORDER BY row")
    lines = ["## Driver by driver", "", LEGEND, *_table(drivers), ""]
    for key, title in LEVELS.items():
        if len({row[key] for row in levels[key]}) > 1:
            lines += [f"## {title}", "", *_grid(levels[key], key), ""]
    if len(names) > 1:
        lines += ["## Trainset by trainset", "", *_grid(trainsets, "trainset"), ""]
    return lines + _failed_runs(campaign, lost)


def _table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = ["| " + " | ".join(HEADS) + " |", "|---" + "|---:" * (len(HEADS) - 1) + "|"]
    for row in rows:
        cells = (
            f"`{row['driver']}`",
            str(row["runs"]),
            f"{row['safe']} of {row['driven']}",
            f"{row['successes']} of {row['possible']}",
            str(row["left_standing"]),
            str(row["intervened"]),
            str(row["jerky"]),
            _number(row["jerk_ratio"]),
            _number(row["gap_median"]),
            _number(row["more_median"], sign="+"),
            _number(row["more_worst"], sign="+"),
        )
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _number(value: float | None, sign: str = "") -> str:
    return DASH if value is None else f"{value:{sign}.2f}"


def _grid(rows: Sequence[Mapping[str, Any]], key: str) -> list[str]:
    """Runs on time out of those possible, a row for each value and a column for each driver."""
    drivers = list(dict.fromkeys(row["driver"] for row in rows))
    cells = {(row[key], row["driver"]): row for row in rows}
    head = "control period s" if key == "period_s" else key.replace("actuation", "dead time, lag")
    lines = ["On time, out of the runs whose time was possible; in brackets: not safe, left standing.", ""]
    lines += [f"| {head} | " + " | ".join(f"`{name}`" for name in drivers) + " |"]
    lines += ["|---" + "|---:" * len(drivers) + "|"]
    values = {row[key] for row in rows}
    for value in sorted(values) if key == "period_s" else dict.fromkeys(row[key] for row in rows):
        words = []
        for name in drivers:
            row = cells.get((value, name))
            if row is None:
                words.append(DASH)
                continue
            unsafe, left = row["driven"] - row["safe"], row["left_standing"]
            bad = f" ({unsafe}, {left})" if unsafe or left else ""
            words.append(f"{row['successes']} of {row['possible']}{bad}")
        lines.append(f"| {value:g} | " if isinstance(value, float) else f"| {value} | ")
        lines[-1] += " | ".join(words) + " |"
    return lines


def _failed_runs(campaign: Campaign, lost: Sequence[Mapping[str, Any]]) -> list[str]:
    """Every driver's failures: outcome, and the command that drives the run again."""
    if not lost:
        return ["## Runs that failed", "", "None.", ""]
    lines = ["## Runs that failed", ""]
    lines += [f"Not safe, or late although that time was possible; up to {SHOWN} of each driver.", ""]
    for driver, rows in groupby(lost, lambda row: row["driver"]):
        found = list(rows)
        lines += [f"`{driver}`: {len(found)}", "", "```text"]
        lines += [failure_line(campaign.case(row["row"]), row) for row in found[:SHOWN]]
        lines += ["```", ""]
    return lines


def failure_line(case: CampaignCase, row: Mapping[str, Any]) -> str:
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


def outcome_words(row: Mapping[str, Any]) -> str:
    """Errors of a run in words: time, stop, interventions, overspeed."""
    late, stop, over = row["time_error_s"], row["stopping_error_m"], row["max_overspeed_mps"]
    words = [] if late is None else [f"{late:+.1f} s"]
    words += [] if stop is None else [f"{stop:+.2f} m"]
    words += [f"{row['interventions']} interventions"] if row["interventions"] else []
    words += [f"{over:.2f} m/s too fast"] if over else []
    return ", ".join(words)
