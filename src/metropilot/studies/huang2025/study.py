"""The study, start to end: learn, drive the cases, compare with the paper and with the optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from metropilot.policy import shipped_policy
from metropilot.studies.huang2025.as_printed import AS_PRINTED
from metropilot.studies.huang2025.beyond import GAINS, beyond_rows, repeat_stops, stop_rows
from metropilot.studies.huang2025.drives import (
    EvaluatedRun,
    decision_row,
    drive_at_arrival,
    drive_case,
    news_rows,
    rows_of,
)
from metropilot.studies.huang2025.figures import figures
from metropilot.studies.huang2025.setting import (
    CASES,
    CITATION,
    EITOP,
    EQUAL_EITOE,
    EXPERTS,
    LEARNED,
    LEARNED_IE,
    MANUAL,
    TABLE4,
)
from metropilot.studies.huang2025.words import CLAIMS, DEVIATIONS, remarks
from metropilot.studies.report import ReportRow, StudyReport
from metropilot.studies.study import Study

if TYPE_CHECKING:
    from metropilot.studies.learning import SeedResult
    from metropilot.studies.study import Order

LEARNING = "Learning: its Figs. 5 and 6"
DECISIONS = "Decision time"
MANUAL_SEEDS = 10
Found = dict[tuple[str, str], EvaluatedRun]


def reproduce(order: Order) -> StudyReport:
    """Reproduce the cases of the paper and the comparisons beyond it.

    Args:
        order: ``quick``: shipped policies, a short learning run of each. ``paper``: everything learned with
            ten seeds. Manual drives have ten seeds in both.
    """
    from metropilot.studies.huang2025.learning import jobs

    paper = order.budget == "paper"
    seeds = order.choose_seeds(quick=1, paper=10)
    folder = order.folder / "huang2025"
    results = order.learn(jobs(seeds, order.budget), folder)
    policies = _policies(folder, results, paper=paper)
    found: Found = {}
    for case in CASES:
        for driver in case.drivers:
            found[case.id, driver] = drive_case(case, driver, policies, range(MANUAL_SEEDS))
        if case.told_s is None:
            arrival = float(np.median([one.running_time_s for one in found[case.id, EITOP].drives]))
            found[case.id, EQUAL_EITOE] = drive_at_arrival(case, arrival)
        order.say(f"{case.name} driven")
    stops = [repeat_stops(gain) for gain in GAINS]
    rows = _rows(found)
    learned = [r for r in results if r.job.about["driver"] == EITOP]
    rows += [*_learning_rows(results), *stop_rows(stops), *beyond_rows(policies)]
    drawn = figures(found, learned, stops)
    said = remarks(rows, budget=order.budget)
    return StudyReport(len(seeds), rows, drawn, DEVIATIONS, said, CLAIMS)


def fixed_rows() -> list[ReportRow]:
    """Rows of the drivers that neither learn nor draw."""
    rows: list[ReportRow] = []
    for case in CASES:
        for driver in case.drivers:
            if driver not in (MANUAL, *LEARNED):
                found = drive_case(case, driver, {}, range(1))
                rows += [*rows_of(found, None), *news_rows(found)]
    return rows


def _policies(folder: Path, results: Sequence[SeedResult], *, paper: bool) -> Mapping[str, Sequence[Path]]:
    """Policy files by driver: the shipped ones, or one per seed of the learning runs."""
    from metropilot.studies.huang2025.learning import write_result

    if not paper:
        return {d: [shipped_policy(d)] for d in LEARNED}
    found: dict[str, list[Path]] = {}
    for result in results:
        found.setdefault(str(result.job.about["driver"]), []).append(write_result(folder, result))
    return found


def _rows(found: Found) -> list[ReportRow]:
    """Rows of every case and driver, and of the decision times."""
    rows: list[ReportRow] = []
    for (case_id, _), one in found.items():
        rows += rows_of(one, found.get((case_id, MANUAL)))
        rows += news_rows(one)
    rows += _whole(found)
    drivers = dict.fromkeys(driver for _, driver in found)
    rows += [decision_row(DECISIONS, d, [one for one in found.values() if one.driver == d]) for d in drivers]
    return rows


def _whole(found: Found) -> list[ReportRow]:
    """Rows of case 3 over both sections, without the dwell time between them (as in the paper)."""
    rows, said = [], {"eitoe": 300.0, EITOP: 298.0}
    for driver in EXPERTS:
        if ("sjz", driver) not in found:
            continue
        first, second = found["sjz", driver].drives, found["xc", driver].drives
        times = [a.running_time_s + b.running_time_s for a, b in zip(first, second, strict=True)]
        place = ReportRow(TABLE4, "SJZ to XHM, 298 s", driver, "running time", "s", published=said[driver])
        rows.append(place.with_values(times))
    return rows


def _learning_rows(results: Sequence[SeedResult]) -> list[ReportRow]:
    """Rows of each learner's evaluation, and of EITOP's case 1 at the first and the best evaluation."""
    rows = []
    for driver in LEARNED:
        mine = [r for r in results if r.job.about["driver"] == driver]
        best = [int(np.nanargmax(r.history["evaluation.score"])) for r in mine]
        for kpi, column, unit, factor in (
            ("drives that arrive safely and on time", "safe_share", "%", 100.0),
            ("Ie of case 1", "case1_ie_jpkg", "J/kg", 1.0),
            ("running time of case 1", "case1_time_s", "s", 1.0),
        ):
            said = LEARNED_IE[1] if (driver, column) == (EITOP, "case1_ie_jpkg") else None
            values = [
                factor * float(r.history[f"evaluation.{column}"][k]) for r, k in zip(mine, best, strict=True)
            ]
            rows.append(
                ReportRow(LEARNING, "policy kept", driver, kpi, unit, published=said).with_values(values)
            )
        seconds = [r.seconds for r in mine]
        rows.append(ReportRow(LEARNING, "policy kept", driver, "time to learn", "s").with_values(seconds))
    return rows


STUDY = Study(
    id="huang2025",
    title="Expert driving, and PPO inside it (Huang et al. 2025)",
    citation=CITATION,
    reproduce=reproduce,
    as_printed=AS_PRINTED,
    fixed_rows=fixed_rows,
)
