"""Interface of a task to a learner: two pure functions, the transition and the action space."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from metropilot._typing import Array, Bool, Flag, Float, Key, Num, Scalar
from metropilot.errors import InputError

TaskState = Any


class Transition(NamedTuple):
    """Result of one step. The task never resets itself: the observation after the last step survives.

    Attributes:
        observation: Observation after the step.
        reward: Sum of ``terms``.
        terminated: The task is over by its own rules (arrived, overshot, ...).
        truncated: The task was cut off (time limit): its value goes on.
        terms: The named reward terms.
    """

    observation: Float[Array, " features"]
    reward: Scalar
    terminated: Flag
    truncated: Flag
    terms: Mapping[str, Scalar]


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

    def check(self, actions: object, batch: tuple[int, ...] = (), field: str = "action") -> None:
        """Refuse actions of another shape, numbers that are not finite, and choices that there are not.

        Args:
            actions: Actions; numbers beyond [-1, 1] pass: who takes them clips them.
            batch: Leading axes of the actions.
            field: Named in the error.

        Raises:
            InputError: They cannot be taken.
        """
        values = np.asarray(actions)
        shape = batch if self.discrete else (*batch, self.size)
        if values.shape != shape or values.dtype.kind not in ("iu" if self.discrete else "iuf"):
            kind = "whole numbers" if self.discrete else "numbers"
            allowed = f"{kind} of shape {shape}"
            shown = f"{values.dtype} of shape {values.shape}"
            raise InputError("wrong kind of action", field=field, value=shown, allowed=allowed)
        if self.discrete and not ((values >= 0) & (values < self.count)).all():
            allowed = f"0 to {self.count - 1}"
            raise InputError("no such choice", field=field, value=str(values), allowed=allowed)
        if not np.isfinite(values).all():
            raise InputError("out of range", field=field, value=str(values), allowed="finite numbers")


class AbstractTask(ABC):
    """A functional environment; batch it with ``jax.vmap``, compile it with ``jax.jit``.

    Attributes:
        observation_size: Length of the observation vector.
        action_space: Action space.
    """

    observation_size: int
    action_space: ActionSpace

    @abstractmethod
    def reset(self, key: Key) -> tuple[TaskState, Float[Array, " features"]]:
        """Begin an episode; returns its state and first observation."""

    @abstractmethod
    def step(
        self, key: Key, state: TaskState, action: Num[Array, "*actions"]
    ) -> tuple[TaskState, Transition]:
        """Take one step of the episode; steps after its end are undefined but finite."""

    def action_mask(self, state: TaskState) -> Bool[Array, " choices"] | None:
        """Mask of the choices allowed in a state (Lu23's action filter). None: all."""
        del state
        return None
