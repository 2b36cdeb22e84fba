"""One array namespace for NumPy and JAX: every formula of the plant is written once, over it."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

Scalar = Any
"""A 0-d float of whichever namespace is in use (NumPy scalar, JAX array or tracer)."""


def namespace(*values: Any) -> ModuleType:
    """``jax.numpy`` if any value lives in JAX, else ``numpy``; never imports JAX by itself."""
    for value in values:
        if type(value).__module__.startswith("jax"):
            import jax.numpy as jnp

            return jnp
    return np


def locate(breaks: Any, x: Scalar) -> Scalar:
    """Index of the piece that holds at ``x``: the last break not beyond it, at least 0.

    Padding breaks are infinite, so they are never chosen. Counting beats a binary search on the short,
    padded lists of a section: it vectorises.

    Args:
        breaks: Increasing positions. Shape (K,).
        x: One position.
    """
    xp = namespace(breaks, x)
    return xp.maximum(xp.sum(breaks <= x) - 1, 0)


def to_jax(tree: Any) -> Any:
    """The same tuple of arrays in JAX: what a compiled function must close over (imports JAX)."""
    import jax

    return jax.tree.map(jax.numpy.asarray, tree)
