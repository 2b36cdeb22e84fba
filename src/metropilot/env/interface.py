"""Interface of a task to a learner: two pure functions, the transition and the action space."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from metropilot._typing import Array

TaskState = Any


class Transition(NamedTuple):
    """Result of one step. The task never resets itself: the observation after the last step survives.

    Attributes:
        observation: Observation after the step. Shape (O,).
        reward: Sum of ``terms``. Shape ().
        terminated: The task is over by its own rules (arrived, overshot, ...). Shape ().
        truncated: The task was cut off (time limit): its value goes on. Shape ().
        terms: The named reward terms, each of shape ().
    """

    observation: Array
    reward: Array
    terminated: Array
    truncated: Array
    terms: Mapping[str, Array]


@dataclass(frozen=True)
class ActionSpace:
    """Action space: ``size`` numbers in [-1, 1], or one of ``count`` choices.

    Attributes:
        size: Number of continuous actions (0: discrete).
        count: Number of choices (0: continuous).
    """

    size: int = 0
    count: int = 0

    @property
    def discrete(self) -> bool:
        """True if an action is an integer choice."""
        return self.count > 0


class AbstractTask(ABC):
    """A functional environment; batch it with ``jax.vmap``, compile it with ``jax.jit``.

    Attributes:
        observation_size: Length of the observation vector.
        action_space: Action space.
    """

    observation_size: int
    action_space: ActionSpace

    @abstractmethod
    def reset(self, key: Array) -> tuple[TaskState, Array]:
        """Begin an episode; returns its state and first observation."""

    @abstractmethod
    def step(self, key: Array, state: TaskState, action: Array) -> tuple[TaskState, Transition]:
        """Take one step of the episode; steps after its end are undefined but finite."""

    def allowed(self, state: TaskState) -> Array | None:
        """Mask of the choices allowed in a state (Lu23's action filter). Shape (count,); None: all."""
        del state
        return None
