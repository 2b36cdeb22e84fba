"""Networks of learners: initial parameters, distributions of actions, NAF's matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from metropilot._typing import Array
from metropilot.policy import Activation, Params, forward

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


Initialiser = Literal["orthogonal", "he", "uniform"]


@dataclass(frozen=True)
class MLP:
    """A multilayer perceptron with a linear last layer.

    Attributes:
        sizes: Inputs, hidden widths, outputs.
        activation: Between the layers.
        initialiser: Orthogonal (gain sqrt 2), He uniform, or uniform within 1/sqrt(inputs) as Lillicrap's
            DDPG.
        output_scale: The last layer begins smaller by this factor.
        output_bias: Initial output of the last layer, whatever the observation.
    """

    sizes: tuple[int, ...]
    activation: Activation = "tanh"
    initialiser: Initialiser = "orthogonal"
    output_scale: float = 1.0
    output_bias: float = 0.0

    @property
    def layers(self) -> int:
        """Number of weight matrices."""
        return len(self.sizes) - 1

    def init(self, prefix: str, key: Array) -> Params:
        """Fresh parameters ``prefix.k.weight`` and ``prefix.k.bias``."""
        params = {}
        for k, (inputs, outputs) in enumerate(zip(self.sizes[:-1], self.sizes[1:], strict=True)):
            last = k == self.layers - 1
            weight = _initial(self, last, jax.random.fold_in(key, k), (inputs, outputs))
            params[f"{prefix}.{k}.weight"] = weight
            params[f"{prefix}.{k}.bias"] = jnp.full(
                (outputs,), self.output_bias if last else 0.0, jnp.float32
            )
        return params

    def apply(self, params: Params, prefix: str, x: Array) -> Array:
        """The output for one input vector, in JAX. Shape (outputs,)."""
        return forward(params, prefix, x, self.activation, jnp)


def _initial(net: MLP, last: bool, key: Array, shape: tuple[int, int]) -> Array:
    """One weight matrix (Saxe et al. 2014; He et al. 2015; Lillicrap et al. 2016, section 7)."""
    if net.initialiser == "orthogonal":
        gain = net.output_scale if last else 2.0**0.5
        return jax.nn.initializers.orthogonal(gain)(key, shape, jnp.float32)
    bound = (1.0 if net.initialiser == "uniform" else 3.0 if last else 6.0) / shape[0]
    bound = bound**0.5 * (net.output_scale if last else 1.0)
    return jax.random.uniform(key, shape, jnp.float32, -bound, bound)


def lower_triangle(entries: Array, size: int) -> Array:
    """The lower-triangular matrix of NAF, its diagonal made positive by ``exp`` (Gu et al. 2016 section 4).

    Args:
        entries: Row by row, diagonal included. Shape (size * (size + 1) / 2,).
        size: Number of actions.

    Returns:
        Shape (size, size).
    """
    rows, columns = np.tril_indices(size)
    entries = jnp.where(rows == columns, jnp.exp(jnp.clip(entries, -5.0, 5.0)), entries)
    return jnp.zeros((size, size), entries.dtype).at[rows, columns].set(entries)
