"""The study, start to end: learn, measure, compare with the paper and with the optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from metropilot.studies.chen2023a.as_printed import AS_PRINTED
from metropilot.studies.chen2023a.drives import LeastEnergy, constant_rows, outcome_rows, paper_rows
from metropilot.studies.chen2023a.figures import figures
from metropilot.studies.chen2023a.setting import CITATION, EPISODES, PRESCRIBED_S, THRESHOLD_S
from metropilot.studies.chen2023a.words import CLAIMS, DEVIATIONS, remarks
from metropilot.studies.report import ReportRow, StudyReport
from metropilot.studies.study import Study
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot.learn import AbstractConfig
    from metropilot.studies.chen2023a.drives import DriveCourse
    from metropilot.studies.study import Order

ABLATION = "Beyond the paper: what reward scaling changes"
UNASSISTED = "Beyond the paper: the policy brakes to the stop by itself"
BOUNDS = "Beyond the paper: what the section allows"


@dataclass(frozen=True)
class Size:
    """Amount of learning in a budget.

    Attributes:
        seeds: Seeds of each of the three learners.
        episodes: Episodes of each run.
        chunks: Approximate number of points of a learning curve.
        more_seeds: Seeds of the ablations and of the runs without the stop assist.
        more_episodes: Episodes of those runs; 0: they are left out.
    """

    seeds: int
    episodes: int
    chunks: int
    more_seeds: int = 0
    more_episodes: int = 0


SIZES = {"quick": Size(1, 1_500, 30), "paper": Size(5, EPISODES, 170, 2, 5_000)}


def reproduce(order: Order) -> StudyReport:
    """Reproduce figures 5 to 19 and the comparisons beyond the paper.

    Args:
        order: ``quick``: one seed, 1,500 episodes of the three learners. ``paper``: five seeds, 20,000
            episodes, the ablations and the runs without the stop assist.
    """
    from metropilot.studies.chen2023a.learning import LEARNERS, ablations

    size = SIZES[order.budget]
    seeds = order.choose_seeds(quick=size.seeds, paper=size.seeds)
    learned = _courses(order, LEARNERS, (size.episodes, size.chunks), seeds)
    least, bounds = _optimum()
    rows = paper_rows(learned, least)
    changed: Mapping[str, Sequence[DriveCourse]] = {}
    if size.more_episodes:
        few, short = range(min(len(seeds), size.more_seeds)), (size.more_episodes, size.chunks // 2)
        changed = _courses(order, ablations(), short, few, prefix="ablation-")
        rows += outcome_rows(ABLATION, changed)
        alone = _courses(order, LEARNERS, short, few, assisted=False, prefix="unassisted-")
        rows += outcome_rows(UNASSISTED, alone)
    rows += [*bounds, *constant_rows()]
    drawn = figures(learned, least(THRESHOLD_S) or 0.0)
    said = remarks(learned, changed)
    return StudyReport(len(seeds), rows, drawn, DEVIATIONS, said, CLAIMS)


def fixed_rows() -> list[ReportRow]:
    """Rows of the plans and of the constant command, which neither learn nor draw."""
    return [*_optimum()[1], *constant_rows()]


def _courses(
    order: Order,
    configs: Mapping[str, AbstractConfig],
    length: tuple[int, int],
    seeds: Sequence[int],
    *,
    assisted: bool = True,
    prefix: str = "",
) -> dict[str, list[DriveCourse]]:
    """Learn every configuration with every seed; return the courses by name."""
    from metropilot.studies.chen2023a.drives import course
    from metropilot.studies.chen2023a.learning import jobs, set_length

    wanted = {name: set_length(config, *length) for name, config in configs.items()}
    todo = jobs(wanted, seeds, assisted=assisted, prefix=prefix)
    results = order.learn(todo)
    count = len(seeds)
    return {name: [course(r) for r in results[k * count : (k + 1) * count]] for k, name in enumerate(wanted)}


def _optimum() -> tuple[LeastEnergy, list[ReportRow]]:
    """Compute the certified front and the energy cost of the stop assist's braking."""
    from metropilot.planning import minimum_running_time, optima_of, optimal_plan
    from metropilot.studies.chen2023a.setting import STOP_MPS2, make_assisted

    (section, trainset), *_ = cases = make_assisted().config.cases
    least = LeastEnergy(optima_of(cases))
    gentle = replace(trainset, max_deceleration_mps2=STOP_MPS2)
    rows = [
        ReportRow(
            BOUNDS,
            "any",
            "flat_out",
            "minimum running time",
            "s",
            ours=minimum_running_time(section, trainset),
        )
    ]
    for time_s in (PRESCRIBED_S, THRESHOLD_S):
        case = f"{time_s:g} s"
        rows.append(
            ReportRow(
                BOUNDS, case, "optimal", "least energy", "kWh", ours=least(time_s), optimum=least(time_s)
            )
        )
        soft = optimal_plan(section, gentle, time_s).energy_wheel_j / J_PER_KWH
        kpi = f"least energy, braking at most {STOP_MPS2:g} m/s²"
        rows.append(ReportRow(BOUNDS, case, "optimal", kpi, "kWh", ours=float(soft), optimum=least(time_s)))
    return least, rows


STUDY = Study(
    id="chen2023a",
    title="Chen et al. 2023: PPO with reward scaling",
    citation=CITATION,
    reproduce=reproduce,
    as_printed=AS_PRINTED,
    fixed_rows=fixed_rows,
)
