"""Shared loop of DQN, DDPG, SAC and NAF: act, remember, replay. They differ in how they explore and improve.

The memory is in the carry of the outermost scan and in nothing else that branches; the warm-up is a scan of
its own.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask
from metropilot.learn import environments as env
from metropilot.learn import learner, replay
from metropilot.learn.config import AbstractReplayConfig
from metropilot.learn.networks import MLP
from metropilot.learn.schedules import value_at
from metropilot.policy import Params, PolicySpec, normalise, only_policy


class Networks(NamedTuple):
    """Networks and optimiser, changed by a gradient step.

    Attributes:
        params: Online parameters.
        target: Target parameters.
        optimiser: Moments of Adam, per network.
        updates: Gradient steps so far. Shape (), int32.
    """

    params: Params
    target: Params
    optimiser: Any
    updates: Array


class Batch(NamedTuple):
    """Transitions to learn from, observations normalised and rewards scaled.

    Attributes:
        observation: Shape (B, O).
        action: Shape (B, A), or choices as numbers, shape (B, 1).
        reward: Sum over n steps. Shape (B,).
        discount: gamma^n, zero where the episode terminated. Shape (B,).
        next_observation: n steps later, or the last of the episode. Shape (B, O).
        next_mask: Choices allowed there, shape (B, count), or None.
        weight: Importance weights. Shape (B,).
    """

    observation: Array
    action: Array
    reward: Array
    discount: Array
    next_observation: Array
    next_mask: Array | None
    weight: Array


class Exploration(NamedTuple):
    """Circumstances that exploring actions follow from.

    Attributes:
        observation: Normalised. Shape (N, O).
        mask: Shape (N, count) or None.
        noise: Shape (N, actions).
        key: Random key.
        progress: Share of the learning done.
    """

    observation: Array
    mask: Array | None
    noise: Array
    key: Array
    progress: Array


class ReplayState(NamedTuple):
    """Everything a learner with a memory carries.

    Attributes:
        networks: Parameters, targets and optimiser.
        environments: State of the environments.
        memory: A Ring, or a Prioritised one.
        window: The last n transitions of each environment. Shape (n, N, width).
        noise: State of correlated exploration noise. Shape (N, actions).
        observed: Statistics of observations.
        scale: Statistics of returns.
        key: Random key.
    """

    networks: Networks
    environments: env.Environments
    memory: Any
    window: Array
    noise: Array
    observed: learner.Moments
    scale: learner.ReturnScale
    key: Array


ReplayConfig = TypeVar("ReplayConfig", bound=AbstractReplayConfig)
Explore = Callable[[env.Environments, Array, Array], tuple[Array, Array]]


def repeat(
    function: Callable[[Any, Array], tuple[Any, Any]], carry: Any, key: Array, times: int
) -> tuple[Any, Any]:
    """Scan over ``times`` keys; a loop of one would cost as much as a small network."""
    if times > 1:
        return jax.lax.scan(function, carry, jax.random.split(key, times))
    carry, out = function(carry, key)
    return carry, jax.tree.map(lambda x: x[None], out)


class AbstractReplayLearner(learner.AbstractLearner[ReplayConfig], Generic[ReplayConfig]):
    """A learner with a memory of transitions.

    Args:
        config: Configuration.
        task: Task to learn.
        actions: Numbers of continuous actions, or of choices.
        prioritised: True for the prioritised memory, False for the uniform one.
    """

    def __init__(self, config: ReplayConfig, task: AbstractTask, actions: int, *, prioritised: bool) -> None:
        self.config = config
        self.task = task
        self.actions = actions
        self.prioritised = prioritised
        self.iteration_steps = config.collect * config.environments
        columns = {
            "observation": task.observation_size,
            "action": 1 if task.action_space.discrete else actions,
        }
        columns |= {"reward": 1, "discount": 1, "next_observation": task.observation_size}
        # traced only: whether the task has a mask decides the width of a row
        if jax.eval_shape(lambda key: task.action_mask(task.reset(key)[0]), jax.random.key(0)) is not None:
            columns["next_mask"] = actions
        self.layout = replay.RowLayout(tuple(columns.items()))
        self.raw = replay.RowLayout((*columns.items(), ("done", 1)))

    def _policy_spec(self, output: Literal["tanh", "argmax", "dueling"], width: int) -> PolicySpec:
        """Meaning of the parameters of a policy of this configuration."""
        return PolicySpec(
            output=output,
            observation_size=self.task.observation_size,
            actions=self.actions,
            hidden=self.config.hidden,
            activation=self.config.activation,
            width=width,
            normalised=self.config.normalise_observations,
        )

    def _network(self, inputs: int, outputs: int, **last: float) -> MLP:
        """A network with the hidden layers of the configuration.

        Args:
            inputs: Length of its input.
            outputs: Length of its output.
            last: ``output_scale`` and ``output_bias`` of its last layer.
        """
        config = self.config
        return MLP((inputs, *config.hidden, outputs), config.activation, config.initialiser, **last)

    @abstractmethod
    def fresh(self, key: Array) -> Networks:
        """Parameters, targets and optimiser at the beginning."""

    @abstractmethod
    def explore(self, params: Params, now: Exploration) -> tuple[Array, Array]:
        """Actions for all environments, and the noise's new state.

        Args:
            params: Online parameters.
            now: All else that they follow from.
        """

    @abstractmethod
    def improve(
        self, networks: Networks, batch: Batch, key: Array, progress: Array
    ) -> tuple[Networks, dict[str, Array], Array]:
        """One gradient step: new networks, named losses, and the error of each transition, shape (B,)."""

    def init(self, key: Array) -> ReplayState:
        """Fresh networks, and a memory filled by random actions."""
        config = self.config
        net_key, env_key, warm_key, key = jax.random.split(key, 4)
        count = config.environments
        make = replay.prioritised_init if self.prioritised else replay.ring_init
        state = ReplayState(
            self.fresh(net_key),
            env.reset_environments(self.task, env_key, count),
            make(config.buffer_size, self.layout.width),
            jnp.zeros((config.n_step, count, self.raw.width), jnp.float32),
            jnp.zeros((count, self.actions), jnp.float32),
            learner.moments_init(self.task.observation_size),
            learner.return_scale_init(count),
            key,
        )

        def at_random(now: env.Environments, noise: Array, step_key: Array) -> tuple[Array, Array]:
            return env.random_actions(self.task, step_key, now), noise

        times = math.ceil(config.warmup / count)
        first, rest = jax.random.split(warm_key)
        if config.n_step > 1:
            keys = jax.random.split(first, config.n_step - 1)
            state = jax.lax.scan(lambda s, k: (self._step(s, at_random, k)[0], None), state, keys)[0]
        keys = jax.random.split(rest, max(1, times - config.n_step + 1))
        return jax.lax.scan(lambda s, k: (self._remember(s, at_random, k)[0], None), state, keys)[0]

    def iterate(self, state: ReplayState, progress: Array) -> tuple[ReplayState, learner.LearnerReport]:
        """``collect`` steps of every environment, then ``updates`` gradient steps."""
        key, collect_key, learn_key = jax.random.split(state.key, 3)
        params = state.networks.params
        statistics = self._statistics(state.observed)

        def act(now: env.Environments, noise: Array, step_key: Array) -> tuple[Array, Array]:
            seen = self._normalise(statistics, now.observation)
            masks = env.masks(self.task, now.state)
            return self.explore(params, Exploration(seen, masks, noise, step_key, progress))

        state, finished = repeat(
            lambda s, k: self._remember(s, act, k), state._replace(key=key), collect_key, self.config.collect
        )
        finished = jax.tree.map(lambda x: jnp.sum(x, axis=0), finished)
        state, losses = self._updates(state, learn_key, progress)
        return state, learner.LearnerReport(losses, finished)

    def policy(self, state: ReplayState) -> Params:
        """Policy network and statistics of observations."""
        return only_policy(self.spec, state.networks.params | self._statistics(state.observed))

    def _normalise(self, statistics: Params, observation: Array) -> Array:
        """Normalised observations, where there are statistics. Shape (B, O)."""
        return jax.vmap(lambda x: normalise(statistics, x, jnp))(observation)

    def _step(self, state: ReplayState, act: Explore, key: Array) -> tuple[ReplayState, env.Finished]:
        """Step every environment and put what happened at the end of the window."""
        act_key, env_key = jax.random.split(key)
        before = state.environments
        action, noise = act(before, state.noise, act_key)
        environments, step = env.step_environments(self.task, env_key, before, action)
        done = jnp.logical_or(step.terminated, step.truncated)
        fields = {
            "observation": before.observation,
            "action": action,
            "reward": step.reward,
            "discount": jnp.where(step.terminated, 0.0, self.config.gamma),
            "next_observation": step.observation,
            "done": done,
        }
        if step.mask is not None:
            fields["next_mask"] = step.mask
        window = jnp.concatenate([state.window[1:], self.raw.pack(fields)[None]])
        noise = jnp.where(done[:, None], 0.0, noise)
        state = state._replace(environments=environments, window=window, noise=noise)
        if self.config.normalise_observations:
            state = state._replace(observed=learner.moments_update(state.observed, step.observation))
        if self.config.reward_scaling:
            reward = step.reward * self.config.reward_factor
            state = state._replace(
                scale=learner.return_scale_update(state.scale, reward, done, self.config.gamma)
            )
        return state, step.finished

    def _remember(self, state: ReplayState, act: Explore, key: Array) -> tuple[ReplayState, env.Finished]:
        """Step every environment and write the transition that is now n steps old."""
        state, finished = self._step(state, act, key)
        rows = self.layout.pack(self._n_step(state.window))
        add = replay.prioritised_add if self.prioritised else replay.ring_add
        return state._replace(memory=add(state.memory, rows)), finished

    def _n_step(self, window: Array) -> dict[str, Array]:
        """The oldest transition of the window with the rewards up to its newest or the episode's end."""
        oldest = self.raw.unpack(window[0])
        alive = jnp.ones_like(oldest["reward"])
        total, discount = jnp.zeros_like(alive), alive
        last = oldest
        for k in range(self.config.n_step):
            fields = self.raw.unpack(window[k])
            total = total + alive * discount * fields["reward"]
            discount = jnp.where(alive > 0.0, discount * fields["discount"], discount)
            going = alive > 0.0
            last = {name: jnp.where(going, fields[name], last[name]) for name in last}
            alive = alive * (1.0 - fields["done"])
        ends = {name: last[name] for name in last if name.startswith("next_")}
        return oldest | ends | {"reward": total, "discount": discount}

    def _updates(
        self, state: ReplayState, key: Array, progress: Array
    ) -> tuple[ReplayState, dict[str, Array]]:
        """``updates`` gradient steps on rows of the memory."""
        config = self.config
        statistics = self._statistics(state.observed)
        factor = jnp.float32(config.reward_factor)
        if config.reward_scaling:
            factor = factor / learner.reward_divisor(state.scale)

        def uniform(networks: Networks, step_key: Array) -> tuple[Networks, dict[str, Array]]:
            draw_key, net_key = jax.random.split(step_key)
            rows, _ = replay.ring_sample(state.memory, draw_key, config.batch_size)
            weight = jnp.ones((config.batch_size,), jnp.float32)
            batch = self._batch(rows, weight, statistics, factor)
            networks, losses, _ = self.improve(networks, batch, net_key, progress)
            return networks, losses

        def by_priority(
            carry: tuple[Networks, Any], step_key: Array
        ) -> tuple[tuple[Networks, Any], dict[str, Array]]:
            networks, memory = carry
            draw_key, net_key = jax.random.split(step_key)
            beta = value_at(config.importance, progress)  # pyright: ignore[reportAttributeAccessIssue]
            rows, where, weight = replay.prioritised_sample(memory, draw_key, config.batch_size, beta)
            batch = self._batch(rows, weight, statistics, factor)
            networks, losses, priorities = self.improve(networks, batch, net_key, progress)
            return (networks, replay.prioritised_update(memory, where, priorities)), losses

        if self.prioritised:
            carry, losses = repeat(by_priority, (state.networks, state.memory), key, config.updates)
            state = state._replace(networks=carry[0], memory=carry[1])
        else:
            networks, losses = repeat(uniform, state.networks, key, config.updates)
            state = state._replace(networks=networks)
        return state, jax.tree.map(jnp.mean, losses)

    def _batch(self, rows: Array, weight: Array, statistics: Params, factor: Array) -> Batch:
        """Rows of the memory as the losses want them."""
        fields = self.layout.unpack(rows)
        mask = fields["next_mask"] > 0.5 if "next_mask" in fields else None
        return Batch(
            self._normalise(statistics, fields["observation"]),
            fields["action"],
            fields["reward"][:, 0] * factor,
            fields["discount"][:, 0],
            self._normalise(statistics, fields["next_observation"]),
            mask,
            weight,
        )
