"""Many trainsets on many sections in one compiled program: pad to common sizes, stack, scan.

A different section, trainset or load is only different numbers in arrays of the same shape, so
:func:`rollout_batch` compiles once for all of them::

    vehicles, tracks = grid(line.sections(), [trainset.with_load(load) for load in trainset.loads])
    states = stack([at_rest(vehicle)] * batch_size(vehicles))
    final, speeds = rollout_batch(*to_jax((vehicles, tracks, states)), shares, 0.1, record=speed_of)

Number type: the arrays decide. float32 is JAX's default and what learning wants; for float64 build the arrays
in float64 and call within :func:`double_precision`, or JAX silently rounds them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

import numpy as np

from metropilot._typing import Array, Float, Scalar
from metropilot.physics.build import track_arrays, vehicle_arrays
from metropilot.physics.plant import Command, step
from metropilot.physics.types import Forces, State, Track, Vehicle
from metropilot.railway import Section, Trainset

Tree = TypeVar("Tree", Vehicle, Track, State, Forces)
Record = Callable[[State], Any]

# Where a piece begins: padded with infinity, so that it is never chosen. Everything else repeats its last.
BREAKS = frozenset(
    {
        "traction_from_mps",
        "brake_from_mps",
        "efficiency_speed_mps",
        "efficiency_share",
        "node_m",
        "limit_from_m",
    }
)


def stack(trees: Sequence[Tree]) -> Tree:
    """One tuple with a leading batch axis, its lists padded to the longest of each (NumPy).

    Padding changes no result: padded breaks lie at infinity, padded values repeat the last.

    Args:
        trees: Vehicles, tracks or states; at least one.
    """
    columns = {}
    for name in trees[0]._fields:
        values = [getattr(tree, name) for tree in trees]
        columns[name] = stack(values) if isinstance(values[0], tuple) else _stack(name, values)
    return trees[0]._replace(**columns)


def _stack(name: str, values: Sequence[Array]) -> np.ndarray:
    arrays = [np.asarray(value) for value in values]
    shape = tuple(max(sizes) for sizes in zip(*(a.shape for a in arrays), strict=True))
    return np.stack([_pad(a, shape, name in BREAKS) for a in arrays])


def _pad(array: np.ndarray, shape: tuple[int, ...], is_break: bool) -> np.ndarray:
    if array.shape == shape:
        return array
    extra = [(0, wanted - have) for wanted, have in zip(shape, array.shape, strict=True)]
    if is_break:
        return np.pad(array, extra, constant_values=np.inf)
    return np.pad(array, extra, mode="edge")


def grid(
    sections: Sequence[Section], trainsets: Sequence[Trainset], dtype: type = np.float32
) -> tuple[Vehicle, Track]:
    """Every section with every trainset (a load is a trainset), sections varying slowest.

    Args:
        sections: Sections.
        trainsets: Trainsets, each with its load aboard.
        dtype: Number type.

    Returns:
        Vehicles and tracks, each with ``len(sections) * len(trainsets)`` rows.
    """
    vehicles = [vehicle_arrays(trainset, dtype) for trainset in trainsets]
    tracks = [track_arrays(section, trainset, dtype) for section in sections for trainset in trainsets]
    return stack(vehicles * len(sections)), stack(tracks)


def batch_size(tree: Vehicle | Track | State) -> int:
    """The length of the leading axis of a stacked tuple."""
    return int(np.shape(tree[0])[0])


def rollout(
    vehicle: Vehicle,
    track: Track,
    state: State,
    commands: Float[Array, " periods"],
    dt: Scalar,
    *,
    integrator: str = "held",
    record: Record | None = None,
) -> tuple[State, Any]:
    """Drive one trainset through a sequence of commands as one ``lax.scan`` (JAX).

    Args:
        vehicle: The trainset.
        track: The section.
        state: State at the start.
        commands: Command of each control period, in [-1, 1].
        dt: Control period, s.
        integrator: A key of ``INTEGRATORS``.
        record: Function of the state after each step whose result is kept; None keeps nothing.

    Returns:
        The last state, and what was recorded with a leading axis of length N.
    """
    import jax

    released = jax.numpy.zeros((), bool)

    def body(state: State, share: Scalar) -> tuple[State, Any]:
        after = step(vehicle, track, state, Command(share, released), dt, integrator)
        return after, None if record is None else record(after)

    return jax.lax.scan(body, state, commands)


@cache
def _compile(integrator: str, record: Record | None) -> Callable[..., tuple[State, Any]]:
    import jax

    def one(vehicle: Vehicle, track: Track, state: State, commands: Array, dt: Scalar) -> tuple[State, Any]:
        return rollout(vehicle, track, state, commands, dt, integrator=integrator, record=record)

    return jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 0, None)))


def rollout_batch(
    vehicles: Vehicle,
    tracks: Track,
    states: State,
    commands: Float[Array, "batch periods"],
    dt: float,
    *,
    integrator: str = "held",
    record: Record | None = None,
) -> tuple[State, Any]:
    """:func:`rollout` of a whole batch, compiled once for each set of array shapes.

    Args:
        vehicles: Trainsets. Leading axis B.
        tracks: Sections. Leading axis B.
        states: States at the start. Leading axis B.
        commands: Commands of each trainset.
        dt: Control period, s.
        integrator: A key of ``INTEGRATORS``.
        record: As for :func:`rollout`; pass the same function each time, or it compiles again.

    Returns:
        The last states, and what was recorded with leading axes (B, N).
    """
    import jax.numpy as jnp

    commands = jnp.asarray(commands)
    return _compile(integrator, record)(vehicles, tracks, states, commands, jnp.asarray(dt, commands.dtype))


def spread(tree: Any) -> Any:
    """The same arrays with their leading axis shared out over all JAX devices: each works on its part.

    Two CPU cores count as two devices under ``XLA_FLAGS=--xla_force_host_platform_device_count=2``. The
    length of the leading axis must be a multiple of the number of devices.
    """
    import jax

    mesh = jax.sharding.Mesh(np.array(jax.devices()), ("batch",))
    return jax.device_put(tree, jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("batch")))


@contextmanager
def double_precision() -> Iterator[None]:
    """JAX keeps float64 arrays in float64 inside this block."""
    import jax

    with jax.enable_x64(True):
        yield
