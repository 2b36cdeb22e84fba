"""Every registered task jits, vmaps, is finite, deterministic per key, compiles once, and its terms sum."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.env import TASKS

BATCH, STEPS = 6, 40


def actions(task, key, count):
    if task.action_space.discrete:
        return jax.random.randint(key, (count,), 0, task.action_space.count)
    return jax.random.uniform(key, (count, task.action_space.size), jnp.float32, -0.5, 1.0)


def rollout(task, key):
    state, first = jax.vmap(task.reset)(jax.random.split(key, BATCH))

    def one(state, key):
        act_key, step_key = jax.random.split(key)
        action = actions(task, act_key, BATCH)
        state, transition = jax.vmap(task.step)(jax.random.split(step_key, BATCH), state, action)
        return state, transition

    state, transitions = jax.lax.scan(one, state, jax.random.split(key, STEPS))
    return first, state, transitions


@pytest.mark.parametrize("name", TASKS)
def test_contract(tasks, name):
    task = tasks(name)
    traces = []

    @jax.jit
    def compiled(key):
        traces.append(key)
        return rollout(task, key)

    first, _, transitions = compiled(jax.random.key(0))
    again = compiled(jax.random.key(0))
    other = compiled(jax.random.key(1))
    assert len(traces) == 1, "another key must not compile again"
    assert first.shape == (BATCH, task.observation_size)
    assert transitions.observation.shape == (STEPS, BATCH, task.observation_size)
    assert transitions.observation.dtype == transitions.reward.dtype == jnp.float32
    assert transitions.terminated.dtype == transitions.truncated.dtype == bool
    for leaf in jax.tree.leaves((first, transitions)):
        assert np.isfinite(np.asarray(leaf, np.float64)).all()
    for a, b in zip(
        jax.tree.leaves((first, transitions)), jax.tree.leaves((again[0], again[2])), strict=True
    ):
        np.testing.assert_array_equal(a, b)
    assert (np.asarray(other[2].observation) != np.asarray(transitions.observation)).any()
    total = sum(transitions.terms.values())
    np.testing.assert_allclose(transitions.reward, total, rtol=1e-6, atol=1e-6)
    assert not (transitions.terminated & transitions.truncated).any()
    assert np.abs(np.asarray(transitions.observation)).max() < 20, "features are scaled to a few units"
