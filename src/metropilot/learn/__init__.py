"""Drivers that learn: DQN, PPO, DDPG, SAC, NAF and tabular Q-learning, each run one compiled program."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.learn.checkpoint import load_checkpoint
    from metropilot.learn.compile_cache import compiler_id, keep_compiled, trim_cache
    from metropilot.learn.config import (
        CONFIGS,
        DDPGConfig,
        DQNConfig,
        NAFConfig,
        PPOConfig,
        SACConfig,
        TabularConfig,
        TeacherConfig,
    )
    from metropilot.learn.config_base import AbstractConfig
    from metropilot.learn.config_reading import config_from_mapping, config_to_mapping
    from metropilot.learn.environments import (
        Environments,
        random_actions,
        reset_environments,
        step_environments,
    )
    from metropilot.learn.export import ExportReport, export_onnx
    from metropilot.learn.imitation.demonstrations import DemonstrationGenerator
    from metropilot.learn.imitation.train_state import imitation_spec
    from metropilot.learn.loop import Loop, LoopState, PolicyEvaluation, default_evaluation, learn, make_loop
    from metropilot.learn.policy_evaluation import DrivingEvaluation
    from metropilot.learn.recipes import (
        PPO_BASE,
        RECIPES,
        REPLAY_BASE,
        REPLAY_QUICK,
        TABLE_BASE,
        Recipe,
        evaluation_of,
        new_request,
        recipe,
        resumed_request,
    )
    from metropilot.learn.registry import make_learner
    from metropilot.learn.run_store import (
        CHECKPOINT_FILE,
        HISTORY_FILE,
        INDEX_FILE,
        RECORD_FILE,
        RunRecord,
        RunStore,
        read_history,
        read_record,
        record_of,
        write_history,
    )
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
    "CHECKPOINT_FILE",
    "CONFIGS",
    "HISTORY_FILE",
    "INDEX_FILE",
    "PPO_BASE",
    "RECIPES",
    "RECORD_FILE",
    "REPLAY_BASE",
    "REPLAY_QUICK",
    "TABLE_BASE",
    "AbstractConfig",
    "DDPGConfig",
    "DQNConfig",
    "DemonstrationGenerator",
    "DrivingEvaluation",
    "Environments",
    "ExportReport",
    "Loop",
    "LoopState",
    "NAFConfig",
    "PPOConfig",
    "PolicyEvaluation",
    "Recipe",
    "RunRecord",
    "RunRequest",
    "RunStore",
    "SACConfig",
    "Schedule",
    "TabularConfig",
    "TeacherConfig",
    "TrainingOptions",
    "TrainingProgress",
    "TrainingResult",
    "begin_run",
    "compiler_id",
    "config_from_mapping",
    "config_to_mapping",
    "default_evaluation",
    "evaluation_of",
    "export_onnx",
    "imitation_spec",
    "keep_compiled",
    "learn",
    "learn_in_chunks",
    "learn_run",
    "load_checkpoint",
    "make_learner",
    "make_loop",
    "new_request",
    "random_actions",
    "read_history",
    "read_record",
    "recipe",
    "record_of",
    "reset_environments",
    "resumed_request",
    "step_environments",
    "trim_cache",
    "write_history",
]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "checkpoint": ("load_checkpoint",),
        "compile_cache": ("compiler_id", "keep_compiled", "trim_cache"),
        "config": (
            "CONFIGS",
            "DDPGConfig",
            "DQNConfig",
            "NAFConfig",
            "PPOConfig",
            "SACConfig",
            "TabularConfig",
            "TeacherConfig",
        ),
        "config_base": ("AbstractConfig",),
        "config_reading": ("config_from_mapping", "config_to_mapping"),
        "environments": ("Environments", "random_actions", "reset_environments", "step_environments"),
        "export": ("ExportReport", "export_onnx"),
        "imitation.demonstrations": ("DemonstrationGenerator",),
        "imitation.train_state": ("imitation_spec",),
        "loop": ("Loop", "LoopState", "PolicyEvaluation", "default_evaluation", "learn", "make_loop"),
        "policy_evaluation": ("DrivingEvaluation",),
        "recipes": (
            "PPO_BASE",
            "RECIPES",
            "REPLAY_BASE",
            "REPLAY_QUICK",
            "Recipe",
            "TABLE_BASE",
            "evaluation_of",
            "new_request",
            "recipe",
            "resumed_request",
        ),
        "registry": ("make_learner",),
        "run_store": (
            "CHECKPOINT_FILE",
            "HISTORY_FILE",
            "INDEX_FILE",
            "RECORD_FILE",
            "RunRecord",
            "RunStore",
            "read_history",
            "read_record",
            "record_of",
            "write_history",
        ),
        "schedules": ("Schedule",),
        "train": (
            "RunRequest",
            "TrainingOptions",
            "TrainingProgress",
            "TrainingResult",
            "begin_run",
            "learn_in_chunks",
            "learn_run",
        ),
    },
)
