"""Soft actor-critic with twin critics and a learned temperature (Haarnoja et al. 2018b)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from metropilot._typing import Float


def critic_target(
    reward: Float[jax.Array, " B"],
    discount: Float[jax.Array, " B"],
    next_values: Float[jax.Array, "2 B"],
    next_log_prob: Float[jax.Array, " B"],
    temperature: jax.Array | float,
) -> Float[jax.Array, " B"]:
    """``y = r + discount * (min_i Q'_i(s', a') - alpha log pi(a'|s'))`` (eqs. 3 and 5, the lower twin).

    Args:
        reward: Discounted sum over the n steps.
        discount: gamma^n, zero where the episode terminated.
        next_values: Both target critics at the policy's own next action.
        next_log_prob: Log density of that action.
        temperature: alpha.
    """
    soft = jnp.min(next_values, axis=0) - temperature * next_log_prob
    return jax.lax.stop_gradient(reward + discount * soft)


def critic_loss(values: Float[jax.Array, "2 B"], target: Float[jax.Array, " B"]) -> Float[jax.Array, ""]:
    """``sum over the twins of mean (Q_i - y)^2 / 2`` (eq. 5)."""
    return 0.5 * jnp.sum(jnp.mean((values - target[None, :]) ** 2, axis=1))


def actor_loss(
    values: Float[jax.Array, "2 B"], log_prob: Float[jax.Array, " B"], temperature: jax.Array | float
) -> Float[jax.Array, ""]:
    """``mean(alpha log pi(a|s) - min_i Q_i(s, a))`` at reparametrised actions (eqs. 7 and 9)."""
    return jnp.mean(temperature * log_prob - jnp.min(values, axis=0))


def temperature_loss(
    log_temperature: Float[jax.Array, ""], log_prob: Float[jax.Array, " B"], target_entropy: float
) -> Float[jax.Array, ""]:
    """``mean(-alpha (log pi + H))`` (eq. 18): alpha grows while the entropy is below its target ``H``."""
    gap = jax.lax.stop_gradient(jnp.mean(log_prob) + target_entropy)
    return -jnp.exp(log_temperature) * gap
