"""The task of the study: twelve notches, Lu23's rewards and its minimum-arrival-time filter."""

from __future__ import annotations

from dataclasses import replace

from metropilot.env import (
    DisturbanceDistribution,
    DrivingConfig,
    DrivingTask,
    OnTime,
)
from metropilot.railway import load_line, load_trainset
from metropilot.studies.lu2023.env import (
    AccelerationComfort,
    EffortEnergy,
    Moving,
    NotchForceAction,
    StopWindow,
)
from metropilot.studies.lu2023.published import PlanCase

TRAINSET, NOTCHES = "lu2023", "lu2023"
LINES = ("lu2023", "lu2023-restricted")
"""The section without and with 55 km/h from 600 to 930 m."""
PERIOD_S, CONTROL_S = 3.0, 0.2
MARGIN = 0.06
"""Relative margin on the filter's flat-out time: the distance to protection costs 4 to 5 %."""
IN_HAND_S = 0.5
"""Reduction of the permitted lateness (3 s) during learning."""
ALL_TIMES_S = (118.0, 142.0)
ON_THE_WAY, LEFT_RATIO = 0.8, (1.0, 1.7)
"""Share of episodes that begin between stations, and their range of time left over flat-out time to go."""
REWARDS = (
    OnTime(bonus=1000.0, allowed_s=3.0 - IN_HAND_S),
    EffortEnergy(),
    StopWindow(),
    AccelerationComfort(),
    Moving(),
)
"""Lu23 eqs. 15 to 20."""
STATE = ("position", "speed", "time_left", "reserve", "permitted_ahead")
"""Position, speed, time left, the filter's reserve (time left beyond flat-out time to go), limits ahead."""


def task_config() -> DrivingConfig:
    """Task ``lu2023``: both lines, running times of all plans, time left and limits ahead observed."""
    return DrivingConfig(
        sections=tuple(load_line(line).section("WHY", "WYJ") for line in LINES),
        trainsets=(load_trainset(TRAINSET),),
        scenarios=_times(ALL_TIMES_S),
        observer=STATE,
        action=NotchForceAction(in_time=True, margin=MARGIN),
        rewards=REWARDS,
        dt=CONTROL_S,
        periods=round(PERIOD_S / CONTROL_S),
        most_decisions=75,
    )


def without_filter(config: DrivingConfig) -> DrivingConfig:
    """Remove the minimum-arrival-time filter from a task."""
    return replace(config, action=NotchForceAction(in_time=False, margin=MARGIN))


def plan_task(plan: PlanCase, *, filtered: bool) -> DrivingTask:
    """Make the task of one plan, as in the paper: one line, one scheduled time."""
    config = task_config() if filtered else without_filter(task_config())
    section = load_line(plan.line).section("WHY", "WYJ")
    return DrivingTask(
        replace(config, sections=(section,), scenarios=_times((plan.scheduled_s, plan.scheduled_s)))
    )


def _times(times_s: tuple[float, float]) -> DisturbanceDistribution:
    return DisturbanceDistribution(time_s=times_s, on_the_way=ON_THE_WAY, left_ratio=LEFT_RATIO)
