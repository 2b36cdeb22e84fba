"""Each loss against a number worked out by hand in the comment above it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.learn.losses import ddpg, dqn, naf, ppo, sac, tabular
from metropilot.learn.networks import (
    categorical_entropy,
    categorical_log_prob,
    floored_std,
    gaussian_entropy,
    gaussian_log_prob,
    lower_triangle,
    mask_values,
    squashed_sample,
)
from metropilot.policy import dueling


def f(*values):
    return jnp.asarray(values, jnp.float32)


def assert_close(actual, expected):
    np.testing.assert_allclose(np.asarray(actual), expected, rtol=1e-5, atol=1e-6)


def test_double_dqn_target():
    # Online values (1, 2, 0) choose action 1; the target network judges it 10: y = 1 + 0.9 * 10 = 10.
    # Second transition terminated: y = 5.
    chooser, judge = f([1, 2, 0], [3, 0, 0]), f([30, 10, 20], [7, 7, 7])
    assert_close(dqn.td_target(f(1, 5), f(0.9, 0.0), chooser, judge), [10.0, 5.0])
    # Plain DQN: the target network chooses its own largest, 30: y = 1 + 27 = 28.
    assert_close(dqn.td_target(f(1, 5), f(0.9, 0.0), judge, judge), [28.0, 5.0])


def test_dqn_target_obeys_the_filter():
    # Action 1 is forbidden; of (1, -, 0) action 0 is chosen and judged 30: y = 1 + 27 = 28.
    mask = jnp.asarray([[True, False, True]])
    assert_close(dqn.td_target(f(1), f(0.9), f([1, 2, 0]), f([30, 10, 20]), mask), [28.0])
    # Nothing is allowed: then everything is, action 1, y = 10.
    assert_close(dqn.td_target(f(1), f(0.9), f([1, 2, 0]), f([30, 10, 20]), ~mask & mask), [10.0])


def test_dqn_error_loss_and_priority():
    # delta = (2 - 1.5, 4 - 7) = (0.5, -3)
    error = dqn.td_error(f([2, 9], [9, 4]), jnp.asarray([0, 1]), f(1.5, 7))
    assert_close(error, [0.5, -3.0])
    # (1 * 0.125 + 0.5 * 4.5) / 2 = 1.1875; with Huber 1: (0.125 + 0.5 * (3 - 0.5)) / 2 = 0.6875
    assert_close(dqn.loss(error, f(1, 0.5)), 1.1875)
    assert_close(dqn.loss(error, f(1, 0.5), huber=1.0), 0.6875)
    # Lu23 eq. 12, exponent 1: 0.51, 3.01; square root of the latter: 1.734935
    assert_close(dqn.priority(error, 0.01, 1.0), [0.51, 3.01])
    assert_close(dqn.priority(error, 0.01, 0.5)[1], 1.734935)


def test_dueling_sum():
    # Lu23 eq. 10: mean advantage 2; 5 + (1 - 2, 3 - 2) = (4, 6)
    assert_close(dueling(f(5), f(1, 3)), [4.0, 6.0])


def test_gae_of_three_steps():
    # gamma 0.5, lambda 0.5. V = 1, 2, 3; next values 2, 3, 4; rewards 1, 1, 1; nothing ends.
    # delta = 1 + 0.5 * (2, 3, 4) - (1, 2, 3) = (1, 0.5, 0)
    # A3 = 0; A2 = 0.5 + 0.25 * 0 = 0.5; A1 = 1 + 0.25 * 0.5 = 1.125
    no = jnp.zeros(3, bool)
    args = (f(1, 1, 1), f(1, 2, 3), f(2, 3, 4))
    assert_close(ppo.gae(*args, no, no, (0.5, 0.5)), [1.125, 0.5, 0.0])
    # Terminated at the second step: its next value is gone, and nothing flows back over it.
    # delta_2 = 1 - 2 = -1; A1 = 1 + 0.25 * -1 = 0.75
    over = jnp.asarray([False, True, False])
    assert_close(ppo.gae(*args, over, no, (0.5, 0.5)), [0.75, -1.0, 0.0])
    # Cut off there: the value of the surviving observation (3) stays, delta_2 = 0.5, and only A3 stays out.
    # A3 changed to 1 by reward 2 shows it: A2 = 0.5, A1 = 1.125.
    assert_close(ppo.gae(f(1, 1, 2), f(1, 2, 3), f(2, 3, 4), no, over, (0.5, 0.5)), [1.125, 0.5, 1.0])


def test_gae_without_discount_is_the_return_minus_the_value():
    # gamma = lambda = 1, terminated at the end:
    # A1 = 1 + 2 + 3 - 0.5 = 5.5, A2 = 5 - 0.25 = 4.75, A3 = 3 - 1 = 2
    end, no = jnp.asarray([False, False, True]), jnp.zeros(3, bool)
    assert_close(ppo.gae(f(1, 2, 3), f(0.5, 0.25, 1), f(0.25, 1, 99), end, no, (1.0, 1.0)), [5.5, 4.75, 2.0])


def test_ppo_losses():
    # Ratios 1.5 and 0.5, advantages 1 and -1, clip 0.2:
    # min(1.5, 1.2) = 1.2; min(-0.5, -0.8) = -0.8; -mean = -0.2
    old = jnp.log(f(0.2, 0.4))
    new = jnp.log(f(0.3, 0.2))
    assert_close(ppo.policy_loss(new, old, f(1, -1), 0.2), -0.2)
    # Ratio 0.5 with advantage 1 is not clipped from below: min(0.5, 0.8) = 0.5; -(1.2 + 0.5) / 2 = -0.85
    assert_close(ppo.policy_loss(new, old, f(1, 1), 0.2), -0.85)
    # ((1 - 3)^2 + 0) / 2 / 2 = 1
    assert_close(ppo.value_loss(f(1, 2), f(3, 2)), 1.0)
    # (1.5 - 1 - ln 1.5 + 0.5 - 1 - ln 0.5) / 2 = (0.0945349 + 0.1931472) / 2 = 0.1438410
    assert_close(ppo.divergence(new, old), 0.143841)
    # mean 2, deviation 1
    assert_close(ppo.normalise_advantage(f(1, 3)), [-1.0, 1.0])


def test_ddpg_losses():
    # y = 1 + 0.9 * 2 = 2.8 and 1 + 0 = 1; ((3 - 2.8)^2 + (0 - 1)^2) / 2 = 0.52; actor: -(3 + 5) / 2 = -4
    wanted = ddpg.critic_target(f(1, 1), f(0.9, 0), f(2, 2)[None])
    assert_close(wanted, [2.8, 1.0])
    assert_close(ddpg.critic_loss(f(3, 0)[None], wanted), 0.52)
    assert_close(ddpg.actor_loss(f(3, 5)), -4.0)


def test_twin_critics_take_the_lower_one():
    # y = 1 + 0.9 * min(2, 3) = 2.8 and 1 + 0.9 * min(5, 1) = 1.9
    both = jnp.stack([f(2, 5), f(3, 1)])
    wanted = ddpg.critic_target(f(1, 1), f(0.9, 0.9), both)
    assert_close(wanted, [2.8, 1.9])
    # of each critic the mean of both squares: 0.8 and 3.1 off, 0.2 and 0.9 off
    assert_close(ddpg.critic_loss(both, wanted), 0.5 * (0.64 + 9.61) + 0.5 * (0.04 + 0.81))


def test_sac_losses():
    # min(4, 3) - 0.5 * (-2) = 4; y = 1 + 0.5 * 4 = 3
    wanted = sac.critic_target(f(1), f(0.5), f([4], [3]), f(-2), 0.5)
    assert_close(wanted, [3.0])
    # ((5 - 3)^2 + (2 - 3)^2) / 2 = 2.5
    assert_close(sac.critic_loss(f([5], [2]), wanted), 2.5)
    # 0.5 * (-2) - min(5, 2) = -3
    assert_close(sac.actor_loss(f([5], [2]), f(-2), 0.5), -3.0)
    # alpha = e^0 = 1, entropy 2 above its target -1:
    # loss = -1 * (-2 - 1) = 3; d/dlog alpha = 3, so alpha falls.
    value, slope = jax.value_and_grad(sac.temperature_loss)(jnp.float32(0.0), f(-2), -1.0)
    assert_close(value, 3.0)
    assert_close(slope, 3.0)


def test_naf_value_and_loss():
    # L = [[2, 0], [1, 3]], u - mu = (1, 1): L^T (1, 1) = (3, 3); Q = 7 - 18 / 2 = -2
    lower = f([2, 0], [1, 3])
    assert_close(naf.action_value(jnp.float32(7.0), f(0, 0), lower, f(1, 1)), -2.0)
    # y = 1 + 0.9 * 10 = 10; (8 - 10)^2 = 4
    assert_close(naf.loss(f(8), naf.target(f(1), f(0.9), f(10))), 4.0)
    # entries row by row; diagonal e^0 = 1 and e^1
    assert_close(lower_triangle(f(0, 5, 1), 2), [[1.0, 0.0], [5.0, 2.7182817]])


def test_tabular_update():
    # error = 1 + 0.5 - 2 = -0.5 at (0, 1), twice from two environments: moved once by 0.1 * -0.5, to 1.95.
    table = f([1, 2], [3, 4])
    cell, choice = jnp.asarray([0, 0, 1]), jnp.asarray([1, 1, 0])
    error = tabular.td_error(table, cell, choice, f(1, 1, 0), f(0.5, 0.5, 0))
    assert_close(error, [-0.5, -0.5, -3.0])
    assert_close(tabular.update(table, cell, choice, error, 0.1), [[1, 1.95], [2.7, 4]])


def test_gaussian():
    # N(1, 2) at 3: -0.5 - ln 2 - 0.9189385 = -2.1120857; entropy ln 2 + 1.4189385 = 2.1120857
    assert_close(gaussian_log_prob(f(3), f(1), f(2)), -2.1120857)
    assert_close(gaussian_entropy(f(2)), 2.1120857)
    # floor 0.1 + e^0
    assert_close(floored_std(f(0), 0.1), [1.1])


def test_squashed_gaussian_density_integrates_to_one():
    # The log density that comes with each sample, averaged as 1 / p over many samples,
    # gives the length of (-1, 1).
    sample = jax.vmap(lambda draw: squashed_sample(draw, f(0.3), f(-0.2)))
    action, log_prob = sample(jax.random.normal(jax.random.key(0), (200_000, 1)))
    inside = jnp.abs(action[:, 0]) < 0.9
    assert float(jnp.mean(jnp.where(inside, jnp.exp(-log_prob), 0.0))) == pytest.approx(1.8, rel=0.02)


def test_categorical():
    # logits ln(1, 3): p = 1/4, 3/4; entropy = 0.25 ln 4 + 0.75 ln(4/3) = 0.5623351
    logits = jnp.log(f(1, 3))
    assert_close(categorical_log_prob(logits, jnp.asarray(1)), np.log(0.75))
    assert_close(categorical_entropy(logits), 0.5623351)
    # The first is forbidden: the second is certain, and nothing is left to be uncertain about.
    only = mask_values(logits, jnp.asarray([False, True]))
    assert_close(categorical_log_prob(only, jnp.asarray(1)), 0.0)
    assert_close(categorical_entropy(only), 0.0)
