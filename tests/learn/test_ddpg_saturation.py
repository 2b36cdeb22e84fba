"""The price that keeps DDPG's actor from the flat ends of tanh."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.learn.problems import DoubleIntegrator

from metropilot.errors import InputError
from metropilot.learn import DDPGConfig
from metropilot.learn.ddpg import DDPG
from metropilot.learn.off_policy import Batch


def asked_after(cost, steps=200):
    """Depth in the ends of an actor's actions after some steps under a critic that does not care."""
    config = DDPGConfig(saturation_cost=cost, initial_bias=4.0, critic_rate=0.0, actor_rate=1e-2, hidden=(8,))
    learner = DDPG(config, DoubleIntegrator())
    networks = learner.fresh(jax.random.key(0))
    flat = {k: v * (0.0 if k.startswith("critic.") else 1.0) for k, v in networks.params.items()}
    networks = networks._replace(params=flat, target=flat)
    size = learner.task.observation_size
    observation = jax.random.normal(jax.random.key(1), (32, size))
    zero, action = jnp.zeros(32), jnp.zeros((32, learner.actions))
    batch = Batch(observation, action, zero, zero, observation, None, zero + 1.0)
    step = jax.jit(lambda n: learner.improve(n, batch, jax.random.key(2), jnp.float32(0.0))[0])
    for _ in range(steps):
        networks = step(networks)
    return float(jnp.abs(learner.pre_tanh(networks.params, observation)).mean())


def test_the_price_brings_a_saturated_actor_back():
    assert asked_after(0.0) == pytest.approx(asked_after(0.0, steps=0))
    assert asked_after(0.0) > 3.0
    assert asked_after(0.01) < 0.7 * asked_after(0.0)
    assert np.isfinite(asked_after(1.0))
    with pytest.raises(InputError, match="saturation_cost"):
        DDPGConfig(saturation_cost=-1.0)
