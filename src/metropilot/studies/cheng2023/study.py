"""The study, start to end: tune and learn (or load the shipped results), track, report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from metropilot.studies.cheng2023 import drives as table
from metropilot.studies.cheng2023.as_printed import AS_PRINTED
from metropilot.studies.cheng2023.drives import (
    POSITION_PID,
    TUNED_POSITION_PID,
    ComparedController,
    controllers_to_compare,
)
from metropilot.studies.cheng2023.figures import figures
from metropilot.studies.cheng2023.setting import CITATION, REFERENCES, SCENARIOS, course
from metropilot.studies.cheng2023.tracking import TrackingKpis, TrackRecord, track_course, tracking_kpis
from metropilot.studies.cheng2023.words import CLAIMS, DEVIATIONS, remarks
from metropilot.studies.report import ReportRow, StudyReport
from metropilot.studies.study import Order, Study


def reproduce(order: Order) -> StudyReport:
    """Reproduce tables 1, 3 and 4 and figures 7 to 10.

    The budget ``quick`` uses the shipped policy and parameters; ``paper`` learns and searches again on the
    base scenario.

    Args:
        order: Its option ``reference`` selects the tracked reference (without new learning).
    """
    kind = order.options["reference"]
    policies, tuned = _load_or_learn(order)
    controllers = controllers_to_compare(tuned, policies)
    measured, records = _track_all(controllers, kind, tuple(policies))
    published = {c.driver: c.published if kind == "s_curve" else "" for c in controllers}
    found: list[ReportRow] = [
        *table.table_1(measured, published),
        *table.table_3(measured),
        *table.table_4(measured),
    ]
    found += [*table.margins(measured), *_other_reference_rows(controllers, tuple(policies), kind)]
    order.say(f"{len(controllers)} drivers tracked {len(SCENARIOS)} scenarios")
    return StudyReport(
        seeds=len(policies),
        rows=found,
        figures=figures(records),
        claims=CLAIMS if kind == "s_curve" else (),
        deviations=DEVIATIONS,
        remarks=remarks(measured, kind, tuned),
    )


def _load_or_learn(order: Order) -> tuple[dict[int, Callable[[Any], Any]], Mapping[str, Mapping[str, float]]]:
    if order.budget == "quick":
        from metropilot.drivers import TUNED_PID
        from metropilot.policy import shipped_policy
        from metropilot.studies.cheng2023.ddpg_pid import load_gains_policy
        from metropilot.studies.cheng2023.fuzzy_pid import TUNED_FUZZY_PID
        from metropilot.studies.cheng2023.neural_pid import TUNED_NEURAL_PID

        tuned = {
            "pid": TUNED_PID,
            POSITION_PID: TUNED_POSITION_PID,
            "fuzzy_pid": TUNED_FUZZY_PID,
            "neural_pid": TUNED_NEURAL_PID,
        }
        return {0: load_gains_policy(shipped_policy("ddpg_pid"))}, tuned
    from metropilot.studies.cheng2023.learning import SEEDS, jobs
    from metropilot.studies.cheng2023.tuning import TUNABLE, tune_driver

    seeds = order.choose_seeds(quick=1, paper=SEEDS)
    results = order.learn(jobs(seeds))
    tuned = {}
    for driver in TUNABLE:
        tuned[driver] = tune_driver(driver, course()).values
        order.say(f"{driver} tuned")
    return {result.job.seed: result.policy for result in results}, tuned


def _track_all(
    controllers: tuple[ComparedController, ...], kind: str, seeds: tuple[int, ...]
) -> tuple[dict[tuple[str, int], list[TrackingKpis]], dict[tuple[str, int], TrackRecord]]:
    """Track every scenario with every driver and seed; return KPIs, and the record of the median seed."""
    measured: dict[tuple[str, int], list[TrackingKpis]] = {}
    records: dict[tuple[str, int], TrackRecord] = {}
    for scenario in SCENARIOS:
        what = course(kind, scenario)
        for one in controllers:
            tracks = [track_course(what, *one.of_seed(seed)) for seed in seeds]
            kpis = [tracking_kpis(what, record) for record in tracks]
            totals = np.array([float(k.speed_total_mps) for k in kpis])
            measured[one.driver, scenario] = kpis
            records[one.driver, scenario] = tracks[int(np.argmin(np.abs(totals - np.median(totals))))]
    return measured, records


def _other_reference_rows(
    controllers: tuple[ComparedController, ...], seeds: tuple[int, ...], kind: str
) -> list[ReportRow]:
    """Rows of the base scenario on every other reference: totals, parking, jerk."""
    found = []
    for other in REFERENCES:
        if other == kind:
            continue
        what = course(other)
        for one in controllers:
            kpis = [tracking_kpis(what, track_course(what, *one.of_seed(seed))) for seed in seeds]
            for field, words, unit in (
                ("speed_total_mps", "total speed error", "m/s"),
                ("position_total_m", "total position error", "m"),
                ("parking_m", "parking error", "m"),
                ("jerk_mps3", "jerk over 2 s", "m/s3"),
            ):
                row = ReportRow(
                    "Other references (beyond the paper)", REFERENCES[other], one.driver, words, unit
                )
                found.append(row.with_values(table.values(kpis, field)))
    return found


STUDY = Study(
    id="cheng2023",
    title="Tracking a reference: DDPG-PID against PID, fuzzy and neural PID (Cheng et al. 2023)",
    citation=CITATION,
    reproduce=reproduce,
    options={"reference": tuple(REFERENCES)},
    as_printed=AS_PRINTED,
)
