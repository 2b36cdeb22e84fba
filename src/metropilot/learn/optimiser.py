"""Adam on a flat dict of arrays, with gradients clipped by their global norm.

Source: Kingma and Ba 2015, algorithm 1. Own, because optax computes its bias correction with a promotion that
strict JAX numerics forbid (decision 0002); a test compares the two.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from metropilot._typing import Array

Params = dict[str, Array]

BETA_1, BETA_2 = 0.9, 0.999


class AdamState(NamedTuple):
    """First and second moments, each shaped as the parameters, and ``beta^t`` of both.

    Attributes:
        first: Running mean of the gradient.
        second: Running mean of its square.
        decay_1: ``beta_1^t``. Shape ().
        decay_2: ``beta_2^t``. Shape ().
    """

    first: Params
    second: Params
    decay_1: Array
    decay_2: Array


def adam_init(params: Params) -> AdamState:
    """No moments yet."""
    one = jnp.ones((), jnp.float32)
    return AdamState(jax.tree.map(jnp.zeros_like, params), jax.tree.map(jnp.zeros_like, params), one, one)


def global_norm(tree: Any) -> Array:
    """Euclidean norm over every entry of a pytree. Shape ()."""
    return jnp.sqrt(sum((jnp.sum(x * x) for x in jax.tree.leaves(tree)), start=jnp.zeros((), jnp.float32)))


def adam_step(
    params: Params,
    gradient: Params,
    state: AdamState,
    learning_rate: Array | float,
    max_norm: float | None = None,
    epsilon: float = 1e-8,
) -> tuple[Params, AdamState]:
    """One step against the gradient.

    Args:
        params: Current parameters.
        gradient: Of the loss; same keys.
        state: Moments so far.
        learning_rate: Shape ().
        max_norm: Gradients longer than this are shortened to it.
        epsilon: Against division by zero.
    """
    scale = jnp.ones((), jnp.float32)
    if max_norm is not None:
        scale = jnp.minimum(1.0, max_norm / (global_norm(gradient) + 1e-6))
    decay_1, decay_2 = state.decay_1 * BETA_1, state.decay_2 * BETA_2
    rate = learning_rate / (1.0 - decay_1)
    correction = 1.0 / (1.0 - decay_2)
    moved, first, second = {}, {}, {}
    for name, value in params.items():
        g = gradient[name] * scale
        first[name] = BETA_1 * state.first[name] + (1.0 - BETA_1) * g
        second[name] = BETA_2 * state.second[name] + (1.0 - BETA_2) * g * g
        moved[name] = value - rate * first[name] / (jnp.sqrt(second[name] * correction) + epsilon)
    return moved, AdamState(first, second, decay_1, decay_2)


def polyak(target: Params, params: Params, tau: Array | float) -> Params:
    """Move a target towards the parameters: ``(1 - tau) target + tau params`` (Lillicrap et al. 2016)."""
    return jax.tree.map(lambda t, p: t + tau * (p - t), target, params)
