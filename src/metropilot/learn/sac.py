"""Soft actor-critic with twin critics and a learned temperature (Haarnoja et al. 2018b, algorithm 1)."""

from __future__ import annotations

from typing import final

import jax
import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.learn.config import SACConfig
from metropilot.learn.ddpg import subset
from metropilot.learn.learner import needs_continuous
from metropilot.learn.losses import sac as losses
from metropilot.learn.networks import squashed_sample
from metropilot.learn.off_policy import AbstractReplayLearner, Batch, Exploration, Networks
from metropilot.learn.optimiser import adam_init, adam_step, polyak
from metropilot.learn.schedules import value_at
from metropilot.policy import Params

TEMPERATURE = "temperature.log"


@final
class SAC(AbstractReplayLearner[SACConfig]):
    """SAC on a task with continuous actions.

    Args:
        config: Configuration.
        task: Task to learn.

    Raises:
        InputError: The task has choices.
    """

    def __init__(self, config: SACConfig, task: AbstractTask) -> None:
        super().__init__(config, task, needs_continuous(task, config.algorithm), prioritised=False)
        inputs = task.observation_size
        self.spec = self._policy_spec("tanh", 2 * self.actions)
        self.actor = self._network(inputs, 2 * self.actions, output_scale=0.1)
        self.critic = self._network(inputs + self.actions, 1)

    def fresh(self, key: Array) -> Networks:
        """Actor, two critics and the temperature; the critics' copies as targets."""
        actor_key, key_1, key_2 = jax.random.split(key, 3)
        actor = self.actor.init("policy", actor_key)
        last = f"policy.{self.actor.layers - 1}.bias"
        actor[last] = actor[last].at[: self.actions].set(self.config.initial_bias)
        critic = self.critic.init("critic.1", key_1) | self.critic.init("critic.2", key_2)
        temperature = {TEMPERATURE: jnp.log(jnp.float32(self.config.initial_temperature))}
        parts = {"actor": actor, "critic": critic, "temperature": temperature}
        optimiser = {name: adam_init(part) for name, part in parts.items()}
        return Networks(actor | critic | temperature, critic, optimiser, jnp.zeros((), jnp.int32))

    def sample(self, params: Params, observation: Array, key: Array) -> tuple[Array, Array]:
        """Actions of the policy, shape (B, A), and their log density, shape (B,)."""

        def one(x: Array, draw: Array) -> tuple[Array, Array]:
            mean, log_std = jnp.split(self.actor.apply(params, "policy", x), 2)
            return squashed_sample(draw, mean, log_std)

        draws = jax.random.normal(key, (observation.shape[0], self.actions), jnp.float32)
        return jax.vmap(one)(observation, draws)

    def values(self, params: Params, observation: Array, action: Array) -> Array:
        """Both critics' values. Shape (2, B)."""
        both = jnp.concatenate([observation, action], axis=-1)
        twins = [
            jax.vmap(lambda x, name=name: self.critic.apply(params, name, x)[0])(both)
            for name in ("critic.1", "critic.2")
        ]
        return jnp.stack(twins)

    def explore(self, params: Params, now: Exploration) -> tuple[Array, Array]:
        """A sample of the policy."""
        return self.sample(params, now.observation, now.key)[0], now.noise

    def improve(
        self, networks: Networks, batch: Batch, key: Array, progress: Array
    ) -> tuple[Networks, dict[str, Array], Array]:
        """One step of both critics, then of the actor, then of the temperature."""
        config, params, norm = self.config, networks.params, self.config.max_gradient_norm
        actor, critic = subset(params, "policy."), subset(params, "critic.")
        temperature = subset(params, "temperature.")
        alpha = jnp.exp(params[TEMPERATURE])
        next_key, actor_key = jax.random.split(key)
        next_action, next_log_prob = self.sample(actor, batch.next_observation, next_key)
        next_values = self.values(networks.target, batch.next_observation, next_action)
        wanted = losses.critic_target(batch.reward, batch.discount, next_values, next_log_prob, alpha)

        def critic_loss(critic: Params) -> tuple[Array, Array]:
            values = self.values(critic, batch.observation, batch.action)
            return losses.critic_loss(values, wanted), values

        def actor_loss(actor: Params, critic: Params) -> tuple[Array, Array]:
            action, log_prob = self.sample(actor, batch.observation, actor_key)
            return losses.actor_loss(
                self.values(critic, batch.observation, action), log_prob, alpha
            ), log_prob

        def temperature_loss(temperature: Params, log_prob: Array) -> Array:
            target_entropy = config.target_entropy * self.actions
            return losses.temperature_loss(temperature[TEMPERATURE], log_prob, target_entropy)

        moments = networks.optimiser
        (size, values), gradient = jax.value_and_grad(critic_loss, has_aux=True)(critic)
        rate = value_at(config.critic_rate, progress)
        critic, critic_moments = adam_step(critic, gradient, moments["critic"], rate, norm)
        (actor_size, log_prob), gradient = jax.value_and_grad(actor_loss, has_aux=True)(actor, critic)
        rate = value_at(config.actor_rate, progress)
        actor, actor_moments = adam_step(actor, gradient, moments["actor"], rate, norm)
        gradient = jax.grad(temperature_loss)(temperature, log_prob)
        rate = value_at(config.temperature_rate, progress)
        temperature, warmth = adam_step(temperature, gradient, moments["temperature"], rate)
        optimiser = {"actor": actor_moments, "critic": critic_moments, "temperature": warmth}
        target = polyak(networks.target, critic, config.tau)
        networks = Networks(actor | critic | temperature, target, optimiser, networks.updates + 1)
        report = {"loss": size, "actor_loss": actor_size, "value": jnp.mean(values)}
        report |= {"temperature": alpha, "entropy": -jnp.mean(log_prob)}
        return networks, report, values[0] - wanted
