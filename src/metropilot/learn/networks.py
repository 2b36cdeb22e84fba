"""Initial parameters of networks, and NAF's matrix; :mod:`metropilot.policy.networks` runs them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metropilot._typing import Array
from metropilot.policy import Activation, Params, forward

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
