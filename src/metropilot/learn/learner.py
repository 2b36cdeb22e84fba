"""Interface between the loop and a learner; running statistics of observations and of returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Generic, NamedTuple, TypeVar

import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.errors import InputError
from metropilot.learn.config import AbstractConfig
from metropilot.learn.environments import Finished
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

    def _statistics(self, observed: Moments) -> Params:
        """Entries of the policy file for the observations' statistics, where it has any."""
        if not self.config.normalise_observations:
            return {}
        scale = 1.0 / jnp.maximum(deviation(observed), 1e-4)
        return {"observation.mean": observed.mean, "observation.scale": scale}


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


EPSILON = 1e-8
CONSTANT = 1e-6
"""A return that varies less than this is taken as constant: rewards are then left as they are."""


class Moments(NamedTuple):
    """Mean and sum of squared differences from it, of everything seen so far.

    Attributes:
        count: Number of observations. Shape ().
        mean: Shape (K,).
        squares: Shape (K,).
    """

    count: Array
    mean: Array
    squares: Array


def moments_init(size: int) -> Moments:
    """Nothing seen."""
    return Moments(
        jnp.zeros((), jnp.float32), jnp.zeros((size,), jnp.float32), jnp.zeros((size,), jnp.float32)
    )


def moments_update(moments: Moments, batch: Array) -> Moments:
    """Take in a batch (Chan, Golub and LeVeque 1979). Batch of shape (B, K)."""
    number = jnp.float32(batch.shape[0])
    count = moments.count + number
    mean = jnp.mean(batch, axis=0)
    difference = mean - moments.mean
    squares = moments.squares + jnp.sum((batch - mean[None, :]) ** 2, axis=0)
    squares = squares + difference * difference * (moments.count * number / count)
    return Moments(count, moments.mean + difference * (number / count), squares)


def deviation(moments: Moments) -> Array:
    """Standard deviation; one before there are two samples. Shape (K,)."""
    variance = moments.squares / jnp.maximum(moments.count, 1.0)
    return jnp.where(moments.count > 1.0, jnp.sqrt(variance), jnp.ones_like(variance))


class ReturnScale(NamedTuple):
    """Statistics of returns, for reward scaling.

    Attributes:
        returned: Discounted return of each environment's running episode. Shape (N,).
        moments: Of that return over all environments and steps. Shape (1,) inside.
    """

    returned: Array
    moments: Moments


def return_scale_init(environments: int) -> ReturnScale:
    """Nothing seen."""
    return ReturnScale(jnp.zeros((environments,), jnp.float32), moments_init(1))


def return_scale_update(scale: ReturnScale, reward: Array, done: Array, gamma: float) -> ReturnScale:
    """Take in one step of every environment.

    Args:
        scale: So far.
        reward: Shape (N,).
        done: True where the episode ended. Shape (N,).
        gamma: Discount.
    """
    returned = scale.returned * gamma + reward
    moments = moments_update(scale.moments, returned[:, None])
    return ReturnScale(jnp.where(done, 0.0, returned), moments)


def reward_divisor(scale: ReturnScale) -> Array:
    """``sigma(R) + epsilon``: rewards are divided by it, no mean is subtracted (Chen23a eq. 23). Shape ().

    ``R`` is the running discounted return of each environment, as in Engstrom et al. 2020, on which the paper
    builds; taken literally as the deviation of the rewards it would not bound the critic's target.
    """
    sigma = deviation(scale.moments)[0]
    return jnp.where(sigma > CONSTANT, sigma, 1.0) + EPSILON
