"""Networks and policies: shapes, NumPy and JAX agreeing, optimiser and statistics against others."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.learn.problems import FIVE_CHOICES, DoubleIntegrator

from metropilot.learn.config import DDPGConfig, DQNConfig, NAFConfig, PPOConfig, SACConfig, TabularConfig
from metropilot.learn.learner import (
    deviation,
    moments_init,
    moments_update,
    return_scale_init,
    return_scale_update,
    reward_divisor,
)
from metropilot.learn.loop import make_learner
from metropilot.learn.networks import MLP
from metropilot.learn.optimiser import adam_init, adam_step, global_norm, polyak
from metropilot.policy import Policy, PolicySpec, act

MEMORY = {"warmup": 8, "buffer_size": 64, "environments": 4}
POLICIES = {
    "ppo": PPOConfig(environments=4, activation="silu", normalise_observations=True),
    "ppo_choices": PPOConfig(environments=4),
    "ddpg": DDPGConfig(**MEMORY),
    "sac": SACConfig(**MEMORY, normalise_observations=True),
    "naf": NAFConfig(**MEMORY),
    "dqn": DQNConfig(**MEMORY),
    "dueling": DQNConfig(**MEMORY, dueling=True, hidden=(16, 8)),
    "tabular": TabularConfig(environments=4, bins=(4, 3)),
}
DISCRETE = {"ppo_choices", "dqn", "dueling", "tabular"}


@pytest.fixture(params=POLICIES)
def learner(request):
    task = DoubleIntegrator(FIVE_CHOICES) if request.param in DISCRETE else DoubleIntegrator()
    return make_learner(POLICIES[request.param], task)


def test_policies_have_the_shapes_they_declare_and_act_alike_in_numpy_and_jax(learner):
    params = learner.policy(jax.jit(learner.init)(jax.random.key(0)))
    assert {name: value.shape for name, value in params.items()} == learner.spec.shapes()
    host = {name: np.asarray(value) for name, value in params.items()}
    observations = np.asarray(jax.random.normal(jax.random.key(1), (20, 2)))
    in_jax = jax.vmap(lambda x: act(learner.spec, params, x))(observations)
    in_numpy = [Policy(learner.spec, host)(x) for x in observations]
    np.testing.assert_allclose(np.asarray(in_jax), np.stack(in_numpy), atol=1e-6)


def test_masks_and_empty_masks():
    spec = PolicySpec("argmax", 1, 3, (), "tanh", 3)
    params = {"policy.0.weight": np.zeros((1, 3), np.float32), "policy.0.bias": np.float32([1, 3, 2])}
    policy, nothing = Policy(spec, params), np.zeros(1, np.float32)
    assert policy(nothing) == 1
    assert policy(nothing, np.asarray([True, False, True])) == 2
    assert policy(nothing, np.zeros(3, bool)) == 1


def test_table_cells_cover_the_grid_and_beyond():
    spec = PolicySpec("table", 2, 6, (2, 3), "tanh", 6)
    params = {
        "policy.table": np.eye(6, dtype=np.float32),
        "policy.low": np.float32([0, 0]),
        "policy.high": np.float32([1, 3]),
    }
    policy = Policy(spec, params)
    points = [(0.1, 0.5), (0.1, 1.5), (0.1, 9.0), (0.6, -5.0), (0.6, 1.5), (7.0, 2.5)]
    assert [int(policy(np.float32(point))) for point in points] == list(range(6))


@pytest.mark.parametrize("initialiser", ["orthogonal", "he", "uniform"])
def test_first_weights(initialiser):
    net = MLP((64, 64, 2), initialiser=initialiser, output_scale=0.01, output_bias=0.5)
    params = net.init("net", jax.random.key(0))
    if initialiser == "orthogonal":
        weight = params["net.0.weight"]
        np.testing.assert_allclose(weight.T @ weight, 2.0 * np.eye(64), atol=1e-5)
    else:
        # uniform within b has variance b^2 / 3: He 2 / inputs, Lillicrap 1 / (3 inputs)
        expected = 2.0 / 64 if initialiser == "he" else 1.0 / (3 * 64)
        assert float(params["net.0.weight"].var()) == pytest.approx(expected, rel=0.1)
    out = net.apply(params, "net", jnp.ones(64))
    np.testing.assert_allclose(out, 0.5, atol=0.1)


def test_adam_against_optax():
    optax = pytest.importorskip("optax")
    params = {"a": jnp.asarray([1.0, -2.0]), "b": jnp.asarray([[0.5]])}
    ours, theirs, state = params, params, adam_init(params)
    with jax.numpy_dtype_promotion("standard"):
        other = optax.chain(optax.clip_by_global_norm(0.7), optax.adam(0.1))
        memory = other.init(params)
    for k in range(5):
        gradient = {"a": jnp.asarray([1.0, 0.3 * k]), "b": jnp.asarray([[-0.2]])}
        ours, state = adam_step(ours, gradient, state, 0.1, max_norm=0.7)
        with jax.numpy_dtype_promotion("standard"):
            update, memory = other.update(gradient, memory)
            theirs = optax.apply_updates(theirs, update)
    for name in params:
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-4)


def test_norm_and_polyak():
    assert float(global_norm({"a": jnp.asarray([3.0]), "b": jnp.asarray([4.0])})) == pytest.approx(5.0)
    moved = polyak({"a": jnp.asarray([1.0])}, {"a": jnp.asarray([3.0])}, 0.25)
    np.testing.assert_allclose(moved["a"], 1.5)


def test_running_moments_are_those_of_everything():
    batches = np.random.default_rng(0).normal(5.0, 3.0, (7, 10, 2)).astype(np.float32)
    moments = moments_init(2)
    np.testing.assert_array_equal(deviation(moments), 1.0)
    for batch in batches:
        moments = moments_update(moments, jnp.asarray(batch))
    flat = batches.reshape(-1, 2)
    np.testing.assert_allclose(moments.mean, flat.mean(0), rtol=1e-5)
    np.testing.assert_allclose(deviation(moments), flat.std(0), rtol=1e-5)


def test_reward_scaling_divides_by_the_deviation_of_the_discounted_return():
    # One environment, gamma 0.5, rewards 2, 2 | 4 (the episode ends after the second):
    # R = 2, then 0.5 * 2 + 2 = 3, then 0 + 4 = 4; mean 3, deviation sqrt(2/3) = 0.8164966.
    scale = return_scale_init(1)
    for reward, done in ((2.0, False), (2.0, True), (4.0, False)):
        scale = return_scale_update(scale, jnp.asarray([reward]), jnp.asarray([done]), 0.5)
    assert float(reward_divisor(scale)) == pytest.approx(0.8164966, rel=1e-5)
    # Returns that never vary are left alone.
    constant = return_scale_update(return_scale_init(3), jnp.ones(3), jnp.ones(3, bool), 0.5)
    assert float(reward_divisor(constant)) == pytest.approx(1.0)
