"""Reproduction of figures 3 to 9, and questions beyond the paper."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from metropilot.convoy import FOLLOWERS, AbstractFollower
from metropilot.errors import InputError
from metropilot.studies.chen2023b.as_printed import AS_PRINTED
from metropilot.studies.chen2023b.beyond import (
    campaign_rows,
    needed_gap_rows,
    rough_rows,
    stability,
    stability_rows,
)
from metropilot.studies.chen2023b.drivers import FollowPolicyOptions
from metropilot.studies.chen2023b.drives import drive_pair, drive_rows
from metropilot.studies.chen2023b.figures import figures
from metropilot.studies.chen2023b.learning import ETAS, NAMES, jobs
from metropilot.studies.chen2023b.setting import CITATION, SIMPLE
from metropilot.studies.chen2023b.words import (
    CLAIMS,
    DEVIATIONS,
    FIRST_RETURN,
    LAST_RETURN,
    remarks,
)
from metropilot.studies.report import ReportRow, StudyReport
from metropilot.studies.study import Order, Study

if TYPE_CHECKING:
    from metropilot.studies.learning import SeedResult


def reproduce(order: Order) -> StudyReport:
    """Reproduce figures 3 to 9 and beyond; quick: figures 7 to 9 with the shipped policies."""
    seeds = order.choose_seeds(quick=1, paper=5)
    runs = {} if _uses_shipped(order) else _learn(order, seeds)
    drivers = _drivers(order, runs)
    order.say("driving")
    drives = {name: [drive_pair(each) for each in each_seed] for name, each_seed in drivers.items()}
    rows = [row for name, each in drives.items() for row in drive_rows(name, each)]
    rows += _learning_rows(runs, order.budget)
    median = {NAMES[algorithm]: _median_of(each) for algorithm, each in runs.items()}
    first = {name: each[median.get(name, 0)] for name, each in drivers.items()}
    shown = {name: each[median.get(name, 0)] for name, each in drives.items()}
    order.say("disturbing")
    rows += rough_rows(first, (2, 4, 8) if order.budget == "paper" else (2,), order.folder)
    order.say("swinging")
    gains = stability(first, order.budget, order.folder)
    rows += stability_rows(gains)
    order.say("attacking")
    rows += campaign_rows(order.budget, order.folder) + needed_gap_rows()
    return StudyReport(
        seeds=max((len(each) for each in runs.values()), default=len(seeds)),
        rows=rows,
        figures=figures(runs, shown, gains),
        claims=CLAIMS,
        deviations=DEVIATIONS,
        remarks=[*_missing_seeds(runs, seeds), *remarks(rows)],
    )


def _learn(order: Order, seeds: range) -> dict[str, list[SeedResult]]:
    """Do the learning runs of all seeds, or read those that the folder already holds."""
    from metropilot.studies.learning import is_done

    todo = [job for name in NAMES for job in jobs(name, order.budget, order.options["eta"], seeds)]
    if order.options["learn"] == "nothing":
        todo = [job for job in todo if is_done(job, order.folder)]
    found = order.learn(todo)
    runs = {name: [run for run in found if run.job.config.algorithm == name] for name in NAMES}
    for name, each in runs.items():
        if not each:
            raise InputError("no learning run is there", file=order.folder, field="learn", value=name)
    return runs


def _median_of(runs: list[SeedResult]) -> int:
    """Place of the median seed by its gap error; its policy is disturbed and drawn, and the one shipped."""
    errors = [float(np.nanmin(run.history["evaluation.gap_error_m"])) for run in runs]
    return int(np.argsort(errors, kind="stable")[(len(errors) - 1) // 2])


def _missing_seeds(runs: dict[str, list[SeedResult]], seeds: range) -> list[str]:
    """Remark on the seeds behind the numbers; empty if none is missing."""
    if all(len(each) == len(seeds) for each in runs.values()):
        return []
    there = " and ".join(
        f"{len(each)} of {NAMES[name]} (seeds {', '.join(str(run.job.seed) for run in each)})"
        for name, each in runs.items()
    )
    return [f"Of {len(seeds)} learning runs each these were done when the page was written: {there}."]


def _uses_shipped(order: Order) -> bool:
    """True if the shipped policies drive: in the quick study with its own eta."""
    return order.budget == "quick" and order.options["eta"] == "soft"


def _drivers(order: Order, runs: dict[str, list[SeedResult]]) -> dict[str, list[AbstractFollower]]:
    """Make every follower: learned ones as shipped or one per seed, the others once."""
    made: dict[str, list[AbstractFollower]] = {}
    for algorithm, name in NAMES.items():
        paths = (
            [""] if _uses_shipped(order) else [str(order.folder / run.job.run_id) for run in runs[algorithm]]
        )
        made[name] = [FOLLOWERS.make(name, options=FollowPolicyOptions(path)) for path in paths]
    return made | {name: [FOLLOWERS.make(name)] for name in SIMPLE}


def _learning_rows(runs: dict[str, list[SeedResult]], budget: str) -> list[ReportRow]:
    rows = []
    for algorithm, each in runs.items():
        name, table = NAMES[algorithm], "Figs. 3 to 6"
        rows += [
            ReportRow(table, budget, name, "mean largest gap error behind 24 heads", "m").with_values(
                float(np.nanmin(run.history["evaluation.gap_error_m"])) for run in each
            ),
            ReportRow(table, budget, name, FIRST_RETURN, "").with_values(_returns(run)[0] for run in each),
            ReportRow(table, budget, name, LAST_RETURN, "").with_values(_returns(run)[1] for run in each),
            ReportRow(table, budget, name, "learning time, one core", "s").with_values(
                run.seconds for run in each
            ),
            ReportRow(table, budget, name, "compilation", "s").with_values(
                run.compile_seconds for run in each
            ),
        ]
    return rows


def _returns(run: SeedResult) -> tuple[float, float]:
    """Mean return of the episodes that ended in the first and in the last quarter of learning."""
    found = run.history["return"]
    found = found[np.isfinite(found)]
    quarter = max(found.size // 4, 1)
    return float(found[:quarter].mean()), float(found[-quarter:].mean())


STUDY = Study(
    id="chen2023b",
    title="Chen et al. 2023: train tracking in virtual coupling",
    citation=CITATION,
    reproduce=reproduce,
    options={"eta": tuple(ETAS), "learn": ("missing", "nothing")},
    as_printed=AS_PRINTED,
)
