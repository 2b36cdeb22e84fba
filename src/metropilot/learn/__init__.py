"""Drivers that learn: DQN, PPO, DDPG, SAC, NAF and tabular Q-learning, each run one compiled program.

The door is lazy: reading a policy or listing runs does not import JAX.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
    from metropilot.learn.loop import Loop, LoopState, default_evaluation, learn, make_loop
    from metropilot.learn.policy import Policy, PolicySpec, act
    from metropilot.learn.schedules import Schedule

__all__ = [
    "CONFIGS",
    "AbstractConfig",
    "DDPGConfig",
    "DQNConfig",
    "Loop",
    "LoopState",
    "NAFConfig",
    "PPOConfig",
    "Policy",
    "PolicySpec",
    "SACConfig",
    "Schedule",
    "TabularConfig",
    "act",
    "config_from_mapping",
    "config_to_mapping",
    "default_evaluation",
    "learn",
    "make_loop",
]

_HOME = {
    "Loop": "loop",
    "LoopState": "loop",
    "Policy": "policy",
    "PolicySpec": "policy",
    "Schedule": "schedules",
    "AbstractConfig": "config_base",
    "act": "policy",
    "config_from_mapping": "config_reading",
    "config_to_mapping": "config_reading",
    "default_evaluation": "loop",
    "learn": "loop",
    "make_loop": "loop",
}


def __getattr__(name: str) -> Any:
    """Import a name from its private file on first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME.get(name, 'config')}"), name)
