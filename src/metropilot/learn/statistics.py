"""Running statistics: of observations, and of the discounted return for reward scaling."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from metropilot._typing import Array

EPSILON = 1e-8
# A return that varies less than this is taken as constant: rewards are then left as they are.
CONSTANT = 1e-6


class Moments(NamedTuple):
    """Mean and sum of squared differences from it, of everything seen so far.

    Attributes:
        count: Number of observations. Shape ().
        mean: Shape (K,).
        squares: Shape (K,).
    """

    count: Array
    mean: Array
    squares: Array


def moments_init(size: int) -> Moments:
    """Nothing seen."""
    return Moments(
        jnp.zeros((), jnp.float32), jnp.zeros((size,), jnp.float32), jnp.zeros((size,), jnp.float32)
    )


def moments_update(moments: Moments, batch: Array) -> Moments:
    """Take in a batch (Chan, Golub and LeVeque 1979). Batch of shape (B, K)."""
    number = jnp.float32(batch.shape[0])
    count = moments.count + number
    mean = jnp.mean(batch, axis=0)
    difference = mean - moments.mean
    squares = moments.squares + jnp.sum((batch - mean[None, :]) ** 2, axis=0)
    squares = squares + difference * difference * (moments.count * number / count)
    return Moments(count, moments.mean + difference * (number / count), squares)


def deviation(moments: Moments) -> Array:
    """Standard deviation; one before there are two samples. Shape (K,)."""
    variance = moments.squares / jnp.maximum(moments.count, 1.0)
    return jnp.where(moments.count > 1.0, jnp.sqrt(variance), jnp.ones_like(variance))


class ReturnScale(NamedTuple):
    """Statistics of returns, for reward scaling.

    Attributes:
        returned: Discounted return of each environment's running episode. Shape (N,).
        moments: Of that return over all environments and steps. Shape (1,) inside.
    """

    returned: Array
    moments: Moments


def return_scale_init(environments: int) -> ReturnScale:
    """Nothing seen."""
    return ReturnScale(jnp.zeros((environments,), jnp.float32), moments_init(1))


def return_scale_update(scale: ReturnScale, reward: Array, done: Array, gamma: float) -> ReturnScale:
    """Take in one step of every environment.

    Args:
        scale: So far.
        reward: Shape (N,).
        done: True where the episode ended. Shape (N,).
        gamma: Discount.
    """
    returned = scale.returned * gamma + reward
    moments = moments_update(scale.moments, returned[:, None])
    return ReturnScale(jnp.where(done, 0.0, returned), moments)


def reward_divisor(scale: ReturnScale) -> Array:
    """``sigma(R) + epsilon``: rewards are divided by it, no mean is subtracted (Chen23a eq. 23). Shape ().

    ``R`` is the running discounted return of each environment, as in Engstrom et al. 2020, on which the paper
    builds; taken literally as the deviation of the rewards it would not bound the critic's target.
    """
    sigma = deviation(scale.moments)[0]
    return jnp.where(sigma > CONSTANT, sigma, 1.0) + EPSILON
