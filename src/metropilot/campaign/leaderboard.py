"""The leaderboard: a campaign of drives as a page of the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metropilot.campaign.declared import Campaign
from metropilot.campaign.page import POSSIBLE
from metropilot.campaign.report import open_database, query_rows
from metropilot.campaign.trainsets_page import trainset_sections

DASH = "–"
LEGEND = """\
*Safe*: never above a limit, never beyond the stop. *On time*: also arrived within 0.3 m and 3 s, out of the
runs whose time the true plant could have kept with every restriction known in advance. *Gap*: energy at the
wheel above the certified optimum of the true plant for the running time achieved. *Trainset*: the part of it
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


def leaderboard(campaign: Campaign, folder: Path, summary: Mapping[str, Any], written: str) -> list[str]:
    """Lines of the page, after its title."""
    sections = len(campaign.sections)
    trainsets = ", ".join(f"{name} {load}" for name, load in campaign.trainsets)
    if len(campaign.trainsets) > NAMED:
        trainsets = f"{len({name for name, _ in campaign.trainsets})} trainsets ({campaign.matrix_words})"
    compared = f"{len(campaign.drivers)} drivers on {sections} sections with {trainsets}"
    lines = [f"This page compares {compared}, all under protection.", "", written, "", LEGEND]
    for disturbance in campaign.disturbances:
        rows = [row for row in summary["cells"] if row["disturbance"] == disturbance.name]
        ranges = "; ".join(
            f"`{k}` {low:g}" + (f" to {high:g}" if high > low else "")
            for k, (low, high) in disturbance.ranges.items()
        )
        lines += [f"## {disturbance.name[:1].upper()}{disturbance.name[1:]}", ""]
        lines += [f"{ranges}.", ""] if ranges else []
        lines += [*_table(rows), ""]
    by_trainset = trainset_sections(folder, campaign)
    if not by_trainset:
        by_section = _by_section(folder, campaign.disturbances[0].name)
        return lines + by_section + _failures(summary["worst"])
    return lines + by_trainset


def _number(value: float | None, digits: int) -> str:
    return DASH if value is None else f"{value:.{digits}f}"


def _table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    heads = (
        *(
            "driver",
            "runs",
            "safe",
            "on time",
            "gap median %",
            "95th %",
            "worst %",
            "trainset median %",
            "driver median %",
            "worst %",
            "time error: median s",
            "worst s",
        ),
        *("stop: worst m", "jerk: worst m/s³", "Σ\\|Δu\\|", "intervened", "failed"),
        *("decision: median µs", "worst ms"),
    )
    lines = ["| " + " | ".join(heads) + " |", "|---" * 1 + "|---:" * (len(heads) - 1) + "|"]
    for row in sorted(rows, key=_rank):
        worst_us = row["decision_us_worst"]
        cells = (
            f"`{row['driver']}`",
            str(row["runs"]),
            f"{row['safe']} of {row['driven']}",
            f"{row['successes']} of {row['possible']}",
            _number(row["gap_median"], 2),
            _number(row["gap_95"], 1),
            _number(row["gap_worst"], 1),
            _number(row["trainset_median"], 2),
            _number(row["driver_median"], 2),
            _number(row["driver_worst"], 1),
            _number(row["late_median_s"], 2),
            _number(row["late_worst_s"], 2),
            _number(row["stop_worst_m"], 3),
            _number(row["jerk_worst_mps3"], 2),
            _number(row["comfort_median"], 1),
            str(row["intervened"]),
            str(row["failed"]),
            _number(row["decision_us_median"], 0),
            _number(None if worst_us is None else worst_us / 1e3, 1),
        )
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _rank(row: Mapping[str, Any]) -> tuple[float, float]:
    share = row["successes"] / row["possible"] if row["possible"] else 0.0
    return -share, float("inf") if row["gap_median"] is None else row["gap_median"]


def _by_section(folder: Path, disturbance: str) -> list[str]:
    """Median gap of each driver on each section; in brackets the runs that were not on time."""
    with open_database(folder) as database:
        rows = query_rows(database, BY_SECTION.replace("?", "'" + disturbance.replace("'", "''") + "'"))
    drivers = list(dict.fromkeys(row["driver"] for row in rows))
    cells = {(row["section"], row["driver"]): row for row in rows}
    lines = [f"## Section by section, {disturbance}", ""]
    lines += ["Median gap in percent over the loads; in brackets the runs that did not arrive on time.", ""]
    lines += ["| section | " + " | ".join(f"`{name}`" for name in drivers) + " |"]
    lines += ["|---" + "|---:" * len(drivers) + "|"]
    for section in dict.fromkeys(row["section"] for row in rows):
        words = []
        for name in drivers:
            row = cells[section, name]
            lost = row["possible"] - row["hits"]
            words.append(_number(row["gap"], 1) + (f" ({lost})" if lost else ""))
        lines.append(f"| {section} | " + " | ".join(words) + " |")
    return [*lines, ""]


def _failures(worst: Sequence[Mapping[str, Any]]) -> list[str]:
    """The runs that ended with an error, if there are any."""
    failed = [row for row in worst if row["outcome"] == "failed"]
    if not failed:
        return []
    lines = ["## Runs that failed", ""]
    for row in failed:
        where = f"{row['origin']}-{row['destination']} {row['load']}, {row['disturbance']}"
        lines.append(f"- `{row['driver']}` on {where}: {str(row['error'])[:160]}")
    return lines
