"""Networks as plain functions of a flat dict of arrays, named as in the policy file and the ONNX graph.

Everything is written for one observation; batch with ``jax.vmap``. A layer ``policy.0`` is two entries,
``policy.0.weight`` of shape (inputs, outputs) and ``policy.0.bias`` of shape (outputs,). The functions take
their array namespace, so that a driver in the cab runs them in NumPy without importing JAX.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import Any, Literal

Array = Any
Params = dict[str, Array]
Activation = Literal["tanh", "relu", "silu"]

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
