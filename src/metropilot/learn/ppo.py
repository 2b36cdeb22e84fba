"""Proximal policy optimisation: rollouts of many environments, epochs of minibatches.

Source: Schulman et al. 2017.
Deviations from the paper, all common: advantages normalised per minibatch (a switch), orthogonal weights with
a small last layer, gradients clipped, Adam's epsilon 1e-5, separate networks for policy and value.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.learn import environments as env
from metropilot.learn import learner, networks
from metropilot.learn.config import PPOConfig
from metropilot.learn.losses import ppo as losses
from metropilot.learn.optimiser import AdamState, adam_init, adam_step
from metropilot.learn.replay import RowLayout
from metropilot.learn.schedules import value_at
from metropilot.policy import Params, PolicySpec, network_output, normalise, only_policy

ADAM_EPSILON = 1e-5


class PPOState(NamedTuple):
    """Everything PPO carries.

    Attributes:
        params: Policy, value, statistics of observations.
        optimiser: Moments of Adam.
        environments: State of the environments.
        observed: Statistics of observations.
        scale: Statistics of returns.
        key: Random key.
    """

    params: Params
    optimiser: AdamState
    environments: env.Environments
    observed: learner.Moments
    scale: learner.ReturnScale
    key: Array


class Experience(NamedTuple):
    """One rollout; every array has leading axes (steps, environments)."""

    observation: Array
    action: Array
    log_prob: Array
    mask: Array | None
    step: env.Step


@final
class PPO(learner.AbstractLearner[PPOConfig]):
    """PPO on a task with continuous actions or choices.

    Args:
        config: Configuration.
        task: Task to learn.
    """

    def __init__(self, config: PPOConfig, task: AbstractTask) -> None:
        self.config = config
        self.task = task
        space = task.action_space
        self.continuous = not space.discrete
        self.actions = space.count if space.discrete else space.size
        self.iteration_steps = config.rollout * config.environments
        self.spec = PolicySpec(
            output="clip" if self.continuous else "argmax",
            observation_size=task.observation_size,
            actions=self.actions,
            hidden=config.hidden,
            activation=config.activation,
            width=self.actions,
            normalised=config.normalise_observations,
        )
        sizes = (task.observation_size, *config.hidden)
        common: Any = {"activation": config.activation, "initialiser": config.initialiser}
        bias = config.initial_bias if self.continuous else 0.0
        self.actor = networks.MLP((*sizes, self.actions), output_scale=0.01, output_bias=bias, **common)
        self.critic = networks.MLP((*sizes, 1), **common)
        columns = {"observation": sizes[0], "action": self.actions if self.continuous else 1}
        columns |= {"log_prob": 1, "advantage": 1, "target": 1}
        self.layout = RowLayout(tuple(columns.items()))

    def init(self, key: Array) -> PPOState:
        """Fresh networks and environments."""
        config = self.config
        actor_key, critic_key, env_key, key = jax.random.split(key, 4)
        params = self.actor.init("policy", actor_key) | self.critic.init("value", critic_key)
        if self.continuous:
            log_std = jnp.log(jnp.float32(config.initial_std) - value_at(config.min_std, 0.0))
            params["policy.log_std"] = jnp.full((self.actions,), log_std)
        environments = env.reset_environments(self.task, env_key, config.environments)
        observed = learner.moments_init(self.task.observation_size)
        scale = learner.return_scale_init(config.environments)
        return PPOState(params, adam_init(params), environments, observed, scale, key)

    def iterate(self, state: PPOState, progress: Array) -> tuple[PPOState, learner.LearnerReport]:
        """One rollout, then epochs over it."""
        config = self.config
        key, roll_key, learn_key = jax.random.split(state.key, 3)
        if config.normalise_observations:
            state = state._replace(
                observed=learner.moments_update(state.observed, state.environments.observation)
            )
        statistics = self._statistics(state.observed)
        environments, experience = self._roll(
            state.params | statistics, state.environments, roll_key, value_at(config.min_std, progress)
        )
        done = experience.step.terminated | experience.step.truncated
        reward, scale = experience.step.reward * config.reward_factor, state.scale
        if config.reward_scaling:
            scale = jax.lax.scan(
                lambda s, x: (learner.return_scale_update(s, x[0], x[1], config.gamma), None),
                scale,
                (reward, done),
            )[0]
            reward = reward / learner.reward_divisor(scale)
        rows, mask = self._rows(state.params | statistics, experience, reward)
        params, optimiser, report = self._epochs(state, statistics, rows, mask, learn_key, progress)
        observed = state.observed
        if config.normalise_observations:
            seen = jnp.reshape(experience.step.observation, (-1, self.task.observation_size))
            observed = learner.moments_update(observed, seen)
        finished = jax.tree.map(lambda x: jnp.sum(x, axis=0), experience.step.finished)
        return PPOState(params, optimiser, environments, observed, scale, key), learner.LearnerReport(
            report, finished
        )

    def policy(self, state: PPOState) -> Params:
        """Policy network and statistics of observations."""
        return only_policy(self.spec, state.params | self._statistics(state.observed))

    def _roll(
        self, params: Params, environments: env.Environments, key: Array, floor: Array | float
    ) -> tuple[env.Environments, Experience]:
        """Act ``rollout`` steps in every environment."""
        act_key, step_key = jax.random.split(key)
        shape = (self.config.rollout, self.config.environments, self.actions)
        draw = jax.random.normal if self.continuous else jax.random.gumbel

        def one(now: env.Environments, drawn: tuple[Array, Array]) -> tuple[env.Environments, Experience]:
            mask = env.masks(self.task, now.state)
            action, log_prob = jax.vmap(self._sample, (None, 0, 0, 0, None))(
                params, now.observation, mask, drawn[0], floor
            )
            given = jnp.clip(action, -1.0, 1.0) if self.continuous else action
            after, step = env.step_environments(self.task, drawn[1], now, given)
            return after, Experience(now.observation, action, log_prob, mask, step)

        keys = jax.random.split(step_key, self.config.rollout)
        return jax.lax.scan(one, environments, (draw(act_key, shape, jnp.float32), keys))

    def _sample(
        self, params: Params, observation: Array, mask: Array | None, draw: Array, floor: Array | float
    ) -> tuple[Array, Array]:
        """An action of the exploring policy and its log probability, for one environment.

        Args:
            params: Of the policy.
            observation: Shape (O,).
            mask: Shape (count,) or None.
            draw: Standard Gaussian, or Gumbel noise for choices. Shape (actions,).
            floor: Least deviation.
        """
        output = network_output(self.spec, params, observation, jnp)
        if self.continuous:
            std = networks.floored_std(params["policy.log_std"], floor)
            action = output + std * draw
            return action, networks.gaussian_log_prob(action, output, std)
        logits = networks.mask_values(output, mask)
        choice = jnp.argmax(logits + draw).astype(jnp.int32)
        return choice, networks.categorical_log_prob(logits, choice)

    def _density(
        self,
        params: Params,
        observation: Array,
        action: Array,
        mask: Array | None,
        floor: Array | float,
    ) -> tuple[Array, Array]:
        """Log probability of an action, shape (A,), and entropy, for one environment."""
        output = network_output(self.spec, params, observation, jnp)
        if self.continuous:
            std = networks.floored_std(params["policy.log_std"], floor)
            return networks.gaussian_log_prob(action, output, std), networks.gaussian_entropy(std)
        logits = networks.mask_values(output, mask)
        return networks.categorical_log_prob(
            logits, action[0].astype(jnp.int32)
        ), networks.categorical_entropy(logits)

    def _value(self, params: Params, observation: Array) -> Array:
        """The critic's value of one observation. Shape ()."""
        return self.critic.apply(params, "value", normalise(params, observation, jnp))[0]

    def _rows(self, params: Params, experience: Experience, reward: Array) -> tuple[Array, Array | None]:
        """The rollout as rows of one array, with advantages and targets of the critic, and masks apart."""
        config, step = self.config, experience.step
        value_of = jax.vmap(jax.vmap(self._value, (None, 0)), (None, 0))
        value, next_value = value_of(params, experience.observation), value_of(params, step.observation)
        factors = (config.gamma, config.lambda_)
        estimate = jax.vmap(partial(losses.gae, factors=factors), in_axes=1, out_axes=1)
        advantage = estimate(reward, value, next_value, step.terminated, step.truncated)
        fields = {
            "observation": experience.observation,
            "action": experience.action,
            "log_prob": experience.log_prob,
            "advantage": advantage,
            "target": advantage + value,
        }
        mask = experience.mask
        return self.layout.pack(fields), None if mask is None else jnp.reshape(mask, (-1, self.actions))

    def _loss(
        self, params: Params, statistics: Params, rows: Array, mask: Array | None, progress: Array
    ) -> tuple[Array, dict[str, Array]]:
        """The whole loss of one minibatch (Schulman et al. 2017, eq. 9)."""
        config, fields = self.config, self.layout.unpack(rows)
        both = params | statistics
        density = jax.vmap(self._density, (None, 0, 0, 0, None))
        floor = value_at(config.min_std, progress)
        log_prob, entropy = density(both, fields["observation"], fields["action"], mask, floor)
        value = jax.vmap(self._value, (None, 0))(both, fields["observation"])
        old = fields["log_prob"][:, 0]
        advantage = fields["advantage"][:, 0]
        if config.normalise_advantages:
            advantage = losses.normalise_advantage(advantage)
        policy_loss = losses.policy_loss(log_prob, old, advantage, value_at(config.clip, progress))
        value_loss = losses.value_loss(value, fields["target"][:, 0])
        bonus = jnp.mean(entropy)
        total = policy_loss + config.value_weight * value_loss - value_at(config.entropy, progress) * bonus
        report = {
            "loss": total,
            "policy_loss": policy_loss,
            "value_loss": value_loss,
            "entropy": bonus,
            "divergence": losses.divergence(log_prob, old),
        }
        return total, report

    def _epochs(
        self,
        state: PPOState,
        statistics: Params,
        rows: Array,
        mask: Array | None,
        key: Array,
        progress: Array,
    ) -> tuple[Params, AdamState, dict[str, Array]]:
        """Go through the rollout ``epochs`` times in shuffled minibatches."""
        config = self.config
        slope = jax.grad(self._loss, has_aux=True)
        rate = value_at(config.learning_rate, progress)

        def minibatch(carry: tuple[Params, AdamState], indices: Array) -> tuple[Any, dict[str, Array]]:
            params, optimiser = carry
            some = None if mask is None else mask[indices]
            gradient, report = slope(params, statistics, rows[indices], some, progress)
            return adam_step(
                params, gradient, optimiser, rate, config.max_gradient_norm, ADAM_EPSILON
            ), report

        def epoch(carry: tuple[Params, AdamState], epoch_key: Array) -> tuple[Any, dict[str, Array]]:
            order = jax.random.permutation(epoch_key, rows.shape[0])
            return jax.lax.scan(minibatch, carry, jnp.reshape(order, (config.minibatches, -1)))

        keys = jax.random.split(key, config.epochs)
        (params, optimiser), report = jax.lax.scan(epoch, (state.params, state.optimiser), keys)
        return params, optimiser, jax.tree.map(jnp.mean, report)
