"""Drivers that learn: DQN, PPO, DDPG, SAC, NAF and tabular Q-learning, each run one compiled program.

The door is lazy: reading a policy or listing runs does not import JAX.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from metropilot.drivers.policy.policy import Policy, PolicySpec, act
    from metropilot.drivers.policy.policy_file import load_policy, save_policy
    from metropilot.home import runs_folder
    from metropilot.learn.compile_cache import keep_compiled
    from metropilot.learn.config import (
        CONFIGS,
        DDPGConfig,
        DQNConfig,
        NAFConfig,
        PPOConfig,
        SACConfig,
        TabularConfig,
    )
    from metropilot.learn.config_base import AbstractConfig
    from metropilot.learn.config_reading import config_from_mapping, config_to_mapping
    from metropilot.learn.driving import DrivingEvaluation
    from metropilot.learn.export import ExportReport, export_onnx
    from metropilot.learn.history import read_history, write_history
    from metropilot.learn.loop import Loop, LoopState, default_evaluation, learn, make_loop
    from metropilot.learn.recipes import RECIPES, Recipe, evaluation_of, new_request, recipe, resumed_request
    from metropilot.learn.recorded import RunRequest, begin_run, learn_run
    from metropilot.learn.runs import RunRecord, RunStore
    from metropilot.learn.schedules import Schedule
    from metropilot.learn.session import Learned, Progress, Sitting, learn_in_chunks

__all__ = [
    "CONFIGS",
    "RECIPES",
    "AbstractConfig",
    "DDPGConfig",
    "DQNConfig",
    "DrivingEvaluation",
    "ExportReport",
    "Learned",
    "Loop",
    "LoopState",
    "NAFConfig",
    "PPOConfig",
    "Policy",
    "PolicySpec",
    "Progress",
    "Recipe",
    "RunRecord",
    "RunRequest",
    "RunStore",
    "SACConfig",
    "Schedule",
    "Sitting",
    "TabularConfig",
    "act",
    "begin_run",
    "config_from_mapping",
    "config_to_mapping",
    "default_evaluation",
    "evaluation_of",
    "export_onnx",
    "keep_compiled",
    "learn",
    "learn_in_chunks",
    "learn_run",
    "load_policy",
    "make_loop",
    "new_request",
    "read_history",
    "recipe",
    "resumed_request",
    "runs_folder",
    "save_policy",
    "write_history",
]

_HOME = {
    "AbstractConfig": "config_base",
    "DrivingEvaluation": "driving",
    "ExportReport": "export",
    "Learned": "session",
    "Loop": "loop",
    "LoopState": "loop",
    "Policy": "metropilot.drivers.policy.policy",
    "PolicySpec": "metropilot.drivers.policy.policy",
    "Progress": "session",
    "RECIPES": "recipes",
    "Recipe": "recipes",
    "RunRecord": "runs",
    "RunRequest": "recorded",
    "RunStore": "runs",
    "Schedule": "schedules",
    "Sitting": "session",
    "act": "metropilot.drivers.policy.policy",
    "begin_run": "recorded",
    "config_from_mapping": "config_reading",
    "config_to_mapping": "config_reading",
    "default_evaluation": "loop",
    "evaluation_of": "recipes",
    "export_onnx": "export",
    "keep_compiled": "compile_cache",
    "learn": "loop",
    "learn_in_chunks": "session",
    "learn_run": "recorded",
    "load_policy": "metropilot.drivers.policy.policy_file",
    "make_loop": "loop",
    "new_request": "recipes",
    "read_history": "history",
    "recipe": "recipes",
    "resumed_request": "recipes",
    "runs_folder": "metropilot.home",
    "save_policy": "metropilot.drivers.policy.policy_file",
    "write_history": "history",
}


def __getattr__(name: str) -> Any:
    """Import a name from its private file on first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = _HOME.get(name, "config")
    return getattr(import_module(home if "." in home else f"{__name__}.{home}"), name)
