"""Tabular Q-learning over a grid of observations, many environments at once (Watkins and Dayan 1992)."""

from __future__ import annotations

from typing import NamedTuple, final

import jax
import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.errors import InputError
from metropilot.learn import environments as env
from metropilot.learn.config import TabularConfig
from metropilot.learn.learner import AbstractLearner, LearnerReport, needs_choices
from metropilot.learn.losses import tabular as losses
from metropilot.learn.networks import mask_values
from metropilot.learn.schedules import value_at
from metropilot.policy import Params, PolicySpec, table_cell


class TabularState(NamedTuple):
    """Everything the table learner carries.

    Attributes:
        params: The table and the ends of its grid.
        environments: State of the environments.
        key: Random key.
    """

    params: Params
    environments: env.Environments
    key: Array


@final
class TabularQ(AbstractLearner[TabularConfig]):
    """A table of action values on a task with choices.

    Args:
        config: Configuration.
        task: Task to learn.

    Raises:
        InputError: The task has continuous actions, or the grid another number of axes than the observation.
    """

    def __init__(self, config: TabularConfig, task: AbstractTask) -> None:
        self.config = config
        self.task = task
        self.iteration_steps = config.rollout * config.environments
        size = task.observation_size
        self.spec = PolicySpec(
            output="table",
            observation_size=size,
            actions=needs_choices(task, config.algorithm),
            hidden=_axes("bins", config.bins, size),
            activation="tanh",
            width=task.action_space.count,
        )
        self.low, self.high = _axes("low", config.low, size), _axes("high", config.high, size)

    def init(self, key: Array) -> TabularState:
        """A table of ``initial_value``."""
        env_key, key = jax.random.split(key)
        shape = self.spec.shapes()["policy.table"]
        params = {
            "policy.table": jnp.full(shape, self.config.initial_value, jnp.float32),
            "policy.low": jnp.asarray(self.low, jnp.float32),
            "policy.high": jnp.asarray(self.high, jnp.float32),
        }
        return TabularState(params, env.reset_environments(self.task, env_key, self.config.environments), key)

    def iterate(self, state: TabularState, progress: Array) -> tuple[TabularState, LearnerReport]:
        """``rollout`` steps of every environment, each learned from at once."""
        key, roll_key = jax.random.split(state.key)
        rate = value_at(self.config.learning_rate, progress)
        epsilon = value_at(self.config.epsilon, progress)

        def one(now: TabularState, step_key: Array) -> tuple[TabularState, tuple[Array, env.Finished]]:
            choice_key, env_key = jax.random.split(step_key)
            table = now.params["policy.table"]
            cell = self._cells(now.params, now.environments.observation)
            mask = env.masks(self.task, now.environments.state)
            choice = self._choose(table[cell], mask, choice_key, epsilon)
            environments, step = env.step_environments(self.task, env_key, now.environments, choice)
            after = mask_values(table[self._cells(now.params, step.observation)], step.mask)
            value = jnp.where(step.terminated, 0.0, self.config.gamma * jnp.max(after, axis=-1))
            reward = step.reward * self.config.reward_factor
            error = losses.td_error(table, cell, choice, reward, value)
            params = now.params | {"policy.table": losses.update(table, cell, choice, error, rate)}
            return TabularState(params, environments, now.key), (jnp.mean(error**2), step.finished)

        keys = jax.random.split(roll_key, self.config.rollout)
        state, (loss, finished) = jax.lax.scan(one, state._replace(key=key), keys)
        return state, LearnerReport(
            {"loss": jnp.mean(loss)}, jax.tree.map(lambda x: jnp.sum(x, axis=0), finished)
        )

    def policy(self, state: TabularState) -> Params:
        """The table itself."""
        return dict(state.params)

    def _cells(self, params: Params, observation: Array) -> Array:
        """The cell of each observation. Shape (N,)."""
        return jax.vmap(lambda x: table_cell(self.spec, params, x, jnp))(observation)

    def _choose(self, values: Array, mask: Array | None, key: Array, epsilon: Array | float) -> Array:
        """Epsilon-greedy among the allowed choices. Values of shape (N, count); result of shape (N,)."""
        coin_key, choice_key = jax.random.split(key)
        best = jnp.argmax(mask_values(values, mask), axis=-1).astype(jnp.int32)
        curious = jax.random.uniform(coin_key, best.shape, jnp.float32) < epsilon
        return jnp.where(curious, env.random_choices(choice_key, values.shape, mask), best)


def _axes(name: str, values: tuple, size: int) -> tuple:
    """One entry per observation; a single one stands for all."""
    if len(values) == 1:
        return tuple(values) * size
    if len(values) != size:
        allowed = f"1 or {size}, the length of the observation"
        raise InputError("wrong number of entries", field=name, value=len(values), allowed=allowed)
    return tuple(values)
