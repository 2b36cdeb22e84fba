"""Distributions over actions: Gaussian, tanh-squashed Gaussian, categorical. For one observation; no classes.

Source: Haarnoja et al. 2018b, appendix C, for the squashed Gaussian.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from metropilot._typing import Array

LOG_2PI = 1.8378770664093453
LOG_2 = 0.6931471805599453
# Bounds of SAC's log standard deviation (Haarnoja et al.'s code).
LOG_STD = (-5.0, 2.0)


def gaussian_log_prob(action: Array, mean: Array, std: Array) -> Array:
    """Log density of independent Gaussians, summed over the actions.

    Args:
        action: Shape (A,).
        mean: Shape (A,).
        std: Shape (A,).

    Returns:
        Shape ().
    """
    z = (action - mean) / std
    return jnp.sum(-0.5 * z * z - jnp.log(std) - 0.5 * LOG_2PI)


def gaussian_entropy(std: Array) -> Array:
    """Entropy of independent Gaussians, ``sum(log std) + A/2 log(2 pi e)``. Shape ()."""
    return jnp.sum(jnp.log(std) + 0.5 * (1.0 + LOG_2PI))


def floored_std(log_std: Array, floor: Array | float) -> Array:
    """Standard deviation ``floor + exp(log_std)``: never below the floor, and never without gradient.

    Args:
        log_std: Shape (A,).
        floor: Least deviation (the entropy floor).
    """
    return floor + jnp.exp(log_std)


def squashed_sample(draw: Array, mean: Array, log_std: Array) -> tuple[Array, Array]:
    """A sample of ``tanh(N(mean, std))`` and its log density (Haarnoja et al. 2018b, eq. 21).

    ``log(1 - tanh(x)^2)`` is written ``2 (log 2 - x - softplus(-2x))``, which does not lose digits.

    Args:
        draw: Of a standard Gaussian. Shape (A,).
        mean: Shape (A,).
        log_std: Clipped to :data:`LOG_STD`. Shape (A,).

    Returns:
        Action in (-1, 1), shape (A,), and its log density, shape ().
    """
    std = jnp.exp(jnp.clip(log_std, *LOG_STD))
    raw = mean + std * draw
    change = 2.0 * (LOG_2 - raw - jax.nn.softplus(-2.0 * raw))
    return jnp.tanh(raw), gaussian_log_prob(raw, mean, std) - jnp.sum(change)


def mask_values(values: Array, mask: Array | None) -> Array:
    """Values (logits, action values) with those of forbidden choices at a very low number.

    Args:
        values: Shape (..., count).
        mask: True where allowed, same shape; None: all. If nothing is allowed, everything is.
    """
    if mask is None:
        return values
    usable = mask | ~jnp.any(mask, axis=-1, keepdims=True)
    return jnp.where(usable, values, -1e9)


def categorical_log_prob(logits: Array, choice: Array) -> Array:
    """Log probability of one choice. Logits shape (count,), choice and result shape ()."""
    return jax.nn.log_softmax(logits)[choice]


def categorical_entropy(logits: Array) -> Array:
    """Entropy of a categorical distribution. Logits shape (count,), result shape ()."""
    log_p = jax.nn.log_softmax(logits)
    return -jnp.sum(jnp.exp(log_p) * jnp.where(log_p > -1e8, log_p, 0.0))
