"""Deep Q-learning: double target, prioritised errors, importance weights, action filter.

Sources: Lu23 eqs. 7 to 12; Mnih et al. 2015; van Hasselt et al. 2016; Schaul et al. 2016. The dueling sum
(Lu23 eq. 10) is part of the network: :func:`metropilot.policy.networks.dueling`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from metropilot._typing import Bool, Float, Int
from metropilot.learn.networks import mask_values


def td_target(
    reward: Float[jax.Array, " B"],
    discount: Float[jax.Array, " B"],
    chooser: Float[jax.Array, "B count"],
    judge: Float[jax.Array, "B count"],
    mask: Bool[jax.Array, "B count"] | None = None,
) -> Float[jax.Array, " B"]:
    """The value to learn, ``y = r + discount * judge(s', argmax_a chooser(s', a))`` (Lu23 eq. 8).

    Args:
        reward: Discounted sum over the n steps.
        discount: gamma^n, zero where the episode terminated (not where it was cut off).
        chooser: Action values at the next state that choose: online for double Q-learning, else the target
            network's.
        judge: Action values of the target network there.
        mask: Choices allowed at the next state (Lu23's filter), None: all.
    """
    choice = jnp.argmax(mask_values(chooser, mask), axis=-1)
    value = jnp.take_along_axis(judge, choice[:, None], axis=-1)[:, 0]
    return jax.lax.stop_gradient(reward + discount * value)


def td_error(
    values: Float[jax.Array, "B count"], choice: Int[jax.Array, " B"], target: Float[jax.Array, " B"]
) -> Float[jax.Array, " B"]:
    """``delta = Q(s, a) - y`` (Lu23 eq. 11)."""
    return jnp.take_along_axis(values, choice[:, None], axis=-1)[:, 0] - target


def loss(
    error: Float[jax.Array, " B"], weight: Float[jax.Array, " B"], huber: float | None = None
) -> Float[jax.Array, ""]:
    """Mean of ``w * delta^2 / 2``, its gradient cut at ``huber`` (Schaul et al. 2016, algorithm 1).

    Args:
        error: Temporal-difference errors.
        weight: Importance weights of prioritised replay, ones for uniform replay.
        huber: Error at which the loss turns from square to linear; None: square everywhere.
    """
    square = 0.5 * error * error
    if huber is not None:
        size = jnp.abs(error)
        square = jnp.where(size <= huber, square, huber * (size - 0.5 * huber))
    return jnp.mean(weight * square)


def priority(error: Float[jax.Array, " B"], floor: float, exponent: float) -> Float[jax.Array, " B"]:
    """``(|delta| + l)^alpha`` (Lu23 eq. 12, where alpha is 1; Schaul et al. 2016 eq. 1)."""
    return (jnp.abs(error) + floor) ** exponent
