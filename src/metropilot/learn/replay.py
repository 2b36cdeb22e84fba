"""Replay memories: a uniform ring, and a prioritised one with an 8-ary sum tree.

The ring is one 2-D array, a transition a row. It is only ever written by one ``dynamic_update_slice`` in the
carry of a scan whose input is donated, and never passes through ``cond`` or ``where``: anything else makes
XLA copy it every step, so that a step would take longer the larger the memory is. A test holds the step time
flat.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from metropilot._typing import Array

BRANCHES = 8


@dataclass(frozen=True)
class RowLayout:
    """Columns of each field of a transition in its row.

    Attributes:
        widths: Field name and number of columns, in order.
    """

    widths: tuple[tuple[str, int], ...]

    @property
    def width(self) -> int:
        """Columns of a row."""
        return sum(width for _, width in self.widths)

    def pack(self, fields: Mapping[str, Array]) -> Array:
        """Rows of a batch. Each field has shape (B,) or (B, columns); the result (B, width), float32."""
        columns = [jnp.reshape(fields[name], (-1, width)).astype(jnp.float32) for name, width in self.widths]
        return jnp.concatenate(columns, axis=1)

    def unpack(self, rows: Array) -> dict[str, Array]:
        """The fields of some rows, each of shape (B, columns)."""
        fields, start = {}, 0
        for name, width in self.widths:
            fields[name] = rows[:, start : start + width]
            start += width
        return fields


class Ring(NamedTuple):
    """A ring of transitions.

    Attributes:
        rows: Shape (capacity, width).
        position: Row of the next batch. Shape (), int32.
        size: Number of filled rows. Shape (), int32.
    """

    rows: Array
    position: Array
    size: Array


def ring_init(capacity: int, width: int) -> Ring:
    """An empty ring; ``capacity`` must be a multiple of the batch that is added at a time."""
    rows = jnp.zeros((capacity, width), jnp.float32)
    return Ring(rows, jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))


def ring_add(ring: Ring, rows: Array) -> Ring:
    """Write a batch over the oldest rows. Rows of shape (B, width)."""
    capacity, batch = ring.rows.shape[0], rows.shape[0]
    written = jax.lax.dynamic_update_slice(ring.rows, rows, (ring.position, jnp.zeros((), jnp.int32)))
    return Ring(written, (ring.position + batch) % capacity, jnp.minimum(ring.size + batch, capacity))


def ring_sample(ring: Ring, key: Array, batch: int) -> tuple[Array, Array]:
    """Rows drawn evenly with replacement.

    Returns:
        Rows, shape (batch, width), and where they stand, shape (batch,).
    """
    indices = jax.random.randint(key, (batch,), 0, ring.size)
    return ring.rows[indices], indices


Tree = tuple[Array, ...]


def tree_init(capacity: int) -> Tree:
    """A sum tree of zeros: leaves first, each level an eighth of the one below, the last eight long."""
    levels = []
    count = capacity
    while True:
        count = -(-count // BRANCHES) * BRANCHES
        levels.append(jnp.zeros((count,), jnp.float32))
        if count == BRANCHES:
            return tuple(levels)
        count //= BRANCHES


def tree_total(tree: Tree) -> Array:
    """Sum over all leaves. Shape ()."""
    return jnp.sum(tree[-1])


def tree_set(tree: Tree, indices: Array, values: Array) -> Tree:
    """Give leaves new values and sum their ancestors anew (no drift). Both of shape (B,)."""
    levels = [tree[0].at[indices].set(values)]
    for level in tree[1:]:
        indices = indices // BRANCHES
        children = indices[:, None] * BRANCHES + jnp.arange(BRANCHES, dtype=indices.dtype)[None, :]
        levels.append(level.at[indices].set(jnp.sum(levels[-1][children], axis=1)))
    return tuple(levels)


def tree_find(tree: Tree, mass: Array) -> tuple[Array, Array]:
    """The leaf under each point of the cumulated sum, never one of value zero.

    Leaves must be read here and nowhere else: a second read that nothing orders before the next write makes
    XLA copy all of them in every step.

    Args:
        tree: The sum tree.
        mass: Points in [0, total). Shape (B,).

    Returns:
        Leaf indices, shape (B,), int32, and their values, shape (B,).
    """
    indices, value = jnp.zeros(mass.shape, jnp.int32), mass
    for level in reversed(tree):
        children = indices[:, None] * BRANCHES + jnp.arange(BRANCHES, dtype=jnp.int32)[None, :]
        values = level[children]
        upto = jnp.cumsum(values, axis=1)
        past = jnp.sum(upto <= mass[:, None], axis=1)
        last = BRANCHES - 1 - jnp.argmax((values > 0.0)[:, ::-1], axis=1)
        choice = jnp.minimum(past, last).astype(jnp.int32)
        value = jnp.take_along_axis(values, choice[:, None], axis=1)[:, 0]
        before = jnp.take_along_axis(upto, choice[:, None], axis=1)[:, 0] - value
        mass = jnp.maximum(mass - before, 0.0)
        indices = indices * BRANCHES + choice
    return indices, value


class Prioritised(NamedTuple):
    """A ring whose rows are drawn in proportion to their priority.

    Attributes:
        ring: The transitions.
        tree: Their priorities.
        highest: Largest priority so far, which new rows get. Shape ().
    """

    ring: Ring
    tree: Tree
    highest: Array


def prioritised_init(capacity: int, width: int) -> Prioritised:
    """An empty prioritised ring ."""
    return Prioritised(ring_init(capacity, width), tree_init(capacity), jnp.ones((), jnp.float32))


def prioritised_add(memory: Prioritised, rows: Array) -> Prioritised:
    """Write a batch over the oldest rows, at the highest priority met so far. Rows of shape (B, width)."""
    indices = memory.ring.position + jnp.arange(rows.shape[0], dtype=jnp.int32)
    tree = tree_set(memory.tree, indices, jnp.full(rows.shape[:1], memory.highest))
    return Prioritised(ring_add(memory.ring, rows), tree, memory.highest)


def prioritised_sample(
    memory: Prioritised, key: Array, batch: int, beta: Array | float
) -> tuple[Array, Array, Array]:
    """Rows drawn by priority, one from each of ``batch`` equal strata of the total.

    Importance weights are ``(N P(i))^-beta`` over their largest in the batch (Schaul et al. 2016, section
    3.4).

    Returns:
        Rows, shape (batch, width); where they stand, shape (batch,); importance weights, shape (batch,).
    """
    total = tree_total(memory.tree)
    points = (jnp.arange(batch, dtype=jnp.float32) + jax.random.uniform(key, (batch,), jnp.float32)) / batch
    indices, value = tree_find(memory.tree, points * total)
    share = value / total
    weights = (memory.ring.size.astype(jnp.float32) * share) ** -beta
    return memory.ring.rows[indices], indices, weights / jnp.max(weights)


def prioritised_update(memory: Prioritised, indices: Array, priorities: Array) -> Prioritised:
    """Give rows new priorities. Both of shape (B,)."""
    highest = jnp.maximum(memory.highest, jnp.max(priorities))
    return Prioritised(memory.ring, tree_set(memory.tree, indices, priorities), highest)
