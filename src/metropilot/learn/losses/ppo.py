"""Proximal policy optimisation with generalised advantage estimation.

Sources: Schulman et al. 2017 eqs. 7, 9 and 11; Schulman et al. 2016 (GAE) eqs. 11 and 16; Huang25 eqs. 28 to
31.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from metropilot._typing import Bool, Float


def gae(
    reward: Float[jax.Array, " T"],
    value: Float[jax.Array, " T"],
    next_value: Float[jax.Array, " T"],
    terminated: Bool[jax.Array, " T"],
    truncated: Bool[jax.Array, " T"],
    factors: tuple[float, float],
) -> Float[jax.Array, " T"]:
    """Advantages of one environment's steps (GAE eq. 16).

    ``delta_t = r_t + gamma V(s_{t+1}) - V(s_t)`` (eq. 11) where ``s_{t+1}`` is the observation that the step
    gave, the surviving last one if the episode ended there. A terminated episode has no value after it; a
    truncated one goes on, so its value stays in ``delta`` and only the sum over later steps ends.

    Args:
        reward: Of each step.
        value: Of the observation before each step.
        next_value: Of the observation after each step, before any reset.
        terminated: The episode is over by its own rules.
        truncated: The episode was cut off.
        factors: gamma and lambda; gamma = 1 is fine for episodes that end.
    """
    gamma, lambda_ = factors
    delta = reward + gamma * jnp.where(terminated, 0.0, next_value) - value
    carry_on = jnp.where(terminated | truncated, 0.0, gamma * lambda_)

    def back(later: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        now = step[0] + step[1] * later
        return now, now

    return jax.lax.scan(back, jnp.zeros_like(delta[0]), (delta, carry_on), reverse=True)[1]


def policy_loss(
    log_prob: Float[jax.Array, " B"],
    old_log_prob: Float[jax.Array, " B"],
    advantage: Float[jax.Array, " B"],
    clip: jax.Array | float,
) -> Float[jax.Array, ""]:
    """Minus the clipped surrogate, ``-mean(min(rho A, clip(rho) A))`` (PPO eq. 7; Huang25 eq. 31)."""
    ratio = jnp.exp(log_prob - old_log_prob)
    return -jnp.mean(jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - clip, 1.0 + clip) * advantage))


def value_loss(value: Float[jax.Array, " B"], target: Float[jax.Array, " B"]) -> Float[jax.Array, ""]:
    """Half the mean squared error of the critic (PPO eq. 9, the middle term)."""
    return 0.5 * jnp.mean((value - target) ** 2)


def divergence(
    log_prob: Float[jax.Array, " B"], old_log_prob: Float[jax.Array, " B"]
) -> Float[jax.Array, ""]:
    """Estimate of KL(old, new), ``mean(rho - 1 - log rho)``: never negative, low variance (Schulman 2020)."""
    log_ratio = log_prob - old_log_prob
    return jnp.mean(jnp.exp(log_ratio) - 1.0 - log_ratio)


def normalise_advantage(advantage: Float[jax.Array, " B"]) -> Float[jax.Array, " B"]:
    """Advantages with mean zero and deviation one over the minibatch."""
    return (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)
