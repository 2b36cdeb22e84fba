"""Deep deterministic policy gradient (Lillicrap et al. 2016, algorithm 1), and its twin-critic form, TD3.

Numbers of equations are those of Lillicrap et al. 2016; TD3 is Fujimoto, van Hoof and Meger 2018.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from metropilot._typing import Float


def critic_target(
    reward: Float[jax.Array, " B"], discount: Float[jax.Array, " B"], next_values: Float[jax.Array, "Q B"]
) -> Float[jax.Array, " B"]:
    """``y = r + discount * min_i Q'_i(s', mu'(s'))`` (eq. 5; with two critics TD3's eq. 10).

    Args:
        reward: Discounted sum over the n steps.
        discount: gamma^n, zero where the episode terminated.
        next_values: The target critics, one or two, at the target actor's action.
    """
    return jax.lax.stop_gradient(reward + discount * jnp.min(next_values, axis=0))


def critic_loss(values: Float[jax.Array, "Q B"], target: Float[jax.Array, " B"]) -> Float[jax.Array, ""]:
    """``mean (Q_i(s, a) - y)^2`` (eq. 4), the sum over the critics."""
    return jnp.sum(jnp.mean((values - target[None, :]) ** 2, axis=1))


def actor_loss(value: Float[jax.Array, " B"]) -> Float[jax.Array, ""]:
    """``-mean Q(s, mu(s))``, whose gradient is eq. 6 with the sign of a loss.

    Args:
        value: The critic at the actor's own actions; only the actor is moved by it.
    """
    return -jnp.mean(value)
