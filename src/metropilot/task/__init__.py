"""The driving problem: what is to be driven, what may go wrong, and what a driver sees."""

from metropilot.task.guard import declared_bounds
from metropilot.task.interface import AbstractTask, ActionSpace, Transition
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

__all__ = [
    "CONTROL_PERIOD_S",
    "NOISE_CUT",
    "PUNCTUALITY_S",
    "STOP_TOLERANCE_M",
    "AbstractTask",
    "ActionSpace",
    "News",
    "Observation",
    "Outcome",
    "Run",
    "Scenario",
    "Transition",
    "declared_bounds",
]
