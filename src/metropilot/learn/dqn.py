"""Deep Q-learning with switches: double, dueling, prioritised, n-step, action filter.

Sources: Lu23; Mnih et al. 2015; van Hasselt et al. 2016; Wang et al. 2016; Schaul et al. 2016.
"""

from __future__ import annotations

from typing import Any, final

import jax
import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.learn.config import DQNConfig
from metropilot.learn.environments import random_choices
from metropilot.learn.learner import needs_choices
from metropilot.learn.losses import dqn as losses
from metropilot.learn.networks import MLP, mask_values
from metropilot.learn.off_policy import AbstractReplayLearner, Batch, Exploration, Networks
from metropilot.learn.optimiser import adam_init, adam_step, polyak
from metropilot.learn.schedules import value_at
from metropilot.policy import Params, network_output


@final
class DQN(AbstractReplayLearner[DQNConfig]):
    """DQN on a task with choices.

    Args:
        config: Configuration.
        task: Task to learn.

    Raises:
        InputError: The task has continuous actions.
    """

    def __init__(self, config: DQNConfig, task: AbstractTask) -> None:
        super().__init__(config, task, needs_choices(task, config.algorithm), prioritised=config.prioritised)
        self.spec = self._policy_spec("dueling" if config.dueling else "argmax", self.actions)

    def fresh(self, key: Array) -> Networks:
        """One network, and its copy as target."""
        config, sizes = self.config, (self.task.observation_size, *self.config.hidden)
        kind: Any = {"activation": config.activation, "initialiser": config.initialiser}
        if config.dueling:
            keys = jax.random.split(key, 3)
            params = MLP(sizes, output_scale=2.0**0.5, **kind).init("policy", keys[0])
            params |= MLP((sizes[-1], 1), **kind).init("policy.value", keys[1])
            params |= MLP((sizes[-1], self.actions), **kind).init("policy.advantage", keys[2])
        else:
            params = MLP((*sizes, self.actions), **kind).init("policy", key)
        return Networks(params, params, adam_init(params), jnp.zeros((), jnp.int32))

    def values(self, params: Params, observation: Array) -> Array:
        """Action values of a batch of normalised observations. Shape (B, count)."""
        return jax.vmap(lambda x: network_output(self.spec, params, x, jnp))(observation)

    def explore(self, params: Params, now: Exploration) -> tuple[Array, Array]:
        """Epsilon-greedy among the allowed choices."""
        coin_key, choice_key = jax.random.split(now.key)
        values = self.values(params, now.observation)
        best = jnp.argmax(mask_values(values, now.mask), axis=-1).astype(jnp.int32)
        epsilon = value_at(self.config.epsilon, now.progress)
        curious = jax.random.uniform(coin_key, best.shape, jnp.float32) < epsilon
        return jnp.where(curious, random_choices(choice_key, values.shape, now.mask), best), now.noise

    def improve(
        self, networks: Networks, batch: Batch, key: Array, progress: Array
    ) -> tuple[Networks, dict[str, Array], Array]:
        """One step on the temporal-difference error; returns priorities."""
        del key
        config = self.config
        judge = self.values(networks.target, batch.next_observation)
        chooser = self.values(networks.params, batch.next_observation) if config.double else judge
        mask = batch.next_mask if config.mask_targets else None
        target = losses.td_target(batch.reward, batch.discount, chooser, judge, mask)
        choice = batch.action[:, 0].astype(jnp.int32)

        def loss(params: Params) -> tuple[Array, tuple[Array, Array]]:
            values = self.values(params, batch.observation)
            error = losses.td_error(values, choice, target)
            return losses.loss(error, batch.weight, config.huber), (error, jnp.mean(values))

        (size, (error, mean)), gradient = jax.value_and_grad(loss, has_aux=True)(networks.params)
        rate = value_at(config.learning_rate, progress)
        params, optimiser = adam_step(
            networks.params, gradient, networks.optimiser, rate, config.max_gradient_norm
        )
        updates = networks.updates + 1
        tau: Array | float = config.tau
        if config.target_period:
            tau = jnp.where(updates % config.target_period == 0, 1.0, 0.0)
        networks = Networks(params, polyak(networks.target, params, tau), optimiser, updates)
        priorities = losses.priority(error, config.priority_floor, config.priority_exponent)
        return networks, {"loss": size, "value": mean}, priorities
