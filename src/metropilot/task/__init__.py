"""The driving problem: what is to be driven, what may go wrong, and what a driver sees."""

from metropilot.task.action_kinds import ACTIONS
from metropilot.task.actions import AbstractAction
from metropilot.task.assist import Assists
from metropilot.task.config import DrivingConfig
from metropilot.task.driving import DriveState, DrivingTask, episode_of, starts
from metropilot.task.guard import declared_bounds
from metropilot.task.interface import AbstractTask, ActionSpace, Transition
from metropilot.task.observers import FEATURES, OBSERVERS
from metropilot.task.outcomes import CODES, RUNNING, Episode, OutcomeRule
from metropilot.task.perception import Perception
from metropilot.task.registry import TASKS, make_task, task_config
from metropilot.task.rewards import TERMS, AbstractTerm
from metropilot.task.run import (
    CONTROL_PERIOD_S,
    NOISE_CUT,
    PUNCTUALITY_S,
    STOP_TOLERANCE_M,
    News,
    Observation,
    Outcome,
    Run,
    Scenario,
)
from metropilot.task.scenarios import Scenarios, Start

__all__ = [
    "ACTIONS",
    "CODES",
    "CONTROL_PERIOD_S",
    "FEATURES",
    "NOISE_CUT",
    "OBSERVERS",
    "PUNCTUALITY_S",
    "RUNNING",
    "STOP_TOLERANCE_M",
    "TASKS",
    "TERMS",
    "AbstractAction",
    "AbstractTask",
    "AbstractTerm",
    "ActionSpace",
    "Assists",
    "DriveState",
    "DrivingConfig",
    "DrivingTask",
    "Episode",
    "News",
    "Observation",
    "Outcome",
    "OutcomeRule",
    "Perception",
    "Run",
    "Scenario",
    "Scenarios",
    "Start",
    "Transition",
    "declared_bounds",
    "episode_of",
    "make_task",
    "starts",
    "task_config",
]
