"""The study: Table 5 and Figs. 6 to 9, convergence, ablation, and one network for all plans."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from metropilot.evaluate import make_driver
from metropilot.studies.learning import write_policy
from metropilot.studies.lu2023 import setting
from metropilot.studies.lu2023.as_printed import AS_PRINTED, R_V, P
from metropilot.studies.lu2023.drives import (
    ABOVE_ANY,
    ABOVE_GENTLE,
    SPAN_M,
    NotchRun,
    arrival_rows,
    drive_plan,
    load_driver,
    notch_front,
    policy_file,
    shipped_policy_of,
    track_policy,
)
from metropilot.studies.lu2023.figures import figures
from metropilot.studies.lu2023.learning import ALL_STEPS, LEARNING, RULE
from metropilot.studies.lu2023.ship import median_of
from metropilot.studies.report import ReportRow, StudyReport, make_row, paragraphs
from metropilot.studies.study import Study
from metropilot.studies.verdict import Claim
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot.studies.learning import SeedResult
    from metropilot.studies.lu2023.learning import Convergence
    from metropilot.studies.study import Order

STOP, LATE, ENERGY = "stopping error", "time error", "wheel traction energy"
PID = "pid_lu2023"
FASTER, CHANCE = "{} faster than DQN", "p of that it {} as fast as DQN (log-rank)"
CONVERGES, IS_STEADY = "converges", "is steady"
TO_CONVERGENCE, STEADY_SHARE = "episodes to convergence (Kaplan-Meier median)", "runs that were steady"


def _claim(plan: str, kpi: str, words: str) -> Claim:
    return Claim(
        f"{words}, {plan}", "improved_dqn", kpi, plan, rivals=(PID, setting.RULES), table=setting.TABLE
    )


CLAIMS = (
    *(
        _claim(plan.name, kpi, words)
        for plan in setting.PLANS
        for kpi, words in (
            (STOP, "improved DQN with the stop assist stops at the mark"),
            (LATE, "it keeps the time"),
            (ENERGY, "it saves energy"),
        )
    ),
    Claim(
        "improved DQN converges faster than DQN, 120 s",
        "improved_dqn",
        FASTER.format(CONVERGES),
        "120 s",
        "high",
        chance=CHANCE.format(CONVERGES),
    ),
)

DEVIATIONS = paragraphs(f"""
The stop is not learned. Station-stop braking follows the stop curve of the task's assist by the notches
of the paper: the one in force stays until the next stronger one is not too strong, or the next weaker one
nearly suffices. The network decides everything before it and may brake earlier. The paper does not
explain how its network stops within 0.3 m.

A notch that pulls is an upper bound: where it would accelerate by more than 0.8 m/s2, the paper's largest
acceleration, or come within 0.03 m/s of protection's permitted speed, the strongest notch that does not is
held, and a stronger one again where it can be for 2 s (after coasting 10 s). A choice after which the
trainset would come that near even by coasting is masked, as is what ends a decision below 1 m/s, short of the
stop: nobody waits on the way. The paper has rewards for both, and ends the episode above the limit.

A decision is held for 3 s of 0.2 s control periods; the paper transfers its state after 0.2 s and 0.1 m
(both are always exceeded here except at standstill), and discounts by 0.98 per transfer, so that the
arrival has no weight at departure. Here gamma is 1.

The state is position, speed and the time left, and quantities that follow from them and the line: the
filter's quantity (time left beyond the flat-out time to go, in three scalings) and the permitted speed
ahead. With (x, v, t) alone the same learner needed several times the updates.

Learning rate 1e-3 falling to 3e-5 with Adam instead of 1e-5; rewards divided by 200; observations
normalised by their running mean and deviation; a memory of 40,000; 0.5 gradient steps per decision over
eight parallel environments. Of these the paper gives only the learning rate. DQN and improved DQN use the
same values.

A network learns for {LEARNING.steps:,} decisions, about 6,000 episodes; the networks of the plan with the
restriction and of all plans for {ALL_STEPS:,}. Every seed is driven (five for all plans); the driver that is
shipped is the median seed.

Epsilon falls from 0.5 (paper: 0.8) to 0.05 over the first 30 % of the run.

Four episodes in ten start during the run, with a time left between the flat-out time and 1.5 times it, so
that a network meets every state; the paper starts each at the origin. Evaluations start from standstill.

Eq. 15 is learned with {setting.LATE_S:g} s instead of 3 s, and its bonus turns into a price over
{setting.SOFT_S:g} further seconds instead of at once: with 3 s at no price the arrival is as late as that
allows.

Work costs twice as much as in eq. 16 (mu = {setting.WORK_PER_J:g} instead of 1e-5 per J), and the stop
earns {setting.STOP_BONUS:g} instead of K = 1000, so that energy is a larger part of what the network has
to tell apart. Lateness costs more than the energy that it saves, for improved DQN and for plain DQN,
which has no filter to keep it from being late.

A change between traction, coasting and braking from one decision to the next costs {setting.SWITCH:g}, as
much as {setting.SWITCH / setting.WORK_PER_J / J_PER_KWH:.2f} kWh; the paper has no such price, and counts
them in Fig. 9. The last command is observed for it.

Eq. 18 prints P + a for gentle accelerations, which rewards acceleration: P - |a| here, P = {P:g}, L =
{-setting.JUMP:g} and a_lim = 0.8 m/s2 assumed; r_v = {R_V:g} assumed. L = -10 would make a pull where a
low limit ends cost as much as 1 % of the energy.

The flat-out time of the filter is that of the plant with resistance and limits, 3 % longer to keep clear
of protection; the paper's changes speed at once and has no resistance. It does not know the largest
acceleration, which costs up to 4 s where a policy waits as long as the filter lets it.

Prioritised replay draws by proportional priority with exponent 0.6 (paper: 1) and corrects by importance
weights (paper eq. 13: a learning rate per sample).

The trainset has the strongest notches, 180 and 149 kN, as its limits; the paper also names 203 and 166
kN.

The PID's gains are Cheng23's (3.4, 0.3, 0.2), since the paper gives none; the last metres use the
station-stop law.
""")


def remarks(rows: Sequence[ReportRow], *, budget: str) -> list[str]:
    """Findings as sentences made from the rows: medians over the seeds, the worst plan."""
    plans = [row for row in rows if row.table == setting.TABLE and row.driver == "improved_dqn"]
    pid = [row for row in rows if row.table == setting.TABLE and row.driver == PID]
    switches = f"most switches of regime in {SPAN_M:.0f} m"

    def worst(kpi: str, among: Sequence[ReportRow]) -> float:
        return max(
            (row.ours for row in among if row.kpi == kpi and row.ours is not None), default=float("nan")
        )

    stop, late, over = (worst(kpi, plans) for kpi in (STOP, LATE, "largest overspeed"))
    hard, jerk = worst("largest acceleration", plans), worst("largest jerk", plans)
    kept = "within" if hard <= setting.MOST_MPS2 + 0.005 else "beyond"

    def above(among: Sequence[ReportRow], kpi: str = ABOVE_GENTLE) -> str:
        found = {row.case: row.ours for row in among if row.kpi == kpi and row.ours is not None}
        return ", ".join(f"{value:.1f} % ({case})" for case, value in found.items())

    said = [
        (
            "Medians over the seeds: the plans of Table 5 stop within "
            f"{stop:.3f} m and {late:.1f} s, at most {over:.2f} m/s over the limit. They need more wheel "
            f"traction energy than the optimum over the notches within {setting.MOST_MPS2:g} m/s² by "
            f"{above(plans)}; than that with any acceleration by "
            f"{above(plans, ABOVE_ANY)}."
        ),
        (
            f"Their largest acceleration is {hard:.2f} m/s², {kept} the paper's {setting.MOST_MPS2:g}, their "
            f"largest jerk {jerk:.1f} m/s³, and they change between traction, coasting and braking at most "
            f"{worst(switches, plans):.0f} times in {SPAN_M:.0f} m (the paper's PID 13, here {PID} "
            f"{worst(switches, pid):.0f})."
        ),
    ]
    said.append(
        "That optimum (dynamic programming, `metropilot.studies.lu2023.notch_plan`) is within 1 % of the "
        "convex one over all forces: full traction, coasting and braking are notches."
    )
    said.append(
        "It is unclear whether the published kWh include braking work (eq. 16 does); both are listed."
    )
    beyond = [row for row in rows if row.table == setting.BEYOND]
    if beyond:
        said.append(
            "One network that observes the time left and the limits ahead drives all four plans "
            f"within {worst(STOP, beyond):.3f} m and {worst(LATE, beyond):.1f} s, "
            f"above that optimum by {above(beyond)}."
        )
    if budget == "paper":
        said.append(RULE)
        said.extend(_compare_convergence(rows))
    else:
        said.append("Quick: the plans are driven by shipped policies; convergence needs `--budget paper`.")
    alone = [plan.id for plan in setting.PLANS if not policy_file(f"improved_dqn-{plan.id}").is_file()]
    if budget != "paper" and alone:
        said.append(
            f"No network of a single plan is shipped for {', '.join(alone)}: the network for all "
            "plans is driven."
        )
    return said


def _compare_convergence(rows: Sequence[ReportRow]) -> list[str]:
    """Comparison of improved DQN with DQN, and of each improvement left out, by survival statistics."""
    ours = {(row.case, row.kpi): row.ours for row in rows if row.table == setting.CONVERGENCE}

    def faster(case: str, words: str) -> str:
        gain, p = (ours.get((case, kpi.format(words))) for kpi in (FASTER, CHANCE))
        share = "cannot be compared (a median is not reached)" if gain is None else f"{gain:+.0f} %"
        return f"{share}, " + ("too few for a test" if p is None else f"log-rank p = {p:.2g}")

    cases = dict.fromkeys(case for case, kpi in ours if kpi == FASTER.format(CONVERGES))
    found = [
        f"{case}: speed-up of improved DQN over DQN {faster(case, CONVERGES)}; to a steady run "
        f"{faster(case, IS_STEADY)}; published {setting.FASTER_PERCENT} % at 120 s."
        for case in cases
    ]
    alone = [row for row in rows if row.table == setting.ABLATION]
    for kpi, words, unit in (
        (TO_CONVERGENCE, "episodes to convergence", ""),
        (STEADY_SHARE, "runs that were steady", " %"),
    ):
        parts = [
            f"`{row.driver}` {row.ours:.0f}{unit}" for row in alone if row.kpi == kpi and row.ours is not None
        ]
        found += [f"Ablation, {words}: {', '.join(parts)}."] if parts else []
    return found


COMMAND = "metropilot reproduce lu2023 --budget paper"
QUICK_STEPS = 8_000
COMPARED = ("120", "130")
ABLATED = "120"
ABLATION_SEEDS = 5
ALL_SEEDS = 5
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
        plan_job(f"{prefix}{driver}", setting.plan_case(plan), seed, off, **short)
        for plan in compared
        for driver, off in LEARNERS.items()
        for seed in seeds
    ]
    if paper:
        few = range(min(len(seeds), ALL_SEEDS))
        jobs += [
            plan_job("improved_dqn", plan, seed, steps=ALL_STEPS if plan.restricted else LEARNING.steps)
            for plan in setting.PLANS
            if plan.id not in compared
            for seed in seeds
        ]
        jobs += [all_plans_job(driver, seed) for driver in LEARNERS for seed in few]
        jobs += [
            plan_job(f"without-{off}", setting.plan_case(ABLATED), seed, off)
            for off in IMPROVEMENTS
            for seed in range(min(len(seeds), ABLATION_SEEDS))
        ]
    results = order.learn(jobs, order.folder / "lu2023")
    named: dict[str, list[SeedResult]] = {}
    for result in results:
        named.setdefault(result.job.name.removeprefix("quick-"), []).append(result)
    runs: Runs = {plan: {driver: named[f"{driver}-{plan}"] for driver in LEARNERS} for plan in compared}
    drives, all_plans = _drives(order.folder / "lu2023", named, paper=paper)
    rows = [
        row
        for one in drives
        for row in arrival_rows(setting.TABLE, one, published=one[0].driver != setting.RULES)
    ]
    rows += [row for one in all_plans for row in arrival_rows(setting.BEYOND, one, published=False)]
    rows += _convergence(runs) if paper else _short(runs)
    rows += _ablation(named) if paper else []
    return StudyReport(
        seeds=len(seeds),
        rows=rows,
        figures=figures([seeds[0] for seeds in drives if seeds[0].driver != setting.RULES], runs),
        claims=CLAIMS,
        deviations=DEVIATIONS,
        remarks=remarks(rows, budget=order.budget),
    )


def fixed_rows() -> list[ReportRow]:
    """Rows of the rules, which neither learn nor draw."""
    drives = [drive_plan(plan, setting.RULES, make_driver(setting.RULES)) for plan in setting.PLANS]
    return [row for one in drives for row in arrival_rows(setting.TABLE, [one], published=False)]


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
    for plan in setting.PLANS:
        own = paths(plan.id)
        drives.append([drive_plan(plan, "improved_dqn", load_driver(path)) for path in own])
        if plan.id == "130":
            drives.append([track_policy(plan, path) for path in own])
        drives.append([drive_plan(plan, setting.RULES, make_driver(setting.RULES))])
    shared = [load_driver(path) for path in paths("all")]
    return drives, [[drive_plan(plan, "improved_dqn", one) for one in shared] for plan in setting.PLANS]


def _write_policies(folder: Path, results: Sequence[SeedResult], driver: str, plan_id: str) -> list[Path]:
    """Write the policy of every seed, and that of the median seed under the name that is shipped."""
    cases = setting.PLANS if plan_id == "all" else (setting.plan_case(plan_id),)
    about = {"task": "lu2023", "plans": [plan.id for plan in cases]}
    write_policy(folder / f"{driver}-{plan_id}.safetensors", median_of(results, cases), COMMAND, **about)
    places = [folder / f"{driver}-{plan_id}-{one.job.seed}.safetensors" for one in results]
    return [write_policy(place, one, COMMAND, **about) for place, one in zip(places, results, strict=True)]


def _convergences(results: Sequence[SeedResult], plan_id: str, in_a_row: int = 1) -> list[Convergence]:
    from metropilot.studies.lu2023.learning import find_convergence, meet_demands

    plan = setting.plan_case(plan_id)
    front = notch_front(plan)
    good = [meet_demands(r.history, plan.id, plan.scheduled_s, front) for r in results]
    return [find_convergence(r.history, met, in_a_row) for r, met in zip(results, good, strict=True)]


def _episode_rows(table: str, plan_id: str, driver: str, results: Sequence[SeedResult]) -> list[ReportRow]:
    from metropilot.studies.lu2023.learning import STEADY, median_episodes

    found, steady = _convergences(results, plan_id), _convergences(results, plan_id, STEADY)
    case, published = setting.plan_case(plan_id).name, setting.EPISODES.get((plan_id, driver))
    share, kept = (100.0 * sum(run.converged for run in runs) / len(runs) for runs in (found, steady))
    return [
        ReportRow(table, case, driver, TO_CONVERGENCE, "", published=published, ours=median_episodes(found)),
        ReportRow(table, case, driver, "runs that converged", "%", ours=share),
        ReportRow(table, case, driver, STEADY_SHARE, "%", ours=kept),
    ]


def _convergence(runs: Runs) -> list[ReportRow]:
    from metropilot.studies.lu2023.learning import STEADY, speed_up

    rows: list[ReportRow] = []
    for plan_id, learners in runs.items():
        for driver, results in learners.items():
            rows += _episode_rows(setting.CONVERGENCE, plan_id, driver, results)
        for in_a_row, words in ((1, CONVERGES), (STEADY, IS_STEADY)):
            found = {driver: _convergences(each, plan_id, in_a_row) for driver, each in learners.items()}
            gain = speed_up(found["dqn"], found["improved_dqn"])
            said = setting.FASTER_PERCENT if plan_id == "120" and in_a_row == 1 else None
            place = (setting.CONVERGENCE, setting.plan_case(plan_id).name, "improved_dqn")
            rows.append(ReportRow(*place, FASTER.format(words), "%", said, gain.percent))
            rows.append(ReportRow(*place, CHANCE.format(words), "", ours=gain.p))
    return rows


def _ablation(named: dict[str, list[SeedResult]]) -> list[ReportRow]:
    from metropilot.studies.lu2023.learning import IMPROVEMENTS

    rows = _episode_rows(setting.ABLATION, ABLATED, "improved_dqn", named[f"improved_dqn-{ABLATED}"])
    for off in IMPROVEMENTS:
        name = f"without-{off}"
        rows += _episode_rows(setting.ABLATION, ABLATED, name, named[f"{name}-{ABLATED}"])
    return rows


def _short(runs: Runs) -> list[ReportRow]:
    """Rows of a short run of each learner, as a check that learning works."""
    rows = []
    for plan_id, learners in runs.items():
        for driver, results in learners.items():
            place = ("Short learning", setting.plan_case(plan_id).name, driver)
            kpi, scores = f"return after {QUICK_STEPS} steps", [r.score for r in results]
            rows.append(make_row(*place, kpi, "", scores))
    return rows


STUDY = Study(
    id="lu2023",
    title="Notch driving by improved DQN (Lu and Liu 2023)",
    citation=setting.CITATION,
    reproduce=reproduce,
    as_printed=AS_PRINTED,
    fixed_rows=fixed_rows,
)
