"""One array namespace for NumPy and JAX: every formula of the plant is written once, over it.

A single drive in NumPy works on one number at a time, where NumPy's own ``where`` or ``clip`` cost a hundred
times the arithmetic between them. :data:`scalars` gives the same few functions for single numbers;
:func:`namespace` picks it, so that no formula knows. What runs dozens of times a step opts out of the
run-time type check of the test suite: its arguments are anything by design.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from typing import Any, no_type_check

import numpy as np

from metropilot._typing import Array, Float, Index, Scalar


@no_type_check
class scalars:  # noqa: N801 -- stands where a module does: numpy, jax.numpy, scalars
    """NumPy's functions of the same names, for single numbers; NaN wins, as in NumPy."""

    abs = abs
    exp = np.exp
    sqrt = math.sqrt
    tanh = math.tanh

    @staticmethod
    def maximum(a: Scalar, b: Scalar) -> Scalar:
        """The larger."""
        return a if a >= b or a != a else b  # noqa: PLR0124

    @staticmethod
    def minimum(a: Scalar, b: Scalar) -> Scalar:
        """The smaller."""
        return a if a <= b or a != a else b  # noqa: PLR0124

    @staticmethod
    def clip(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
        """Between two bounds."""
        least = x if x >= low or x != x else low  # noqa: PLR0124
        return least if least <= high or least != least else high  # noqa: PLR0124

    @staticmethod
    def where(condition: Scalar, yes: Any, no: Any) -> Any:
        """One or the other; both are computed, as everywhere."""
        return yes if condition else no

    @staticmethod
    def zeros_like(x: Scalar) -> Scalar:
        """Zero of the same number type."""
        return 0.0 * x


NAMESPACES: dict[type, Any] = {}
"""Namespaces of number types from elsewhere (:mod:`metropilot.aboard.branching` has one while it traces)."""
_SINGLE = frozenset({float, int, bool, np.float64, np.float32, np.bool_, np.int64})


@no_type_check
def namespace(*values: Any) -> Any:
    """``jax.numpy`` if any value lives in JAX, ``numpy`` if any is a NumPy array, else :data:`scalars`.

    JAX is never imported here unless a value already lives there.
    """
    found: Any = scalars
    for value in values:
        kind = type(value)
        if kind in _SINGLE:
            continue
        if kind in NAMESPACES:
            return NAMESPACES[kind]
        if kind.__module__.startswith("jax"):
            import jax.numpy as jnp

            return jnp
        if np.ndim(value):
            found = np
    return found


@no_type_check
def unless(done: Any, value: int, rest: Callable[..., Scalar], *given: Any) -> Index:
    """A number where ``done`` holds, elsewhere what ``rest(*given)`` says, an integer of shape ().

    For tests that are seldom needed: a single number tries them only if it must, and a compiled batch only if
    any of its members must. (A plain ``where`` or ``cond`` makes all members of a batch try both.)

    Args:
        done: True if the number is accepted.
        value: The number.
        rest: Gives the number elsewhere; it may use its arguments only.
        given: Numbers and tuples of them, or None.
    """
    xp = namespace(done)
    if xp is scalars:
        return value if done else rest(*given)
    if xp is np:
        return np.where(done, value, rest(*given))
    import jax
    import jax.numpy as jnp

    @jax.custom_batching.custom_vmap
    def seldom(done: Any, given: Any) -> Any:
        return jax.lax.cond(done, lambda _: jnp.int32(value), lambda g: jnp.int32(rest(*g)), given)

    @seldom.def_vmap
    def _(size: int, batched: Any, done: Any, given: Any) -> Any:
        axes = jax.tree.map(lambda along: 0 if along else None, batched[1])
        every = jax.vmap(lambda g: jnp.int32(rest(*g)), in_axes=(axes,), axis_size=size)
        done = jnp.broadcast_to(done, (size,))
        found = jax.lax.cond(jnp.all(done), lambda _: jnp.full((size,), value, jnp.int32), every, given)
        return jnp.where(done, value, found), True

    return seldom(done, given)


def repeat(count: int, step: Callable[..., Any], *state: Any) -> Any:
    """State after a number of equal steps; what runs aboard has a loop here, not the step so often.

    Args:
        count: Number of steps.
        step: From the state's parts to the same parts after it, a tuple.
        state: Parts at the beginning: numbers, arrays, and tuples of them.
    """
    for _ in range(count):
        state = step(*state)
    return state


@no_type_check
def locate(breaks: Float[Array, " breaks"], x: Scalar) -> Index:
    """Index of the piece that holds at ``x``: the last break not beyond it, at least 0.

    Padding breaks are infinite, so they are never chosen. In a compiled batch, counting beats a binary search
    on the short, padded lists of a section: it vectorises.

    Args:
        breaks: Increasing positions. Shape (K,).
        x: One position, or a list of them. Shape () or (N,).
    """
    xp = namespace(x) if type(breaks) is np.ndarray else namespace(breaks, x)
    if xp is scalars:
        return max(bisect_right(breaks, x) - 1, 0)
    if xp is np:
        return np.maximum(np.searchsorted(breaks, x, side="right") - 1, 0)
    reached = breaks <= x if xp.ndim(x) == 0 else xp.expand_dims(breaks, 0) <= xp.expand_dims(x, 1)
    return xp.maximum(xp.sum(reached, axis=-1) - 1, 0)


@no_type_check
def slice_from(values: Float[Array, " all"], first: Index, size: int) -> Float[Array, "... size"]:
    """``values[first:first + size]``, of which there are as many."""
    if isinstance(first, int):
        return values[first : first + size]
    if isinstance(first, np.ndarray):
        return values[first + np.arange(size)]
    import jax

    return jax.lax.dynamic_slice_in_dim(values, first, size)


@no_type_check
def least_between(values: Any, first: Index, last: Index) -> Scalar:
    """Least of ``values[first:last]``, an array or a list."""
    xp = namespace(first, last)
    if xp is scalars:
        part = values[first:last]
        return part.min() if type(part) is np.ndarray else min(part)
    places = xp.arange(len(values))
    return xp.where((places >= first) & (places < last), values, float("inf")).min()


def to_jax(tree: Any) -> Any:
    """The same tuple of arrays in JAX: what a compiled function must close over (imports JAX)."""
    import jax

    return jax.tree.map(jax.numpy.asarray, tree)
