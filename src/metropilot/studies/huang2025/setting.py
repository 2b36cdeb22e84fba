"""The task of the learners, the plant of the paper, and the runs of its cases."""

from __future__ import annotations

from dataclasses import replace

from metropilot.env import (
    AbstractAction,
    Assists,
    Comfort,
    DisturbanceDistribution,
    DrivingConfig,
    Energy,
    Failure,
    Intervention,
    Punctuality,
)
from metropilot.railway import Actuation, Restriction, Section, Trainset, load_line, load_trainset
from metropilot.sim import Disturbance, Run, TimetableUpdate
from metropilot.studies.huang2025.env import ExpertAction, ExpertChoiceAction
from metropilot.studies.huang2025.published import EITOP, PublishedCase

LINE, TRAINSET = "yizhuang-ttobench", "dkz32"
REWARDS = (
    Energy(),
    Punctuality(per_s=3.0, soft_s=0.5),
    Comfort(weight=0.2),
    Failure(price=20.0, per_m=0.05),
    Intervention(),
)
"""Huang25 eq. 26: energy, time error (eq. 27 at the end) and comfort; its weights are not printed."""
STOP_MPS2 = 0.95
"""Planned deceleration of the station stop."""
LEARNED_ON = (("RJ", "WYJ"), ("WYJ", "RJ"), ("XC", "XHM"), ("JG", "YZQ"))
"""Sections of the line that can be coasted to the end; the first is case 1."""
ON_THE_WAY = 0.7
"""Share of the episodes that begin between stations."""
DELAY_S, LAG_S = 0.6, 0.4
"""Dead time and time constant of its eq. 4 (assumed: no value can be read)."""
GENTLE_MPS2 = {EITOP: 0.8}
"""Largest acceleration by driver; all other expert drivers keep rule 2."""
RULE2_MPS2 = 0.6
FREE = ("manual", "optimal", "flat_out")
"""Drivers that keep only the trainset's own limit of 1 m/s^2."""


def task_config() -> DrivingConfig:
    """Task ``huang2025``: the policy inside the expert changes the rate by a continuous value."""
    return _task_config(ExpertAction())


def choice_task_config() -> DrivingConfig:
    """Task ``huang2025_choices``: the policy selects one of three changes of the rate."""
    return _task_config(ExpertChoiceAction())


def gentle(config: DrivingConfig) -> DrivingConfig:
    """Limit the acceleration by the paper's second rule."""
    return replace(config, action=ExpertAction(start_mps2=RULE2_MPS2))


def _task_config(action: AbstractAction) -> DrivingConfig:
    line = load_line(LINE)
    return DrivingConfig(
        sections=tuple(line.section(*ends) for ends in LEARNED_ON),
        trainsets=(load_trainset(TRAINSET),),
        scenarios=DisturbanceDistribution(time_ratio=(1.08, 1.45), news=0.2, on_the_way=ON_THE_WAY),
        observer=("expert",),
        action=action,
        rewards=REWARDS,
        assists=Assists(stop_mps2=STOP_MPS2),
    )


def trainset() -> Trainset:
    """DKZ32, empty, with the actuation of eq. 4 and no other limit on the change of effort."""
    return replace(load_trainset(TRAINSET), actuation=Actuation(DELAY_S, LAG_S, float("inf")))


def section(case: PublishedCase) -> Section:
    """Section of a case."""
    return load_line(LINE).section(case.origin, case.destination)


def run_of(case: PublishedCase, seed: int = 0) -> Run:
    """Run of a case, with its timetable update."""
    news: tuple[TimetableUpdate, ...] = ()
    if case.told_s is not None:
        told = case.restricted
        restriction = Restriction(told.from_m, told.to_m, told.limit_mps) if told else None
        news = (TimetableUpdate(case.told_s, scheduled_time_s=case.news_s, restriction=restriction),)
    return Run(section(case), trainset(), case.scheduled_s, Disturbance(updates=news), seed=seed)


def comfortable(driver: str, plant: Trainset) -> Trainset:
    """Trainset with a driver's comfort limits, for its optimum."""
    if driver in FREE:
        return plant
    return replace(plant, max_acceleration_mps2=GENTLE_MPS2.get(driver, RULE2_MPS2))
