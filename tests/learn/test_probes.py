"""Every learner's critic finds the known value of every probe, and its policy the known best action."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.learn.problems import CONTINUOUS, KINDS, TWO_CHOICES, Probe

from metropilot.learn.config import DDPGConfig, DQNConfig, NAFConfig, PPOConfig, SACConfig, TabularConfig
from metropilot.learn.loop import make_learner
from metropilot.policy import act

GAMMA = 0.8
OBSERVATIONS = np.float32([-1.0, 0.0, 1 / 3, 2 / 3, 1.0])[:, None]
# Value at each observation that occurs (NaN: never seen there), and best action where it matters.
VALUES = {
    "constant": [np.nan, 1, np.nan, np.nan, np.nan],
    "observed": [-1, np.nan, np.nan, np.nan, 1],
    "discounted": [np.nan, GAMMA, np.nan, np.nan, 1],
    "action": [np.nan, 1, np.nan, np.nan, np.nan],
    "both": [1, np.nan, np.nan, np.nan, 1],
    "cut_off": [np.nan, 1 / (1 - GAMMA), np.nan, np.nan, np.nan],
    "terminated": [np.nan, 1 + GAMMA + GAMMA**2, 1 + GAMMA, 1, np.nan],
}

SMALL = {
    "gamma": GAMMA,
    "hidden": (16,),
    "environments": 8,
    "activation": "tanh",
    "initialiser": "orthogonal",
}
MEMORY = {"warmup": 64, "buffer_size": 1_024, "batch_size": 32, "tau": 0.1}
IMPROVED = {"double": True, "dueling": True, "prioritised": True}
CASES = {
    "ppo": (
        PPOConfig(**SMALL, rollout=8, epochs=4, minibatches=2, learning_rate=5e-3, initial_std=0.3),
        250,
        lambda learner, state, x: learner._value(state.params, x),
    ),
    "ppo_choices": (
        PPOConfig(**SMALL, rollout=8, epochs=4, minibatches=2, learning_rate=5e-3),
        250,
        lambda learner, state, x: learner._value(state.params, x),
    ),
    "ddpg": (
        DDPGConfig(**SMALL, **MEMORY, actor_rate=3e-3, critic_rate=1e-2),
        1_000,
        lambda learner, state, x: q_of_policy(learner, state.networks.params, x).min(),
    ),
    "sac": (
        SACConfig(
            **SMALL,
            **MEMORY,
            actor_rate=5e-3,
            critic_rate=1e-2,
            initial_temperature=1e-3,
            temperature_rate=0.0,
        ),
        1_000,
        lambda learner, state, x: q_of_policy(learner, state.networks.params, x).min(),
    ),
    "naf": (
        NAFConfig(**SMALL, **MEMORY, learning_rate=5e-3),
        1_200,
        lambda learner, state, x: learner.state_values(state.networks.params, x[None])[0],
    ),
    "dqn": (
        DQNConfig(**SMALL, **MEMORY, learning_rate=5e-3, target_period=0),
        800,
        lambda learner, state, x: learner.values(state.networks.params, x[None]).max(),
    ),
    "improved_dqn": (
        DQNConfig(**SMALL, **MEMORY, **IMPROVED, learning_rate=5e-3, target_period=20),
        500,
        lambda learner, state, x: learner.values(state.networks.params, x[None]).max(),
    ),
    "tabular": (
        TabularConfig(gamma=GAMMA, environments=8, bins=(7,), low=(-1.2,), high=(1.2,), learning_rate=0.3),
        40,
        lambda learner, state, x: (
            learner._cells(state.params, x[None])[0].astype(jnp.float32) * 0.0
            + state.params["policy.table"][learner._cells(state.params, x[None])[0]].max()
        ),
    ),
}
DISCRETE = {"ppo_choices", "dqn", "improved_dqn", "tabular"}


def q_of_policy(learner, params, x):
    action = jnp.stack([act(learner.spec, params, x)])
    return learner.values(params, x[None], action)[..., 0]


@pytest.fixture(scope="module", params=CASES, name="learned")
def learn_probes(request):
    """Values and actions of all probes at all observations, learned by one compiled program."""
    config, iterations, value = CASES[request.param]
    space = TWO_CHOICES if request.param in DISCRETE else CONTINUOUS

    def one(kind, key):
        learner = make_learner(config, Probe(kind, space))
        state = learner.init(key)
        progress = jnp.linspace(0.0, 1.0, iterations)
        state = jax.lax.scan(lambda s, p: (learner.iterate(s, p)[0], None), state, progress)[0]
        params = learner.policy(state)
        values = jax.vmap(lambda x: value(learner, state, x))(OBSERVATIONS)
        return values, jax.vmap(lambda x: act(learner.spec, params, x))(OBSERVATIONS)

    keys = jax.random.split(jax.random.key(3), len(KINDS))
    values, actions = jax.jit(jax.vmap(one))(jnp.arange(len(KINDS)), keys)
    return (
        request.param,
        dict(zip(KINDS, np.asarray(values), strict=True)),
        dict(zip(KINDS, np.asarray(actions), strict=True)),
    )


def test_critics_learn_the_known_values(learned):
    name, values, _ = learned
    # A stochastic policy's value lies below that of its best action by the cost of its scatter.
    wide = {"action", "both"} if name in {"ppo", "ppo_choices", "sac"} else set()
    # NAF lays a parabola through a value that is linear in the action.
    wide |= {"both"} if name == "naf" else set()
    for kind, expected in VALUES.items():
        seen = ~np.isnan(expected)
        tolerance = 0.1 if kind in wide else 0.03 * np.nanmax(np.abs(expected))
        np.testing.assert_allclose(
            values[kind][seen], np.asarray(expected)[seen], atol=tolerance, err_msg=kind
        )


def test_policies_learn_the_known_actions(learned):
    name, _, actions = learned
    if name in DISCRETE:
        assert actions["action"][1] == 1
        assert (actions["both"][0], actions["both"][4]) == (0, 1)
    else:
        assert actions["action"][1, 0] == pytest.approx(0.5, abs=0.1)
        assert actions["both"][0, 0] < -0.8
        assert actions["both"][4, 0] > 0.8
