"""Deep deterministic policy gradient. Source: Lillicrap et al. 2016.

Deviations: actions enter the critic at its first layer; no batch normalisation or weight decay; noise is
white by default; an optional price keeps the actor from the flat ends of tanh.
"""

from __future__ import annotations

from typing import final

import jax
import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.learn.config import DDPGConfig
from metropilot.learn.learner import needs_continuous
from metropilot.learn.losses import ddpg as losses
from metropilot.learn.off_policy import AbstractReplayLearner, Batch, Networks
from metropilot.learn.optimiser import adam_init, adam_step, polyak
from metropilot.learn.schedules import value_at
from metropilot.policy import Params


def subset(params: Params, prefix: str) -> Params:
    """The entries of one network, or of those whose names begin alike."""
    return {name: value for name, value in params.items() if name.startswith(prefix)}


@final
class DDPG(AbstractReplayLearner[DDPGConfig]):
    """DDPG on a task with continuous actions.

    Args:
        config: Configuration.
        task: Task to learn.

    Raises:
        InputError: The task has choices.
    """

    def __init__(self, config: DDPGConfig, task: AbstractTask) -> None:
        super().__init__(config, task, needs_continuous(task, config.algorithm), prioritised=False)
        inputs, bias = task.observation_size, config.initial_bias
        self.spec = self._policy_spec("tanh", self.actions)
        self.actor = self._network(inputs, self.actions, output_scale=0.1, output_bias=bias)
        self.critic = self._network(inputs + self.actions, 1)

    def fresh(self, key: Array) -> Networks:
        """Actor and critic, and their copies as targets."""
        actor_key, critic_key = jax.random.split(key)
        actor, critic = self.actor.init("policy", actor_key), self.critic.init("critic", critic_key)
        optimiser = {"actor": adam_init(actor), "critic": adam_init(critic)}
        return Networks(actor | critic, actor | critic, optimiser, jnp.zeros((), jnp.int32))

    def actions_of(self, params: Params, observation: Array) -> Array:
        """The actor's actions. Shape (B, A)."""
        return jnp.tanh(self.pre_tanh(params, observation))

    def pre_tanh(self, params: Params, observation: Array) -> Array:
        """Output of the actor before tanh. Shape (B, A)."""
        return jax.vmap(lambda x: self.actor.apply(params, "policy", x))(observation)

    def values(self, params: Params, observation: Array, action: Array) -> Array:
        """The critic's values. Shape (B,)."""
        both = jnp.concatenate([observation, action], axis=-1)
        return jax.vmap(lambda x: self.critic.apply(params, "critic", x)[0])(both)

    def explore(
        self,
        params: Params,
        observation: Array,
        mask: Array | None,
        noise: Array,
        key: Array,
        progress: Array,
    ) -> tuple[Array, Array]:
        """The actor's action plus noise."""
        del mask
        draw = value_at(self.config.noise, progress) * jax.random.normal(key, noise.shape, noise.dtype)
        if self.config.noise_kind == "ornstein_uhlenbeck":
            noise = noise * (1.0 - self.config.noise_pull) + draw
        else:
            noise = draw
        return jnp.clip(self.actions_of(params, observation) + noise, -1.0, 1.0), noise

    def improve(
        self, networks: Networks, batch: Batch, key: Array, progress: Array
    ) -> tuple[Networks, dict[str, Array], Array]:
        """One step of the critic, then one of the actor."""
        del key
        config, params, target = self.config, networks.params, networks.target
        next_value = self.values(
            target, batch.next_observation, self.actions_of(target, batch.next_observation)
        )
        wanted = losses.critic_target(batch.reward, batch.discount, next_value)

        def critic_loss(critic: Params) -> tuple[Array, Array]:
            value = self.values(critic, batch.observation, batch.action)
            return losses.critic_loss(value, wanted), value

        def actor_loss(actor: Params, critic: Params) -> Array:
            asked = self.pre_tanh(actor, batch.observation)
            loss = losses.actor_loss(self.values(critic, batch.observation, jnp.tanh(asked)))
            return loss + config.saturation_cost * jnp.mean(asked**2) if config.saturation_cost else loss

        actor, critic = subset(params, "policy."), subset(params, "critic.")
        (size, value), gradient = jax.value_and_grad(critic_loss, has_aux=True)(critic)
        rate, norm = value_at(config.critic_rate, progress), config.max_gradient_norm
        critic, critic_moments = adam_step(critic, gradient, networks.optimiser["critic"], rate, norm)
        actor_size, gradient = jax.value_and_grad(actor_loss)(actor, critic)
        rate = value_at(config.actor_rate, progress)
        actor, actor_moments = adam_step(actor, gradient, networks.optimiser["actor"], rate, norm)
        params = actor | critic
        optimiser = {"actor": actor_moments, "critic": critic_moments}
        networks = Networks(params, polyak(target, params, config.tau), optimiser, networks.updates + 1)
        report = {"loss": size, "actor_loss": actor_size, "value": jnp.mean(value)}
        return networks, report, value - wanted
