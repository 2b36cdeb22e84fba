"""The three learners with the paper's own rewards, start and end of the run, and without assists."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, final

from metropilot.env import AbstractTerm, Assists, Comfort, CommandAction, DrivingTask, Energy
from metropilot.physics import namespace
from metropilot.sim import Outcome
from metropilot.studies.chen2023a import drives
from metropilot.studies.chen2023a.learning import FIRST_COMMAND, LEARNERS, NAMES, set_length
from metropilot.studies.chen2023a.setting import (
    ALLOWED_S,
    COMFORT,
    EPISODES,
    PRESCRIBED_S,
    SOFT_S,
    THRESHOLD_S,
    UNASSISTED_TOLERANCE_M,
    make_evaluation,
    task_config,
)
from metropilot.studies.learning import LearnJob
from metropilot.studies.report import PrintedSetting, ReportRow, make_row
from metropilot.studies.study import AsPrinted, LiteralRun, Order

if TYPE_CHECKING:
    from metropilot._typing import Scalar
    from metropilot.env import PeriodChange
    from metropilot.learn import AbstractConfig

BIG = 100.0
CUT = {"quick": 200, "paper": EPISODES}
CHUNKS = {"quick": 10, "paper": 170}
SEEDS = 1
SETTING = 2
"""Version of the task; increment it when the task changes, so that stored runs are repeated."""
SPEED = "speed at the end"


@final
@dataclass(frozen=True)
class OnTimeAtDestination(AbstractTerm):
    """Bonus for reaching the destination in time, at any speed, its negative for any other end.

    Attributes:
        bonus: The bonus (Chen23a eq. 17).
        allowed_s: Largest deviation that earns it.
    """

    name = "on_time"
    bonus: float = BIG
    allowed_s: float = ALLOWED_S

    def value(self, change: PeriodChange) -> Scalar:
        """Plus or minus the bonus, at the end only."""
        xp = namespace(change.late_s)
        won = (change.error_m >= 0.0) & (xp.abs(change.late_s) <= self.allowed_s)
        return xp.where(change.ended, xp.where(won, self.bonus, -self.bonus), 0.0 * change.late_s)


def literal_task() -> DrivingTask:
    """The paper's task: eqs. 10 to 17 alone; a run ends where the trainset reaches the destination."""
    rewards = (Energy(), Comfort(weight=COMFORT), OnTimeAtDestination())
    config, bare = task_config(), Assists(stop=False, ceiling=False)
    rule = replace(config.outcomes, tolerance_m=0.0, give_up_m=0.0, stalled_s=float("inf"))
    action = CommandAction()
    return DrivingTask(replace(config, action=action, rewards=rewards, assists=bare, outcomes=rule))


def literal_configs(budget: str) -> dict[str, AbstractConfig]:
    """The three learners at this study's settings, over the paper's number of episodes (quick: cut short)."""
    return {name: set_length(config, CUT[budget], CHUNKS[budget]) for name, config in LEARNERS.items()}


def jobs(seeds: Iterable[int], budget: str) -> list[LearnJob]:
    """Learning runs of the printed settings, learners varying slowest."""
    seeds = list(seeds)
    return [
        LearnJob(
            f"as-printed-{budget}-{name}",
            config,
            literal_task,
            seed,
            partial(make_evaluation, config, end=Outcome.OVERSHOT),
            {"task": literal_task.__name__, "setting": SETTING},
        )
        for name, config in literal_configs(budget).items()
        for seed in seeds
    ]


def measure(order: Order) -> LiteralRun:
    """Learn with the printed settings; the figures' numbers beside those of the study."""
    seeds = order.choose_seeds(quick=SEEDS, paper=SEEDS)[:SEEDS]
    results = order.learn(jobs(seeds, order.budget))
    runs = {name: results[k * len(seeds) : (k + 1) * len(seeds)] for k, name in enumerate(LEARNERS)}
    courses = {name: [drives.course(result) for result in mine] for name, mine in runs.items()}
    found = (
        *drives.reward_rows(courses),
        *drives.time_rows(courses),
        *drives.energy_rows(courses, lambda time_s: None),  # noqa: ARG005 (no optimum without a stop)
        *drives.impact_rows(courses),
    )
    rows = [row for row in found if row.case == drives.LEARNING and row.ours is not None]
    for name, mine in runs.items():
        for table, kpi, unit, column in (
            (drives.TIME, "final running time", "s", "running_time_s"),
            (drives.STOP, SPEED, "m/s", "end_mps"),
        ):
            values = [drives.final(result.history[f"evaluation.{column}"]) for result in mine]
            rows.append(make_row(table, drives.DRIVING, name, kpi, unit, values))
    cut = f"{len(seeds)} seed of {CUT[order.budget]:,} episodes each; the paper has {EPISODES:,}."
    return LiteralRun(rows, [cut, _finding(rows)])


def _finding(rows: Sequence[ReportRow]) -> str:
    """Sentence on the end of the policies' runs."""
    value = {(row.driver, row.kpi): row.ours for row in rows if row.case == drives.DRIVING}
    told = ", ".join(
        f"{NAMES[name]} at {value[name, SPEED]:.1f} m/s after {value[name, 'final running time']:.0f} s"
        for name in LEARNERS
    )
    return (
        "Nothing in eqs. 10 to 17 makes the trainset stop, only protection brakes before the platform; the "
        f"policies end their runs so: {told}."
    )


SETTINGS = (
    PrintedSetting(
        "state and action (eqs. 10 to 12)",
        "position and speed; share of the available force",
        "the same; an action up to 0.2 coasts, one from 0.8 on is full effort",
        "protection keeps the speed within the limit (eq. 12), by braking.",
    ),
    PrintedSetting(
        "assists",
        "none",
        "station stop as late as the brakes allow, ceiling below the speed limit",
    ),
    PrintedSetting(
        "end of a run",
        "arrival at the destination",
        "standstill at the stop",
        "no condition on the speed is printed, so a run ends where the position reaches the destination; the "
        f"table beyond the paper has policies that must stand within {UNASSISTED_TOLERANCE_M:g} m of it.",
    ),
    PrintedSetting(
        "reward (eqs. 16 and 17)",
        "energy, comfort, ± a large number at arrival",
        f"the same, but over {SOFT_S:g} s beyond the time allowed the bonus turns into its negative; and a "
        "price of runs that never arrive",
        f"no coefficient is printed: those of this study ({COMFORT:g} for comfort, {BIG:g} at the end). "
        f"A run that has not arrived {1.25 * PRESCRIBED_S + 30:g} s after departure ends like a late one.",
    ),
    PrintedSetting(
        "time",
        f"{PRESCRIBED_S:g} s, at most {THRESHOLD_S:g} s",
        "the same",
    ),
    PrintedSetting(
        "decision period (eq. 15)",
        "not printed",
        "1 s",
        "that of this study.",
    ),
    PrintedSetting(
        "section, trainset, sizes of the networks, rates, first command",
        "not printed",
        f"see hyper-parameters; {FIRST_COMMAND:g}",
        "those of this study.",
    ),
    PrintedSetting("episodes", f"{EPISODES:,}, one run of each learner", f"{EPISODES:,}, several seeds"),
)

AS_PRINTED = AsPrinted(SETTINGS, measure)
