"""Networks as plain functions of a flat dict of arrays, named as in the policy file and the ONNX graph.

Everything is written for one observation; batch with ``jax.vmap``. A layer ``policy.0`` is two entries,
``policy.0.weight`` of shape (inputs, outputs) and ``policy.0.bias`` of shape (outputs,). The forward
functions take their array namespace, so that a driver in the cab runs them in NumPy without importing JAX.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Literal

import numpy as np

Array = Any
Params = dict[str, Array]
Activation = Literal["tanh", "relu", "silu"]
Initialiser = Literal["orthogonal", "he", "uniform"]

ACTIVATIONS: tuple[Activation, ...] = ("tanh", "relu", "silu")


def activate(name: str, x: Array, xp: ModuleType) -> Array:
    """One of the three nonlinearities, elementwise.

    Args:
        name: Key of :data:`ACTIVATIONS`.
        x: Any shape.
        xp: ``numpy`` or ``jax.numpy``.
    """
    if name == "tanh":
        return xp.tanh(x)
    if name == "relu":
        return xp.maximum(x, 0.0)
    return x / (1.0 + xp.exp(-x))


@dataclass(frozen=True)
class MLP:
    """A multilayer perceptron with a linear last layer.

    Attributes:
        sizes: Inputs, hidden widths, outputs.
        activation: Between the layers.
        initialiser: Orthogonal (gain sqrt 2), He uniform, or uniform within 1/sqrt(inputs) as Lillicrap's
            DDPG.
        output_scale: The last layer begins smaller by this factor.
        output_bias: What the last layer gives at first, whatever the observation.
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
        import jax
        import jax.numpy as jnp

        params = {}
        for k, (inputs, outputs) in enumerate(zip(self.sizes[:-1], self.sizes[1:], strict=True)):
            last = k == self.layers - 1
            weight = _initial(self, last, jax.random.fold_in(key, k), (inputs, outputs))
            params[f"{prefix}.{k}.weight"] = weight
            params[f"{prefix}.{k}.bias"] = jnp.full(
                (outputs,), self.output_bias if last else 0.0, jnp.float32
            )
        return params

    def apply(self, params: Mapping[str, Array], prefix: str, x: Array) -> Array:
        """The output for one input vector, in JAX. Shape (outputs,)."""
        import jax.numpy as jnp

        return forward(params, prefix, x, self.activation, jnp)


def _initial(net: MLP, last: bool, key: Array, shape: tuple[int, int]) -> Array:
    """One weight matrix (Saxe et al. 2014; He et al. 2015; Lillicrap et al. 2016, section 7)."""
    import jax
    import jax.numpy as jnp

    if net.initialiser == "orthogonal":
        gain = net.output_scale if last else 2.0**0.5
        return jax.nn.initializers.orthogonal(gain)(key, shape, jnp.float32)
    bound = (1.0 if net.initialiser == "uniform" else 3.0 if last else 6.0) / shape[0]
    bound = bound**0.5 * (net.output_scale if last else 1.0)
    return jax.random.uniform(key, shape, jnp.float32, -bound, bound)


def forward(params: Mapping[str, Array], prefix: str, x: Array, activation: str, xp: ModuleType) -> Array:
    """Run the layers ``prefix.0``, ``prefix.1``, ... on one input; linear at the end.

    Args:
        params: Flat parameters.
        prefix: Which network of them.
        x: Input. Shape (inputs,) or, in NumPy, (batch, inputs).
        activation: Between the layers.
        xp: ``numpy`` or ``jax.numpy``.

    Returns:
        Output of the last layer. Shape (outputs,) or (batch, outputs).
    """
    k = 0
    while f"{prefix}.{k}.weight" in params:
        x = activate(activation, x, xp) if k else x
        x = x @ params[f"{prefix}.{k}.weight"] + params[f"{prefix}.{k}.bias"]
        k += 1
    return x


def dueling(value: Array, advantage: Array) -> Array:
    """Action values from state value and advantages, ``V + D - mean(D)`` (Lu23 eq. 10).

    Args:
        value: Shape (..., 1).
        advantage: Shape (..., count).
    """
    return value + (advantage - advantage.mean(-1, keepdims=True))


def lower_triangle(entries: Array, size: int) -> Array:
    """The lower-triangular matrix of NAF, its diagonal made positive by ``exp`` (Gu et al. 2016 section 4).

    Args:
        entries: Row by row, diagonal included. Shape (size * (size + 1) / 2,).
        size: Number of actions.

    Returns:
        Shape (size, size).
    """
    import jax.numpy as jnp

    rows, columns = np.tril_indices(size)
    entries = jnp.where(rows == columns, jnp.exp(jnp.clip(entries, -5.0, 5.0)), entries)
    return jnp.zeros((size, size), entries.dtype).at[rows, columns].set(entries)
