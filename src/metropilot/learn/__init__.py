"""Drivers that learn: DQN, PPO, DDPG, SAC, NAF and tabular Q-learning, each run one compiled program.

The door is lazy: reading a policy or listing runs does not import JAX.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
    from metropilot.learn.export import ExportReport, export_onnx
    from metropilot.learn.loop import Loop, LoopState, default_evaluation, learn, make_loop
    from metropilot.learn.policy_evaluation import DrivingEvaluation
    from metropilot.learn.recipes import RECIPES, Recipe, evaluation_of, new_request, recipe, resumed_request
    from metropilot.learn.run_store import RunRecord, RunStore, read_history, write_history
    from metropilot.learn.schedules import Schedule
    from metropilot.learn.train import (
        RunRequest,
        TrainingOptions,
        TrainingProgress,
        TrainingResult,
        begin_run,
        learn_in_chunks,
        learn_run,
    )

__all__ = [
    "CONFIGS",
    "RECIPES",
    "AbstractConfig",
    "DDPGConfig",
    "DQNConfig",
    "DrivingEvaluation",
    "ExportReport",
    "Loop",
    "LoopState",
    "NAFConfig",
    "PPOConfig",
    "Recipe",
    "RunRecord",
    "RunRequest",
    "RunStore",
    "SACConfig",
    "Schedule",
    "TabularConfig",
    "TrainingOptions",
    "TrainingProgress",
    "TrainingResult",
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
    "make_loop",
    "new_request",
    "read_history",
    "recipe",
    "resumed_request",
    "write_history",
]

_HOME = {
    "AbstractConfig": "config_base",
    "DrivingEvaluation": "policy_evaluation",
    "ExportReport": "export",
    "TrainingResult": "train",
    "Loop": "loop",
    "LoopState": "loop",
    "TrainingProgress": "train",
    "RECIPES": "recipes",
    "Recipe": "recipes",
    "RunRecord": "run_store",
    "RunRequest": "train",
    "RunStore": "run_store",
    "Schedule": "schedules",
    "TrainingOptions": "train",
    "begin_run": "train",
    "config_from_mapping": "config_reading",
    "config_to_mapping": "config_reading",
    "default_evaluation": "loop",
    "evaluation_of": "recipes",
    "export_onnx": "export",
    "keep_compiled": "compile_cache",
    "learn": "loop",
    "learn_in_chunks": "train",
    "learn_run": "train",
    "make_loop": "loop",
    "new_request": "recipes",
    "read_history": "run_store",
    "recipe": "recipes",
    "resumed_request": "recipes",
    "write_history": "run_store",
}


def __getattr__(name: str) -> Any:
    """Import a name from its private file on first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = _HOME.get(name, "config")
    return getattr(import_module(home if "." in home else f"{__name__}.{home}"), name)
