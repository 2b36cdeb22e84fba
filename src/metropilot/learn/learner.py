"""Interface between the loop and a learner, and the part that every learner shares."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Generic, NamedTuple, TypeVar

import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.errors import InputError
from metropilot.learn.config import AbstractConfig
from metropilot.learn.environments import Finished
from metropilot.learn.statistics import Moments, deviation
from metropilot.policy import Params, PolicySpec

LearnerState = Any
Config = TypeVar("Config", bound=AbstractConfig)


class LearnerReport(NamedTuple):
    """Report of one iteration.

    Attributes:
        losses: Named numbers of shape (), averaged over a chunk.
        finished: Episodes that ended, summed over a chunk.
    """

    losses: dict[str, Array]
    finished: Finished


class AbstractLearner(ABC, Generic[Config]):
    """An algorithm on one task, as pure functions of a state that is one pytree of arrays.

    Attributes:
        config: Configuration.
        task: Task to learn.
        spec: Layout of its policy's parameters.
        iteration_steps: Environment steps of one iteration.
    """

    config: Config
    task: AbstractTask
    spec: PolicySpec
    iteration_steps: int

    @abstractmethod
    def init(self, key: Array) -> LearnerState:
        """Fresh parameters, environments and memory (warmed up)."""

    @abstractmethod
    def iterate(self, state: LearnerState, progress: Array) -> tuple[LearnerState, LearnerReport]:
        """Some environment steps and what is learned from them.

        Args:
            state: From :meth:`init` or the iteration before.
            progress: Share of the whole learning done so far, for schedules. Shape ().
        """

    @abstractmethod
    def policy(self, state: LearnerState) -> Params:
        """The policy's parameters as they are now: exactly those of ``spec.shapes()``."""


def needs_continuous(task: AbstractTask, algorithm: str) -> int:
    """The number of actions of a continuous task.

    Raises:
        InputError: The task has choices.
    """
    if task.action_space.discrete:
        raise InputError(
            "needs continuous actions", field="algorithm", value=algorithm, allowed="dqn, ppo, tabular"
        )
    return task.action_space.size


def needs_choices(task: AbstractTask, algorithm: str) -> int:
    """The number of choices of a discrete task.

    Raises:
        InputError: The task has continuous actions.
    """
    if not task.action_space.discrete:
        raise InputError("needs choices", field="algorithm", value=algorithm, allowed="ddpg, naf, ppo, sac")
    return task.action_space.count


def observation_entries(moments: Moments) -> Params:
    """Entries of the policy file for the observations' statistics."""
    return {
        "observation.mean": moments.mean,
        "observation.scale": 1.0 / jnp.maximum(deviation(moments), 1e-4),
    }
