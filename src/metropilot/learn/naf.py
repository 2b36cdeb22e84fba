"""Normalised advantage functions. Source: Gu et al. 2016, algorithm 1.

Deviation: value, best action and matrix come from three networks of their own instead of one trunk.
"""

from __future__ import annotations

from typing import final

import jax
import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.learn.config import NAFConfig
from metropilot.learn.learner import needs_continuous
from metropilot.learn.losses import naf as losses
from metropilot.learn.networks import lower_triangle
from metropilot.learn.off_policy import AbstractReplayLearner, Batch, Exploration, Networks
from metropilot.learn.optimiser import adam_init, adam_step, polyak
from metropilot.learn.schedules import value_at
from metropilot.policy import Params


@final
class NAF(AbstractReplayLearner[NAFConfig]):
    """NAF on a task with continuous actions.

    Args:
        config: Configuration.
        task: Task to learn.

    Raises:
        InputError: The task has choices.
    """

    def __init__(self, config: NAFConfig, task: AbstractTask) -> None:
        super().__init__(config, task, needs_continuous(task, config.algorithm), prioritised=False)
        inputs, count = task.observation_size, self.actions
        self.spec = self._policy_spec("tanh", count)
        self.actor = self._network(inputs, count, output_scale=0.1, output_bias=config.initial_bias)
        self.value = self._network(inputs, 1)
        self.lower = self._network(inputs, count * (count + 1) // 2, output_scale=0.1)

    def fresh(self, key: Array) -> Networks:
        """Three networks; the value's copy as target."""
        keys = jax.random.split(key, 3)
        value = self.value.init("value", keys[1])
        params = self.actor.init("policy", keys[0]) | value | self.lower.init("lower", keys[2])
        return Networks(params, value, adam_init(params), jnp.zeros((), jnp.int32))

    def state_values(self, params: Params, observation: Array) -> Array:
        """Values of the best actions. Shape (B,)."""
        return jax.vmap(lambda x: self.value.apply(params, "value", x)[0])(observation)

    def values(self, params: Params, observation: Array, action: Array) -> Array:
        """Values of given actions. Shape (B,)."""

        def one(x: Array, u: Array) -> Array:
            value = self.value.apply(params, "value", x)[0]
            best = jnp.tanh(self.actor.apply(params, "policy", x))
            lower = lower_triangle(self.lower.apply(params, "lower", x), self.actions)
            return losses.action_value(value, best, lower, u)

        return jax.vmap(one)(observation, action)

    def explore(self, params: Params, now: Exploration) -> tuple[Array, Array]:
        """The best action plus white noise."""
        best = jnp.tanh(jax.vmap(lambda x: self.actor.apply(params, "policy", x))(now.observation))
        draw = value_at(self.config.noise, now.progress) * jax.random.normal(now.key, best.shape, best.dtype)
        return jnp.clip(best + draw, -1.0, 1.0), now.noise

    def improve(
        self, networks: Networks, batch: Batch, key: Array, progress: Array
    ) -> tuple[Networks, dict[str, Array], Array]:
        """One step of all three networks."""
        del key
        config = self.config
        next_value = self.state_values(networks.target, batch.next_observation)
        wanted = losses.target(batch.reward, batch.discount, next_value)

        def loss(params: Params) -> tuple[Array, Array]:
            value = self.values(params, batch.observation, batch.action)
            return losses.loss(value, wanted), value

        (size, value), gradient = jax.value_and_grad(loss, has_aux=True)(networks.params)
        rate = value_at(config.learning_rate, progress)
        params, moments = adam_step(
            networks.params, gradient, networks.optimiser, rate, config.max_gradient_norm
        )
        target = polyak(networks.target, {name: params[name] for name in networks.target}, config.tau)
        networks = Networks(params, target, moments, networks.updates + 1)
        return networks, {"loss": size, "value": jnp.mean(value)}, value - wanted
