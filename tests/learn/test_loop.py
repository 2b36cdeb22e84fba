"""The loop: same key, same bits; seeds under vmap; the best kept; a control problem solved."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.learn.problems import DoubleIntegrator, Masked, best_return

from metropilot.env import ActionSpace
from metropilot.errors import InputError
from metropilot.learn import (
    DDPGConfig,
    DQNConfig,
    NAFConfig,
    PPOConfig,
    SACConfig,
    Schedule,
    TabularConfig,
    learn,
    make_loop,
)
from metropilot.policy import act

FIVE = ActionSpace(count=5)
TINY = {"steps": 128, "environments": 4, "evaluations": 2, "evaluation_steps": 5, "evaluation_episodes": 2}
NET = {"hidden": (8,), "normalise_observations": True, "reward_scaling": True}
MEMORY = {"warmup": 16, "buffer_size": 64, "batch_size": 8, "n_step": 2}
LEARNERS = {
    "ppo": (PPOConfig(**TINY, **NET, rollout=16, epochs=2, minibatches=2), DoubleIntegrator()),
    "ppo_choices": (PPOConfig(**TINY, **NET, rollout=16, epochs=2, minibatches=2), Masked()),
    "ddpg": (DDPGConfig(**TINY, **NET, **MEMORY, noise_kind="ornstein_uhlenbeck"), DoubleIntegrator()),
    "sac": (SACConfig(**TINY, **NET, **MEMORY, updates=2), DoubleIntegrator()),
    "naf": (NAFConfig(**TINY, **NET, **MEMORY), DoubleIntegrator()),
    "dqn": (
        DQNConfig(**TINY, **NET, **MEMORY, double=True, dueling=True, prioritised=True, collect=2),
        Masked(),
    ),
    "tabular": (TabularConfig(**TINY), DoubleIntegrator(FIVE)),
}


# Their seeds under vmap are one more compilation of what sac and ppo have shown: that one is saved.
SAME_LOOP = {"ddpg", "naf", "ppo_choices"}


@pytest.mark.parametrize("name", LEARNERS)
def test_same_key_same_bits_and_seeds_under_vmap(name):
    config, task = LEARNERS[name]
    keys = jax.random.split(jax.random.key(1), 2)
    one = jax.jit(partial(learn, config, task))
    first, again, other = one(keys[0]), one(keys[0]), one(keys[1])
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert any(
        np.any(a != b) for a, b in zip(jax.tree.leaves(first[0]), jax.tree.leaves(other[0]), strict=True)
    )
    if name in SAME_LOOP:
        return
    both = jax.jit(jax.vmap(partial(learn, config, task)))(keys)
    for row, single in enumerate((first, other)):
        for a, b in zip(jax.tree.leaves(both), jax.tree.leaves(single), strict=True):
            np.testing.assert_allclose(a[row], b, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("name", ["dqn", "ppo_choices"])
def test_forbidden_choices_are_never_taken(name):
    config, task = LEARNERS[name]
    _, history = jax.jit(partial(learn, config, task))(jax.random.key(0))
    # The task's term "forbidden" counts them.
    np.testing.assert_array_equal(history["evaluation.term.forbidden"], 0.0)
    episodes = np.asarray(history["episodes"])
    np.testing.assert_array_equal(np.asarray(history["term.forbidden"])[episodes > 0], 0.0)
    assert episodes.sum() > 0


def test_the_best_policy_is_kept_and_the_earlier_of_equals():
    """Scores 1, 3, 3, 2: the policy after the second chunk stays; ``last`` keeps the fourth."""

    def score_table(params, key):
        # The evaluation counts chunks by an entry of the table, which the test moves by one a chunk.
        scores = jnp.asarray([0.0, 1.0, 3.0, 3.0, 2.0])
        return {"score": scores[jnp.round(params["policy.table"][0, 0]).astype(jnp.int32)]}

    for keep, expected in (("best", 2.0), ("last", 4.0)):
        config = TabularConfig(**TINY | {"evaluations": 4}, learning_rate=0.0, keep=keep)
        loop = make_loop(config, DoubleIntegrator(FIVE), score_table)
        state = loop.init(jax.random.key(0))
        chunk = jax.jit(loop.chunk)
        for k in range(4):
            table = jnp.full_like(state.best["policy.table"], k + 1.0)
            learner = state.learner._replace(params=state.learner.params | {"policy.table": table})
            state, _ = chunk(state._replace(learner=learner))
        assert float(state.best["policy.table"][0, 0]) == expected


def test_a_score_that_is_not_a_number_is_never_the_best():
    config, task = LEARNERS["tabular"]
    policy, _ = learn(config, task, jax.random.key(0), lambda params, key: {"score": jnp.float32(jnp.nan)})
    np.testing.assert_array_equal(policy.params["policy.table"], 0.0)


def test_history_counts_what_was_done():
    config, task = LEARNERS["ppo"]
    _, history = learn(config, task, jax.random.key(0))
    np.testing.assert_array_equal(history["steps"], [64.0, 128.0])
    for name, value in history.items():
        assert value.shape == (2,), name


def test_learners_refuse_the_wrong_kind_of_action():
    with pytest.raises(InputError, match="needs continuous actions"):
        make_loop(SACConfig(), DoubleIntegrator(FIVE))
    with pytest.raises(InputError, match="needs choices"):
        make_loop(DQNConfig(), DoubleIntegrator())
    with pytest.raises(InputError, match="1 or 2, the length of the observation"):
        make_loop(TabularConfig(bins=(3, 3, 3)), DoubleIntegrator(FIVE))


SOLVE = {"gamma": 0.95, "environments": 8, "evaluations": 5, "evaluation_steps": 40, "hidden": (32, 32)}
REPLAY = {"warmup": 512, "buffer_size": 40_000, "batch_size": 128, "tau": 0.02, "updates": 2}
TD3 = {"twin": True, "smoothing": 0.2, "delay": 2}
SOLVERS = {
    # Within which share of the optimum's cost; five choices cannot do better than about 1.15.
    "ppo": (
        PPOConfig(**SOLVE, steps=80_000, rollout=80, minibatches=4, learning_rate=Schedule(2e-3, 1e-4)),
        1.1,
    ),
    "sac": (SACConfig(**SOLVE, **REPLAY, steps=24_000, actor_rate=1e-3, initial_temperature=0.05), 1.15),
    "ddpg": (DDPGConfig(**SOLVE, **REPLAY, steps=48_000), 1.4),
    "td3": (DDPGConfig(**SOLVE, **REPLAY, **TD3, steps=48_000), 1.4),
    "dqn": (
        DQNConfig(**SOLVE, **REPLAY, steps=48_000, learning_rate=1e-3, double=True, target_period=0),
        1.4,
    ),
    "tabular": (TabularConfig(**SOLVE, steps=200_000, bins=(15,), learning_rate=0.3), 1.4),
}


@pytest.mark.parametrize("name", SOLVERS)
def test_a_mass_is_brought_to_rest(name):
    config, share = SOLVERS[name]
    task = DoubleIntegrator(FIVE if name in {"dqn", "tabular"} else ActionSpace(size=1))
    policy, _ = jax.jit(partial(learn, config, task))(jax.random.key(0))
    keys = jax.random.split(jax.random.key(99), 64)
    state, observation = jax.vmap(task.reset)(keys)
    optimum, total = best_return(np.asarray(state.position)), 0.0
    step = jax.jit(jax.vmap(lambda s, o: task.step(keys[0], s, act(policy.spec, policy.params, o))))
    for _ in range(task.last):
        state, transition = step(state, observation)
        observation, total = transition.observation, total + float(transition.reward.mean())
    assert optimum * share < total <= optimum * 0.99, (total, optimum)
