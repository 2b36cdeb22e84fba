"""The driving problem as a functional environment: features, actions, rewards, assists."""

from metropilot.env.action_kinds import ACTIONS
from metropilot.env.actions import AbstractAction
from metropilot.env.assists import Assists
from metropilot.env.config import DrivingConfig
from metropilot.env.driving import DriveState, DrivingTask, episode_of, starts
from metropilot.env.features import FEATURES, OBSERVERS
from metropilot.env.interface import AbstractTask, ActionSpace, Transition
from metropilot.env.policy_interface import PolicyInterface
from metropilot.env.randomization import DisturbanceDistribution, StartDistribution
from metropilot.env.registry import TASKS, make_task, task_config
from metropilot.env.rewards import TERMS, AbstractTerm

__all__ = [
    "ACTIONS",
    "FEATURES",
    "OBSERVERS",
    "TASKS",
    "TERMS",
    "AbstractAction",
    "AbstractTask",
    "AbstractTerm",
    "ActionSpace",
    "Assists",
    "DisturbanceDistribution",
    "DriveState",
    "DrivingConfig",
    "DrivingTask",
    "PolicyInterface",
    "StartDistribution",
    "Transition",
    "episode_of",
    "make_task",
    "starts",
    "task_config",
]
