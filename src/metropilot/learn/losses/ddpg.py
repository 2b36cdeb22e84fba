"""Deep deterministic policy gradient. Source: Lillicrap et al. 2016, algorithm 1 and eqs. 4 to 6."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from metropilot._typing import Float


def critic_target(
    reward: Float[jax.Array, " B"], discount: Float[jax.Array, " B"], next_value: Float[jax.Array, " B"]
) -> Float[jax.Array, " B"]:
    """``y = r + discount * Q'(s', mu'(s'))`` (eq. 5).

    Args:
        reward: Discounted sum over the n steps.
        discount: gamma^n, zero where the episode terminated.
        next_value: The target critic at the target actor's action.
    """
    return jax.lax.stop_gradient(reward + discount * next_value)


def critic_loss(value: Float[jax.Array, " B"], target: Float[jax.Array, " B"]) -> Float[jax.Array, ""]:
    """``mean (Q(s, a) - y)^2`` (eq. 4)."""
    return jnp.mean((value - target) ** 2)


def actor_loss(value: Float[jax.Array, " B"]) -> Float[jax.Array, ""]:
    """``-mean Q(s, mu(s))``, whose gradient is eq. 6 with the sign of a loss.

    Args:
        value: The critic at the actor's own actions; only the actor is moved by it.
    """
    return -jnp.mean(value)
