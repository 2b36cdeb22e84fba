"""Environments side by side: those whose episode ended begin anew, and no other."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.env import AbstractTask, ActionSpace, Transition
from metropilot.learn import environments as env

TWO_CHOICES = ActionSpace(count=2)


class Drawn(NamedTuple):
    number: jax.Array
    time: jax.Array


@dataclass(frozen=True)
class Draws(AbstractTask):
    """Each episode draws a number; the action says whether it is over."""

    observation_size: int = 1
    action_space: ActionSpace = TWO_CHOICES

    def reset(self, key):
        state = Drawn(jax.random.uniform(key, (), jnp.float32), jnp.zeros((), jnp.int32))
        return state, state.number[None]

    def step(self, key, state, action):
        del key
        state = state._replace(time=state.time + 1)
        seen = -state.number[None]
        return state, Transition(seen, jnp.ones(()), action == 1, jnp.zeros((), bool), {"one": jnp.ones(())})


TASK, COUNT = Draws(), 200


@jax.jit
def advanced(environments, over):
    return env.step_environments(TASK, jax.random.key(1), environments, over)


@pytest.mark.parametrize("ended", [0, 1, 8, 9, 100, 200])
def test_only_what_ended_is_renewed(ended):
    before = env.reset_environments(TASK, jax.random.key(0), COUNT)
    over = np.zeros(COUNT, np.int32)
    over[np.random.default_rng(ended).choice(COUNT, ended, replace=False)] = 1
    after, step = advanced(before, jnp.asarray(over))
    over = over.astype(bool)
    fresh, old = np.asarray(after.state.number), np.asarray(before.state.number)
    assert (fresh[over] != old[over]).all()
    assert np.unique(fresh).size == COUNT, "every episode is its own"
    np.testing.assert_array_equal(fresh[~over], old[~over])
    np.testing.assert_array_equal(after.state.time, np.where(over, 0, 1))
    np.testing.assert_array_equal(after.observation[:, 0], np.where(over, fresh, -old))
    np.testing.assert_array_equal(after.length, np.where(over, 0, 1))
    np.testing.assert_array_equal(step.observation[:, 0], -old)
    assert float(step.finished.count) == ended
