"""Many environments side by side, reset when their episode ends: the task itself never resets."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from metropilot._typing import Array
from metropilot.env import AbstractTask, TaskState

RENEWED = 8
"""At least so many environments are reset together."""


class Environments(NamedTuple):
    """State of each environment.

    Attributes:
        state: Of the task, with a leading axis.
        observation: Shape (N, O).
        returned: Reward of the running episodes so far. Shape (N,).
        length: Their steps so far. Shape (N,).
        terms: Their reward terms so far, each of shape (N,).
    """

    state: TaskState
    observation: Array
    returned: Array
    length: Array
    terms: dict[str, Array]


class Finished(NamedTuple):
    """Sums over the episodes that ended; divide by ``count``.

    Attributes:
        count: Episodes that ended. Shape ().
        returned: Sum of their returns. Shape ().
        length: Sum of their lengths. Shape ().
        terms: Sum of each of their reward terms. Shape () each.
    """

    count: Array
    returned: Array
    length: Array
    terms: dict[str, Array]


class Step(NamedTuple):
    """Outcome of one step of all environments, before any reset.

    Attributes:
        observation: Surviving observation after the step. Shape (N, O).
        reward: Shape (N,).
        terminated: Shape (N,).
        truncated: Shape (N,), never where terminated.
        mask: Choices allowed after the step, shape (N, count), or None.
        finished: Sums over episodes that ended.
    """

    observation: Array
    reward: Array
    terminated: Array
    truncated: Array
    mask: Array | None
    finished: Finished


def reset_environments(task: AbstractTask, key: Array, count: int) -> Environments:
    """Reset ``count`` environments, each from its own key."""
    state, observation = jax.vmap(task.reset)(jax.random.split(key, count))
    # The names of the reward terms are known once a step is traced; of the action only its shape matters.
    space = task.action_space
    action = jnp.zeros((count,), jnp.int32) if space.discrete else jnp.zeros((count, space.size), jnp.float32)
    shapes = jax.eval_shape(lambda: jax.vmap(task.step)(jax.random.split(key, count), state, action))
    zero = jnp.zeros((count,), jnp.float32)
    terms = dict.fromkeys(shapes[1].terms, zero)
    return Environments(state, observation.astype(jnp.float32), zero, jnp.zeros((count,), jnp.int32), terms)


def random_actions(task: AbstractTask, key: Array, environments: Environments) -> Array:
    """Even over [-1, 1], or over the allowed choices."""
    count = environments.returned.shape[0]
    if not task.action_space.discrete:
        return jax.random.uniform(key, (count, task.action_space.size), jnp.float32, -1.0, 1.0)
    mask = masks(task, environments.state)
    return random_choices(key, (count, task.action_space.count), mask)


def random_choices(key: Array, shape: tuple[int, int], mask: Array | None) -> Array:
    """One of the allowed choices for each environment. Mask of ``shape``; result of shape (N,), int32."""
    if mask is None:
        return jax.random.randint(key, shape[:1], 0, shape[1])
    # The largest of even draws is an even choice among those allowed; if none is, among all.
    usable = mask | ~jnp.any(mask, axis=-1, keepdims=True)
    draws = jnp.where(usable, jax.random.uniform(key, shape, jnp.float32), -1.0)
    return jnp.argmax(draws, axis=-1).astype(jnp.int32)


def masks(task: AbstractTask, state: TaskState) -> Array | None:
    """Choices allowed in each environment. Shape (N, count), or None where the task allows all."""
    return jax.vmap(task.action_mask)(state)


def step_environments(
    task: AbstractTask, key: Array, environments: Environments, action: Array
) -> tuple[Environments, Step]:
    """Step every environment, then reset those whose episode ended.

    Args:
        task: The task.
        key: Random key; every environment gets two of its own.
        environments: State of the environments.
        action: Shape (N, A), or (N,) choices.
    """
    count = environments.returned.shape[0]
    step_key, reset_key = jax.random.split(key)
    state, transition = jax.vmap(task.step)(jax.random.split(step_key, count), environments.state, action)
    observation = transition.observation.astype(jnp.float32)
    reward = transition.reward.astype(jnp.float32)
    terminated = transition.terminated
    truncated = transition.truncated & ~terminated
    done = terminated | truncated
    returned, length = environments.returned + reward, environments.length + 1
    terms = {
        name: old + transition.terms[name].astype(jnp.float32) for name, old in environments.terms.items()
    }
    finished = Finished(
        jnp.sum(done).astype(jnp.float32),
        _over(done, returned),
        _over(done, length.astype(jnp.float32)),
        {name: _over(done, value) for name, value in terms.items()},
    )
    step = Step(observation, reward, terminated, truncated, masks(task, state), finished)
    fresh = (returned, length, terms)
    fresh = jax.tree.map(lambda x: jnp.where(done, jnp.zeros_like(x), x), fresh)

    state, observation = _renew(task, reset_key, done, (state, observation))
    return Environments(state, observation, *fresh), step


def _renew(task: AbstractTask, key: Array, done: Array, now: tuple[TaskState, Array]) -> tuple[Any, Any]:
    """States and observations with a fresh episode wherever one ended.

    Few of many environments end in one step, and a new episode costs as much as a step: so many are begun at
    a time as usually end, again until none is left.
    """
    count = done.shape[0]
    some = min(count, max(RENEWED, count // 64))

    def renew(carry: tuple[Array, Any]) -> tuple[Array, Any]:
        ended, old = carry
        index = jnp.nonzero(ended, size=some, fill_value=count)[0]
        state, observation = jax.vmap(task.reset)(jax.vmap(jax.random.fold_in, (None, 0))(key, index))
        new = state, observation.astype(jnp.float32)
        put = jax.tree.map(lambda a, b: a.at[index].set(b, mode="drop"), old, new)
        return ended.at[index].set(False, mode="drop"), put

    return jax.lax.while_loop(lambda carry: jnp.any(carry[0]), renew, (done, now))[1]


def _over(done: Array, values: Array) -> Array:
    """Sum of the values of ended episodes. Shape ()."""
    return jnp.sum(jnp.where(done, values, 0.0))


def evaluate(task: AbstractTask, act: Any, key: Array, episodes: int, steps: int) -> dict[str, Array]:
    """Mean return, length and reward terms of whole episodes, all from one key.

    Args:
        task: The task.
        act: ``(observation, mask) -> action`` for one environment.
        key: Random key of starts and disturbances: the same key, the same episodes.
        episodes: Number of episodes.
        steps: Steps at which an episode is cut off.

    Returns:
        ``return``, ``length``, ``terminated`` (share that ended by itself), ``term.NAME`` each; all of shape
        ().
    """
    begin = reset_environments(task, key, episodes)

    def one(carry: tuple[Environments, Array, Array], k: Array) -> tuple[Any, None]:
        now, alive, ended = carry
        keys = jax.random.split(jax.random.fold_in(key, k), episodes)
        action = jax.vmap(act)(now.observation, masks(task, now.state))
        state, transition = jax.vmap(task.step)(keys, now.state, action)
        live = alive.astype(jnp.float32)
        terms = {
            name: old + live * transition.terms[name].astype(jnp.float32) for name, old in now.terms.items()
        }
        returned = now.returned + live * transition.reward.astype(jnp.float32)
        length = now.length + alive.astype(jnp.int32)
        after = Environments(state, transition.observation.astype(jnp.float32), returned, length, terms)
        ended = ended | (alive & transition.terminated)
        return (after, alive & ~transition.terminated & ~transition.truncated, ended), None

    alive = jnp.ones((episodes,), bool)
    (last, _, ended), _ = jax.lax.scan(
        one, (begin, alive, ~alive), jnp.arange(1, steps + 1, dtype=jnp.uint32)
    )
    row = {
        "return": jnp.mean(last.returned),
        "length": jnp.mean(last.length.astype(jnp.float32)),
        "terminated": jnp.mean(ended.astype(jnp.float32)),
    }
    return row | {f"term.{name}": jnp.mean(value) for name, value in last.terms.items()}
