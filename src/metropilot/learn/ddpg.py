"""Deep deterministic policy gradient (Lillicrap et al. 2016), and TD3 by its options (Fujimoto et al. 2018).

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
from metropilot.learn.off_policy import AbstractReplayLearner, Batch, Exploration, Networks
from metropilot.learn.optimiser import AdamState, adam_init, adam_step, polyak
from metropilot.learn.schedules import value_at
from metropilot.policy import Params

SMOOTHING_ENDS = 2.5
"""Largest noise on the target's action over its deviation (0.5 for 0.2 in TD3)."""


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
        self.critics = ("critic.1", "critic.2") if config.twin else ("critic",)

    def fresh(self, key: Array) -> Networks:
        """Actor and critics, and their copies as targets."""
        actor_key, *critic_keys = jax.random.split(key, 1 + len(self.critics))
        actor, critic = self.actor.init("policy", actor_key), {}
        for name, critic_key in zip(self.critics, critic_keys, strict=True):
            critic |= self.critic.init(name, critic_key)
        optimiser = {"actor": adam_init(actor), "critic": adam_init(critic)}
        return Networks(actor | critic, actor | critic, optimiser, jnp.zeros((), jnp.int32))

    def actions_of(self, params: Params, observation: Array) -> Array:
        """The actor's actions. Shape (B, A)."""
        return jnp.tanh(self.pre_tanh(params, observation))

    def pre_tanh(self, params: Params, observation: Array) -> Array:
        """Output of the actor before tanh. Shape (B, A)."""
        return jax.vmap(lambda x: self.actor.apply(params, "policy", x))(observation)

    def values(self, params: Params, observation: Array, action: Array) -> Array:
        """The values of one critic or two. Shape (1 or 2, B)."""
        both = jnp.concatenate([observation, action], axis=-1)
        return jnp.stack(
            [
                jax.vmap(lambda x, name=name: self.critic.apply(params, name, x)[0])(both)
                for name in self.critics
            ]
        )

    def target_actions(self, target: Params, observation: Array, key: Array) -> Array:
        """The target actor's actions, with noise. Shape (B, A)."""
        action, deviation = self.actions_of(target, observation), self.config.smoothing
        if deviation == 0.0:
            return action
        noise = jnp.clip(jax.random.normal(key, action.shape), -SMOOTHING_ENDS, SMOOTHING_ENDS)
        return jnp.clip(action + deviation * noise, -1.0, 1.0)

    def explore(self, params: Params, now: Exploration) -> tuple[Array, Array]:
        """The actor's action plus noise."""
        noise, size = now.noise, value_at(self.config.noise, now.progress)
        draw = size * jax.random.normal(now.key, noise.shape, noise.dtype)
        if self.config.noise_kind == "ornstein_uhlenbeck":
            noise = noise * (1.0 - self.config.noise_pull) + draw
        else:
            noise = draw
        return jnp.clip(self.actions_of(params, now.observation) + noise, -1.0, 1.0), noise

    def improve(
        self, networks: Networks, batch: Batch, key: Array, progress: Array
    ) -> tuple[Networks, dict[str, Array], Array]:
        """One step of the critics, then, unless it is delayed, one of the actor."""
        config, params, target = self.config, networks.params, networks.target
        next_action = self.target_actions(target, batch.next_observation, key)
        next_values = self.values(target, batch.next_observation, next_action)
        wanted = losses.critic_target(batch.reward, batch.discount, next_values)

        def critic_loss(critic: Params) -> tuple[Array, Array]:
            values = self.values(critic, batch.observation, batch.action)
            return losses.critic_loss(values, wanted), values[0]

        def actor_loss(actor: Params, critic: Params) -> Array:
            asked = self.pre_tanh(actor, batch.observation)
            loss = losses.actor_loss(self.values(critic, batch.observation, jnp.tanh(asked))[0])
            return loss + config.saturation_cost * jnp.mean(asked**2) if config.saturation_cost else loss

        actor, critic = subset(params, "policy."), subset(params, "critic.")
        (size, value), gradient = jax.value_and_grad(critic_loss, has_aux=True)(critic)
        rate, norm = value_at(config.critic_rate, progress), config.max_gradient_norm
        critic, critic_moments = adam_step(critic, gradient, networks.optimiser["critic"], rate, norm)
        rate = value_at(config.actor_rate, progress)

        def move_actor(moments: AdamState) -> tuple[Array, Params, AdamState, Params]:
            actor_size, gradient = jax.value_and_grad(actor_loss)(actor, critic)
            moved, moments = adam_step(actor, gradient, moments, rate, norm)
            return actor_size, moved, moments, polyak(target, moved | critic, config.tau)

        if config.delay == 1:
            moved = move_actor(networks.optimiser["actor"])
        else:
            moved = jax.lax.cond(
                networks.updates % config.delay == 0,
                move_actor,
                lambda moments: (actor_loss(actor, critic), actor, moments, target),
                networks.optimiser["actor"],
            )
        actor_size, actor, actor_moments, target = moved
        optimiser = {"actor": actor_moments, "critic": critic_moments}
        networks = Networks(actor | critic, target, optimiser, networks.updates + 1)
        report = {"loss": size, "actor_loss": actor_size, "value": jnp.mean(value)}
        return networks, report, value - wanted
