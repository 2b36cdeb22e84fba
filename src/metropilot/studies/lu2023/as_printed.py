"""DQN and improved DQN with the paper's own state, rewards, rates and steps, and without assists."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from metropilot.env import Assists, DisturbanceDistribution, DrivingTask, OnTime
from metropilot.studies.learning import LearnJob
from metropilot.studies.lu2023 import env, setting
from metropilot.studies.lu2023.learning import IMPROVED, LEARNING
from metropilot.studies.report import PrintedSetting, ReportRow, make_row
from metropilot.studies.study import AsPrinted, LiteralRun, Order

if TYPE_CHECKING:
    from metropilot.learn import DQNConfig
    from metropilot.studies.learning import SeedResult

PLAN, DRIVERS = "120", {"improved_dqn": True, "dqn": False}
"""The plan for which the paper compares both learners, and which of them is improved."""
BIG, P, L, R_V = 1000.0, 1.0, 10.0, 0.01
RATE, GAMMA, EPSILON = 1e-5, 0.98, 0.8
CUT = {"quick": 20, "paper": 1_500}
"""Episodes; the paper prints only when the reward settles, after 800 and 1,100."""
DECISIONS = round(setting.plan_case(PLAN).scheduled_s / env.CONTROL_S)
MOST_DECISIONS = 1_000
SEEDS = 1


def literal_task(*, filtered: bool) -> DrivingTask:
    """The paper's task: position, speed and time; twelve forces; eqs. 15 to 20; no assist."""
    plan = setting.plan_case(PLAN)
    rewards = (
        OnTime(bonus=BIG, allowed_s=3.0),
        env.EffortEnergy(),
        env.StopWindow(bonus=BIG),
        env.AccelerationComfort(bonus=P, jump_price=L, literal=True),
        env.Moving(bonus=R_V),
    )
    config = replace(
        setting.task_config(),
        sections=(plan.section,),
        scenarios=DisturbanceDistribution(time_s=(plan.scheduled_s, plan.scheduled_s)),
        observer="position_speed_time",
        action=env.NotchForceAction(in_time=filtered, margin=0.0),
        rewards=rewards,
        assists=Assists(stop=False, ceiling=False),
        periods=1,
        most_decisions=MOST_DECISIONS,
    )
    return DrivingTask(config)


def literal_config(budget: str, *, improved: bool) -> DQNConfig:
    """DQN with the paper's Table 4; what it does not print is this study's."""
    from metropilot.learn import Schedule

    changes = IMPROVED if improved else {}
    evaluations = 5 if budget == "quick" else 20
    return replace(
        LEARNING,
        steps=CUT[budget] * DECISIONS,
        evaluations=evaluations,
        evaluation_steps=MOST_DECISIONS,
        learning_rate=RATE,
        gamma=GAMMA,
        epsilon=Schedule(EPSILON, 0.05, over=0.3, shape="exponential"),
        reward_factor=1.0,
        n_step=1,
        huber=None,
        normalise_observations=False,
        **changes,
    )


def jobs(seeds: Iterable[int], budget: str) -> list[LearnJob]:
    """Learning runs of the printed settings, learners varying slowest."""
    from metropilot.studies.lu2023.learning import drive_plans

    seeds = list(seeds)
    found = []
    for driver, improved in DRIVERS.items():
        config = literal_config(budget, improved=improved)
        task = partial(literal_task, filtered=improved)
        evaluation = partial(drive_plans, (setting.plan_case(PLAN),), config)
        about = {"plan": PLAN, "filter": improved}
        name = f"as-printed-{budget}-{driver}-{PLAN}"
        found += [LearnJob(name, config, task, seed, evaluation, about) for seed in seeds]
    return found


def measure(order: Order) -> LiteralRun:
    """Learn with the printed settings; the policy kept drives the plan from standstill."""
    seeds = order.choose_seeds(quick=SEEDS, paper=SEEDS)[:SEEDS]
    results = order.learn(jobs(seeds, order.budget), order.folder / "lu2023")
    rows: list[ReportRow] = []
    for k, driver in enumerate(DRIVERS):
        rows += _rows(driver, results[k * len(seeds) : (k + 1) * len(seeds)])
    settled = setting.EPISODES[PLAN, "improved_dqn"], setting.EPISODES[PLAN, "dqn"]
    length = (
        f"{len(seeds)} seed of {CUT[order.budget]:,} episodes each; the paper's rewards settle after "
        f"{settled[0]:,.0f} (improved DQN) and {settled[1]:,.0f} (DQN)."
    )
    return LiteralRun(rows, [length])


def _rows(driver: str, results: Sequence[SeedResult]) -> list[ReportRow]:
    kept = [result.kept for result in results]

    def values_of(column: str) -> list[float]:
        values = [result.history[f"evaluation.{PLAN}.{column}"] for result in results]
        return [float(each[k]) for each, k in zip(values, kept, strict=True)]

    row = partial(make_row, setting.TABLE, setting.plan_case(PLAN).name, driver)
    return [
        row("drives that stand within 0.3 m of the stop", "%", [100.0 * one for one in values_of("arrived")]),
        row("stopping error", "m", [abs(one) for one in values_of("stop_m")]),
        row("time error", "s", [abs(one) for one in values_of("late_s")]),
        row("wheel traction energy", "kWh", values_of("kwh")),
        row("largest overspeed", "m/s", values_of("over_mps")),
    ]


SETTINGS = (
    PrintedSetting(
        "state (3.3.1)",
        "position, speed, running time",
        "position, speed, time left, reserve over the flat-out run, limits ahead, last command",
    ),
    PrintedSetting(
        "decision (Table 4)",
        f"every {env.CONTROL_S:g} s and 0.1 m",
        f"every {setting.PERIOD_S:g} s",
        f"every {env.CONTROL_S:g} s; below 0.5 m/s the trainset goes less than 0.1 m in it.",
    ),
    PrintedSetting(
        "assists",
        "none",
        "station stop, ceiling below the permitted speed",
        "protection supervises; the paper leaves safety to it.",
    ),
    PrintedSetting(
        "comfort (eq. 18)",
        "P + a within 0.8 m/s², L after a jump",
        f"P - |a| within 0.8 m/s², {-setting.JUMP:g} after a jump",
        f"P = {P:g}, L = {-L:g} and r_v = {R_V:g} are not printed; L is called a large negative reward.",
    ),
    PrintedSetting(
        "lateness allowed (eq. 15)",
        "3 s",
        f"{setting.LATE_S:g} s while learning, then a price",
    ),
    PrintedSetting(
        "price of work, bonuses of time and stop (eqs. 15 to 17)",
        "1e-5 per J, 1000 each",
        f"{setting.WORK_PER_J:g} per J, {setting.TIME_BONUS:g} and {setting.STOP_BONUS:g}",
    ),
    PrintedSetting(
        "filter (3.3.4)",
        "accelerate to the limit, hold it, brake",
        f"flat-out time of the plant and {100 * setting.MARGIN:g} %",
        "flat-out time of the plant without a margin; the paper calls leaving out the resistance a flaw.",
    ),
    PrintedSetting("learning rate, discount, first epsilon", "1e-5, 0.98, 0.8", "1e-3 to 3e-5, 1, 0.5"),
    PrintedSetting("loss (eq. 6)", "half the square of the error", "the same within 2, linear beyond"),
    PrintedSetting("rewards and state of the network", "as they are", "rewards over 200, state normalised"),
    PrintedSetting(
        "start of an episode",
        "standstill at the station",
        f"{100 * setting.ON_THE_WAY:g} % of them on the way",
    ),
    PrintedSetting(
        "episodes",
        "not printed; settled after 800 and 1,100",
        f"{LEARNING.steps:,} decisions",
        f"{CUT['paper']:,} (quick: {CUT['quick']}).",
    ),
    PrintedSetting(
        "batch, memory, target period, decay of epsilon, policy kept",
        "not printed",
        "see hyper-parameters; best of the evaluations",
        "those of this study.",
    ),
)

AS_PRINTED = AsPrinted(SETTINGS, measure)
