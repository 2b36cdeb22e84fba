"""Q-learning with normalised advantage functions. Source: Gu et al. 2016, eqs. 4 and 5, algorithm 1."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from metropilot._typing import Float


def action_value(
    value: Float[jax.Array, ""],
    best: Float[jax.Array, " A"],
    lower: Float[jax.Array, "A A"],
    action: Float[jax.Array, " A"],
) -> Float[jax.Array, ""]:
    """``Q = V - (u - mu)^T L L^T (u - mu) / 2``: a parabola whose top is the best action (eqs. 4 and 5).

    Args:
        value: State value, the value of the best action.
        best: The best action.
        lower: Lower-triangular matrix with a positive diagonal.
        action: Action whose value is wanted.
    """
    reach = lower.T @ (action - best)
    return value - 0.5 * jnp.sum(reach * reach)


def target(
    reward: Float[jax.Array, " B"], discount: Float[jax.Array, " B"], next_value: Float[jax.Array, " B"]
) -> Float[jax.Array, " B"]:
    """``y = r + discount * V'(s')`` (algorithm 1); discount is zero where the episode terminated."""
    return jax.lax.stop_gradient(reward + discount * next_value)


def loss(value: Float[jax.Array, " B"], wanted: Float[jax.Array, " B"]) -> Float[jax.Array, ""]:
    """``mean (Q(s, u) - y)^2`` (algorithm 1)."""
    return jnp.mean((value - wanted) ** 2)
