"""The study, start to end: learn, measure, compare with the paper and with the optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from metropilot.studies.chen2023a.as_printed import AS_PRINTED
from metropilot.studies.chen2023a.drives import (
    CONSTANT,
    DRIVING,
    EPISODES_KPI,
    HIGHEST_IMPACT,
    LEARNING,
    MOST_ENERGY,
    SHARE,
    LeastEnergy,
    constant_rows,
    course,
    final,
    find_convergences,
    outcome_rows,
    paper_rows,
)
from metropilot.studies.chen2023a.figures import figures
from metropilot.studies.chen2023a.learning import (
    DECISIONS,
    FIRST_COMMAND,
    LEARNERS,
    NAMES,
    TRIALS,
    TUNING_EPISODES,
    TUNING_SEEDS,
    ablations,
    jobs,
    set_length,
    trials,
)
from metropilot.studies.chen2023a.setting import (
    CITATION,
    CONVERGED_AT,
    EPISODES,
    PPO_EPISODES,
    PRESCRIBED_S,
    STOP_MPS2,
    THRESHOLD_S,
    UNASSISTED_TOLERANCE_M,
    make_assisted,
)
from metropilot.studies.report import ReportRow, StudyReport, paragraphs
from metropilot.studies.study import Study
from metropilot.studies.verdict import Claim
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot.learn import AbstractConfig
    from metropilot.studies.chen2023a.drives import DriveCourse
    from metropilot.studies.study import Order

CLAIMS = (
    Claim("plain PPO does not converge", "ppo", SHARE, LEARNING, "same"),
    Claim("PPO with reward scaling converges", "ppo_scaled", SHARE, LEARNING, "high"),
    Claim("the same, around episode 3,000", "ppo_scaled", EPISODES_KPI, LEARNING),
    Claim("DDPG converges", "ddpg", SHARE, LEARNING, "high"),
    Claim("the same, around episode 3,000", "ddpg", EPISODES_KPI, LEARNING),
    Claim("DDPG needs most energy", "ddpg", MOST_ENERGY, LEARNING, "same"),
    Claim("plain PPO, late, needs least energy", "ppo", MOST_ENERGY, LEARNING, "same"),
    Claim("DDPG has the highest impact rate", "ddpg", HIGHEST_IMPACT, LEARNING, "same"),
    Claim(
        "PPO with reward scaling drives best (return of the policy)",
        "ppo_scaled",
        "final return",
        DRIVING,
        "high",
        (CONSTANT,),
    ),
)

SEEDS = " and ".join(str(seed) for seed in TUNING_SEEDS)
DONE = ", ".join(f"{NAMES[name]} {len(trials(name))}" for name in LEARNERS)
DEVIATIONS = paragraphs(f"""
Section, trainset and speed limits are not printed. This study uses Yizhuang Bridge to Yizhuang Culture
Park of the Beijing Yizhuang line (993 m) and the 300 t trainset of the same group (Cheng et al. 2023),
with ideal actuation; 80 s prescribed and 88 s allowed as in the paper.

The paper does not state how the train brakes to the stop point, nor its stopping accuracy. Here the stop
assist makes the station-stop braking at {STOP_MPS2:g} m/s² for all three learners, and the speed limit is
kept (its eq. 12), so stopping errors are those of the assist. The table without it shows the learners
alone: they arrive when they stop within {UNASSISTED_TOLERANCE_M:g} m of the stop.

Coefficients of eqs. 16 and 17 are not printed: a kWh at the wheel costs 1, a change of acceleration of 1
m/s² costs 0.1, arrival within 8 s of 80 s gives 100, anything else -100.

A run that never arrives gets a further -100 and -0.1 for each metre left. The paper's train always
arrives; without this penalty standing still would be the best late run, and PPO finds it.

One decision a second; plant, assists and protection at 0.5 s. Protection supervises every step. Energy is
counted at the wheel, without efficiency (its eq. 3 less a constant factor).

All policies begin at a mean command of {FIRST_COMMAND:g}, so that some of the first episodes arrive in
time.

The learning settings are not printed. Those used come from random trials of {TUNING_EPISODES:,} episodes,
the defaults first, on seeds {SEEDS}, which appear in no table (`python -m benchmarks.chen2023a_tuning`,
{TRIALS} for each learner when complete). Trials made for these settings: {DONE}. PPO with and without
scaling tried the same settings.

A run has converged if from then on, in 95 % of the chunks (about 120 episodes each), the mean running
time of the episodes is at most 88 s and their mean return within 10 % of the final one. Final values are
medians over the last tenth of the learning.

Episodes are counted when they end; a run has the steps of the stated number of episodes of {DECISIONS}
decisions, so learners with short or long episodes end with slightly more or fewer.
""")


Courses = Mapping[str, Sequence["DriveCourse"]]
KINDS = ("learning", "driving")
"""Episodes with exploration, and drives without."""


def remarks(learned: Courses, changed: Courses) -> list[str]:
    """Findings as sentences with their numbers.

    Args:
        learned: Courses of the three learners.
        changed: Courses of the ablations; may be empty.
    """
    found = [_convergence_remark(name, mine) for name, mine in learned.items()]
    found.append(_lags(learned))
    found.append(_order(learned))
    if changed:
        found.append(_ablation(changed))
    return found


def _convergence_remark(name: str, mine: Sequence[DriveCourse]) -> str:
    at = [a for a in find_convergences(mine, "learning") if a is not None]
    said = f"around episode {CONVERGED_AT[name]:,.0f}" if name in CONVERGED_AT else f"not by {PPO_EPISODES:,}"
    when = f"; median {np.median(at):,.0f} episodes" if at else ""
    times = [final(one.driving["running_time_s"]) for one in mine]
    return (
        f"{NAMES[name]}: {len(at)} of {len(mine)} seeds converged by the rule below{when} "
        f"(the paper: {said}). The policy itself runs {np.median(times):.1f} s at the end "
        f"({sum(t <= THRESHOLD_S for t in times)} of {len(mine)} within {THRESHOLD_S:g} s)."
    )


def _lags(learned: Courses) -> str:
    """Comparison of plain with scaled PPO: converged seeds and final policies."""
    share, late = {}, {}
    for name in ("ppo", "ppo_scaled"):
        mine = learned[name]
        share[name] = [
            float(np.mean([at is not None for at in find_convergences(mine, kind)])) for kind in KINDS
        ]
        late[name] = float(np.median([final(one.driving["running_time_s"]) for one in mine]))
    numbers = ", ".join(
        f"{NAMES[name]} converges on {100 * share[name][0]:.0f} % of the seeds with exploration and on "
        f"{100 * share[name][1]:.0f} % without, and its median policy ends at {late[name]:.1f} s"
        for name in share
    )
    best = [
        f"{sum(float(np.max(one.driving['return'])) > 0.0 for one in learned[name])} of {len(learned[name])} "
        f"({NAMES[name]})"
        for name in share
    ]
    ahead = share["ppo_scaled"] >= share["ppo"] and late["ppo"] > THRESHOLD_S >= late["ppo_scaled"]
    word = "lags, as in the paper" if ahead else "does not clearly lag, unlike in the paper"
    return (
        f"Plain PPO {word}: {numbers}. The least energy is reached by arriving just within "
        f"{THRESHOLD_S:g} s; a policy that learns to save energy sometimes exceeds this limit, and "
        "its return falls by nearly 200 at once. Policies within the limit at their best evaluation: "
        f"{', '.join(best)}."
    )


def _order(learned: Courses) -> str:
    energy = {n: float(np.median([final(o.driving["energy_kwh"]) for o in m])) for n, m in learned.items()}
    order = sorted(energy, key=lambda name: -energy[name])
    words = ", ".join(f"{NAMES[name]} {energy[name]:.1f} kWh" for name in order)
    return (
        f"Energy of the policies themselves, most first: {words}. The paper has DDPG far above PPO with "
        "reward scaling, and plain PPO lowest because it is late."
    )


def _ablation(changed: Courses) -> str:
    parts = []
    for name in changed:
        if name.endswith(", plain"):
            what = name.removesuffix(", plain")
            plain, scaled = (
                np.median([final(o.driving["return"]) for o in changed[f"{what}, {kind}"]])
                for kind in ("plain", "scaled")
            )
            parts.append(f"{what}: {plain:.0f} plain, {scaled:.0f} scaled")
    return (
        "Effect of scaling: dividing the rewards by one number leaves normalised advantages "
        "unchanged, so it affects the actor only through the critic, whose error becomes of order "
        "one, and through the common bound on the gradient. Final return of the policy with one "
        f"thing changed at a time: {'; '.join(parts)}."
    )


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
    wanted = {name: set_length(config, *length) for name, config in configs.items()}
    todo = jobs(wanted, seeds, assisted=assisted, prefix=prefix)
    results = order.learn(todo)
    count = len(seeds)
    return {name: [course(r) for r in results[k * count : (k + 1) * count]] for k, name in enumerate(wanted)}


def _optimum() -> tuple[LeastEnergy, list[ReportRow]]:
    """Compute the certified front and the energy cost of the stop assist's braking."""
    from metropilot.planning import minimum_running_time, optima_of, optimal_plan

    (section, trainset), *_ = cases = make_assisted().config.cases
    least = LeastEnergy(optima_of(cases))
    gentle = replace(trainset, max_deceleration_mps2=STOP_MPS2)
    fastest = minimum_running_time(section, trainset)
    rows = [ReportRow(BOUNDS, "any", "flat_out", "minimum running time", "s", ours=fastest)]
    for time_s in (PRESCRIBED_S, THRESHOLD_S):
        best, soft = least(time_s), optimal_plan(section, gentle, time_s).energy_wheel_j / J_PER_KWH
        place = (BOUNDS, f"{time_s:g} s", "optimal")
        rows.append(ReportRow(*place, "least energy", "kWh", ours=best, optimum=best))
        kpi = f"least energy, braking at most {STOP_MPS2:g} m/s²"
        rows.append(ReportRow(*place, kpi, "kWh", ours=float(soft), optimum=best))
    return least, rows


STUDY = Study(
    id="chen2023a",
    title="Chen et al. 2023: PPO with reward scaling",
    citation=CITATION,
    reproduce=reproduce,
    as_printed=AS_PRINTED,
    fixed_rows=fixed_rows,
)
