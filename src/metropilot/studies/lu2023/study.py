"""The study: Table 5 and Figs. 6 to 9, convergence, ablation, and one network for all plans."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from metropilot.evaluate import make_driver
from metropilot.studies.learning import write_policy
from metropilot.studies.lu2023.as_printed import AS_PRINTED
from metropilot.studies.lu2023.drives import (
    NotchRun,
    arrival_rows,
    drive_plan,
    load_driver,
    notch_front,
    shipped_policy_of,
    track_policy,
)
from metropilot.studies.lu2023.figures import figures
from metropilot.studies.lu2023.setting import (
    ABLATION,
    BEYOND,
    CITATION,
    CONVERGENCE,
    EPISODES,
    FASTER_PERCENT,
    PLANS,
    RULES,
    TABLE,
    plan_case,
)
from metropilot.studies.lu2023.ship import median_of
from metropilot.studies.lu2023.words import CLAIMS, DEVIATIONS, remarks
from metropilot.studies.report import ReportRow, StudyReport
from metropilot.studies.study import Study

if TYPE_CHECKING:
    from metropilot.studies.learning import SeedResult
    from metropilot.studies.lu2023.learning import Convergence
    from metropilot.studies.study import Order

COMMAND = "metropilot reproduce lu2023 --budget paper"
QUICK_STEPS = 8_000
COMPARED = ("120", "130")
ABLATED = "120"
ABLATION_SEEDS = 5
PLAN_SEEDS = 6
ALL_SEEDS = 3
LEARNERS = {"dqn": "all", "improved_dqn": ""}
Runs = dict[str, dict[str, list["SeedResult"]]]


def reproduce(order: Order) -> StudyReport:
    """Reproduce Table 5, Figs. 6 to 9, convergence and ablation."""
    from metropilot.studies.lu2023.learning import (
        ALL_STEPS,
        IMPROVEMENTS,
        LEARNING,
        all_plans_job,
        plan_job,
    )

    seeds = order.choose_seeds(quick=1, paper=10)
    paper = order.budget == "paper"
    compared = COMPARED if paper else COMPARED[:1]
    short = {} if paper else {"steps": QUICK_STEPS}
    prefix = "" if paper else "quick-"
    jobs = [
        plan_job(f"{prefix}{driver}", plan_case(plan), seed, off, **short)
        for plan in compared
        for driver, off in LEARNERS.items()
        for seed in seeds
    ]
    if paper:
        some, few = (range(min(len(seeds), most)) for most in (PLAN_SEEDS, ALL_SEEDS))
        jobs += [
            plan_job("improved_dqn", plan, seed, steps=ALL_STEPS if plan.restricted else LEARNING.steps)
            for plan in PLANS
            if plan.id not in compared
            for seed in some
        ]
        jobs += [all_plans_job(driver, seed) for driver in LEARNERS for seed in few]
        jobs += [
            plan_job(f"without-{off}", plan_case(ABLATED), seed, off)
            for off in IMPROVEMENTS
            for seed in range(min(len(seeds), ABLATION_SEEDS))
        ]
    results = order.learn(jobs, order.folder / "lu2023")
    named: dict[str, list[SeedResult]] = {}
    for result in results:
        named.setdefault(result.job.name.removeprefix("quick-"), []).append(result)
    runs: Runs = {plan: {driver: named[f"{driver}-{plan}"] for driver in LEARNERS} for plan in compared}
    drives, all_plans = _drives(order.folder / "lu2023", named, paper=paper)
    rows = [row for one in drives for row in arrival_rows(TABLE, one, published=one[0].driver != RULES)]
    rows += [row for one in all_plans for row in arrival_rows(BEYOND, one, published=False)]
    rows += _convergence(runs) if paper else _short(runs)
    rows += _ablation(named) if paper else []
    return StudyReport(
        seeds=len(seeds),
        rows=rows,
        figures=figures([seeds[0] for seeds in drives if seeds[0].driver != RULES], runs),
        claims=CLAIMS,
        deviations=DEVIATIONS,
        remarks=remarks(rows, budget=order.budget),
    )


def fixed_rows() -> list[ReportRow]:
    """Rows of the rules, which neither learn nor draw."""
    drives = [drive_plan(plan, RULES, make_driver(RULES)) for plan in PLANS]
    return [row for one in drives for row in arrival_rows(TABLE, [one], published=False)]


def _drives(
    folder: Path, named: dict[str, list[SeedResult]], *, paper: bool
) -> tuple[list[list[NotchRun]], list[list[NotchRun]]]:
    """Drive the plans with every seed's network (and the PID at 130 s), and with the networks for all."""

    def paths(plan_id: str, driver: str = "improved_dqn") -> list[Path]:
        if not paper:
            return [shipped_policy_of(plan_id)]
        return _write_policies(folder, named[f"{driver}-{plan_id}"], driver, plan_id)

    if paper:
        paths("all", "dqn")
    drives = []
    for plan in PLANS:
        own = paths(plan.id)
        drives.append([drive_plan(plan, "improved_dqn", load_driver(path)) for path in own])
        if plan.id == "130":
            drives.append([track_policy(plan, path) for path in own])
        drives.append([drive_plan(plan, RULES, make_driver(RULES))])
    shared = [load_driver(path) for path in paths("all")]
    return drives, [[drive_plan(plan, "improved_dqn", one) for one in shared] for plan in PLANS]


def _write_policies(folder: Path, results: Sequence[SeedResult], driver: str, plan_id: str) -> list[Path]:
    """Write the policy of every seed, and that of the median seed under the name that is shipped."""
    cases = PLANS if plan_id == "all" else (plan_case(plan_id),)
    about = {"task": "lu2023", "plans": [plan.id for plan in cases]}
    write_policy(folder / f"{driver}-{plan_id}.safetensors", median_of(results, cases), COMMAND, **about)
    places = [folder / f"{driver}-{plan_id}-{one.job.seed}.safetensors" for one in results]
    return [write_policy(place, one, COMMAND, **about) for place, one in zip(places, results, strict=True)]


def _convergences(results: Sequence[SeedResult], plan_id: str, in_a_row: int = 1) -> list[Convergence]:
    from metropilot.studies.lu2023.learning import find_convergence, meet_demands

    plan = plan_case(plan_id)
    front = notch_front(plan)
    good = [meet_demands(r.history, plan.id, plan.scheduled_s, front) for r in results]
    return [find_convergence(r.history, met, in_a_row) for r, met in zip(results, good, strict=True)]


def _episode_rows(table: str, plan_id: str, driver: str, results: Sequence[SeedResult]) -> list[ReportRow]:
    from metropilot.studies.lu2023.learning import STEADY, median_episodes

    found, steady = _convergences(results, plan_id), _convergences(results, plan_id, STEADY)
    case, published = plan_case(plan_id).name, EPISODES.get((plan_id, driver))
    kpi = "episodes to convergence (Kaplan-Meier median)"
    share, kept = (100.0 * sum(run.converged for run in runs) / len(runs) for runs in (found, steady))
    return [
        ReportRow(table, case, driver, kpi, "", published=published, ours=median_episodes(found)),
        ReportRow(table, case, driver, "runs that converged", "%", ours=share),
        ReportRow(table, case, driver, "runs that were steady", "%", ours=kept),
    ]


def _convergence(runs: Runs) -> list[ReportRow]:
    from metropilot.studies.lu2023.learning import STEADY, speed_up

    rows: list[ReportRow] = []
    for plan_id, learners in runs.items():
        for driver, results in learners.items():
            rows += _episode_rows(CONVERGENCE, plan_id, driver, results)
        for in_a_row, words in ((1, "converges"), (STEADY, "is steady")):
            found = {driver: _convergences(each, plan_id, in_a_row) for driver, each in learners.items()}
            gain = speed_up(found["dqn"], found["improved_dqn"])
            said = FASTER_PERCENT if plan_id == "120" and in_a_row == 1 else None
            place = (CONVERGENCE, plan_case(plan_id).name, "improved_dqn")
            rows.append(ReportRow(*place, f"{words} faster than DQN", "%", said, gain.percent))
            rows.append(ReportRow(*place, f"p of that it {words} as fast as DQN (log-rank)", "", ours=gain.p))
    return rows


def _ablation(named: dict[str, list[SeedResult]]) -> list[ReportRow]:
    from metropilot.studies.lu2023.learning import IMPROVEMENTS

    rows = _episode_rows(ABLATION, ABLATED, "improved_dqn", named[f"improved_dqn-{ABLATED}"])
    for off in IMPROVEMENTS:
        name = f"without-{off}"
        rows += _episode_rows(ABLATION, ABLATED, name, named[f"{name}-{ABLATED}"])
    return rows


def _short(runs: Runs) -> list[ReportRow]:
    """Rows of a short run of each learner, as a check that learning works."""
    rows = []
    for plan_id, learners in runs.items():
        for driver, results in learners.items():
            row = ReportRow(
                "Short learning", plan_case(plan_id).name, driver, f"return after {QUICK_STEPS} steps", ""
            )
            rows.append(row.with_values([r.score for r in results]))
    return rows


STUDY = Study(
    id="lu2023",
    title="Notch driving by improved DQN (Lu and Liu 2023)",
    citation=CITATION,
    reproduce=reproduce,
    as_printed=AS_PRINTED,
    fixed_rows=fixed_rows,
)
