"""Learner class of each configuration: one row a learner."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from metropilot.env import AbstractTask
from metropilot.learn.config import (
    DDPGConfig,
    DQNConfig,
    NAFConfig,
    PPOConfig,
    SACConfig,
    TabularConfig,
)
from metropilot.learn.config_base import AbstractConfig
from metropilot.learn.ddpg import DDPG
from metropilot.learn.dqn import DQN
from metropilot.learn.learner import AbstractLearner
from metropilot.learn.naf import NAF
from metropilot.learn.ppo import PPO
from metropilot.learn.sac import SAC
from metropilot.learn.tabular import TabularQ

LEARNERS: dict[type[AbstractConfig], Callable[[Any, AbstractTask], AbstractLearner[Any]]] = {
    DDPGConfig: DDPG,
    DQNConfig: DQN,
    NAFConfig: NAF,
    PPOConfig: PPO,
    SACConfig: SAC,
    TabularConfig: TabularQ,
}


def make_learner(config: AbstractConfig, task: AbstractTask) -> AbstractLearner[Any]:
    """The learner of a configuration on a task.

    Raises:
        InputError: The learner does not take this kind of action.
    """
    return LEARNERS[type(config)](config, task)
