"""Tabular Q-learning over several environments at once (Watkins and Dayan 1992, eq. 1)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from metropilot._typing import Float, Int


def td_error(
    table: Float[jax.Array, "S count"],
    cell: Int[jax.Array, " B"],
    choice: Int[jax.Array, " B"],
    reward: Float[jax.Array, " B"],
    next_value: Float[jax.Array, " B"],
) -> Float[jax.Array, " B"]:
    """``r + gamma max_a Q(s', a) - Q(s, a)`` (eq. 1).

    Args:
        table: Action values.
        cell: State of each environment.
        choice: Choice made there.
        reward: Reward received.
        next_value: Discounted value of the next state, zero where the episode terminated.
    """
    return reward + next_value - table[cell, choice]


def update(
    table: Float[jax.Array, "S count"],
    cell: Int[jax.Array, " B"],
    choice: Int[jax.Array, " B"],
    error: Float[jax.Array, " B"],
    rate: jax.Array | float,
) -> Float[jax.Array, "S count"]:
    """Move each visited entry by ``rate`` times its error; met by several environments, by their mean.

    Args:
        table: Action values.
        cell: State of each environment.
        choice: Choice made there.
        error: From :func:`td_error`.
        rate: Learning rate.
    """
    together = (cell[:, None] == cell[None, :]) & (choice[:, None] == choice[None, :])
    share = 1.0 / jnp.sum(together, axis=1).astype(error.dtype)
    return table.at[cell, choice].add(rate * error * share)
