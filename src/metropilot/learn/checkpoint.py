"""The whole state of a run in one file, so that a run that was stopped goes on as if it had not been.

Parameters, optimiser, memory, environments, random keys and counters are one pytree; each leaf is stored
under its path in that tree. Nothing is pickled: the tree's shape comes from the configuration, only numbers
from the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from metropilot._tensors import read_tensors, write_tensors
from metropilot.errors import InputError

Tree = Any

FORMAT = 1
MAX_BYTES = 16 << 30
STATE, HISTORY = "state", "history."


def _is_key(leaf: Any) -> bool:
    """Tell if a leaf is a typed random key."""
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def save_checkpoint(
    path: Path, state: Tree, history: Mapping[str, np.ndarray], about: Mapping[str, Any]
) -> None:
    """Write a checkpoint over the previous one, whole or not at all.

    Args:
        path: File to write.
        state: Pytree of arrays.
        history: Rows so far, one array a column.
        about: Plain values that must be the same when the run goes on, and whatever else is to be remembered.

    Raises:
        InputError: The file cannot be written.
    """
    arrays = {}
    for where, leaf in jax.tree_util.tree_flatten_with_path(state)[0]:
        numbers = jax.random.key_data(leaf) if _is_key(leaf) else leaf
        arrays[STATE + jax.tree_util.keystr(where)] = np.asarray(numbers)
    arrays |= {HISTORY + name: np.asarray(column, np.float64) for name, column in history.items()}
    write_tensors(path, arrays, {"format": FORMAT, "about": dict(about)})


def load_checkpoint(path: Path, template: Tree) -> tuple[Tree, dict[str, np.ndarray], dict[str, Any]]:
    """Read a checkpoint.

    Args:
        path: The file.
        template: Shapes and dtypes of the state, from ``jax.eval_shape``.

    Returns:
        State, history and what was remembered about the run.

    Raises:
        InputError: The file cannot be read, is damaged, or belongs to a run of another shape.
    """
    arrays, metadata = read_tensors(path, MAX_BYTES)
    if metadata.get("format") != FORMAT or not isinstance(metadata.get("about"), dict):
        raise InputError(
            "unknown format", file=path, field="format", value=metadata.get("format"), allowed=str(FORMAT)
        )
    leaves, tree = jax.tree_util.tree_flatten_with_path(template)
    names = [STATE + jax.tree_util.keystr(where) for where, _ in leaves]
    history = {
        name.removeprefix(HISTORY): array for name, array in arrays.items() if name.startswith(HISTORY)
    }
    if set(names) != {name for name in arrays if not name.startswith(HISTORY)}:
        raise InputError("checkpoint is of another learner or version", file=path)
    restored = [
        _restore(path, name, arrays[name], leaf) for name, (_, leaf) in zip(names, leaves, strict=True)
    ]
    return jax.tree_util.tree_unflatten(tree, restored), history, metadata["about"]


def _restore(path: Path, name: str, array: np.ndarray, leaf: Any) -> jax.Array:
    """One leaf, if it is of the shape and type expected. Copied, so that it may be donated."""
    expected = jax.eval_shape(jax.random.key_data, leaf) if _is_key(leaf) else leaf
    if array.shape != expected.shape or array.dtype != expected.dtype:
        found, allowed = f"{array.dtype} {array.shape}", f"{expected.dtype} {expected.shape}"
        raise InputError("checkpoint is of another run", file=path, field=name, value=found, allowed=allowed)
    # A copy: the program the state is given to takes over its memory, and must not take the file's.
    numbers = jnp.array(array, copy=True)
    return jax.random.wrap_key_data(numbers) if _is_key(leaf) else numbers
