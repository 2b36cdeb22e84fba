"""Look-up tables of the runs of a batch, padded to a few sizes so that one program serves many batches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from metropilot.env import PROTECTION_CURVES, PolicyInterface, SectionTables, build_tables
from metropilot.physics import Track, delay_steps, padded_size, stack, track_arrays, vehicle_arrays
from metropilot.protection import Bounds, protect
from metropilot.railway import Restriction, Section, Trainset, load_trainset
from metropilot.sim import Run, declared_bounds

CASES = (8, 32, 128, 512)
GUARD_NODES = (4096, 8192, 16384, 32768, 65536, 131072)
SEEN_NODES = (1024, 4096, 16384, 65536)
TRACK_NODES = (64, 256, 1024)
SPEEDS = (64, 128, 256, 512)
"""Sizes that tables are padded to: each combination of them is compiled once; padding is never read."""
KEPT = 128
"""Tables a worker keeps; a section's take about 0.1 MB."""


class Place(NamedTuple):
    """Section, trainset and bounds of a table; runs with the same place share it.

    Attributes:
        section: Line, origin, destination, and restrictions in force.
        trainset: Trainset, load, and whether its actuation is ideal.
        bounds: Deviations from the nominal plant that protection allows for.
    """

    section: tuple[str, str, str, tuple[Restriction, ...]]
    trainset: tuple[str, str | None, bool]
    bounds: Bounds


class TableCache:
    """Tables of one kind made by this worker so far.

    Args:
        make: Function that makes one, without a leading axis.
    """

    def __init__(self, make: Callable[[Section, Run], SectionTables]) -> None:
        self.make = make
        self.known: dict[Place, SectionTables] = {}

    def get(self, place: Place, section: Section, run: Run) -> SectionTables:
        """The tables of a place, made on first use; the oldest are dropped beyond ``KEPT``."""
        if place not in self.known:
            while len(self.known) >= KEPT:
                del self.known[next(iter(self.known))]
            self.known[place] = self.make(section, run)
        return self.known[place]


def guard_tables(section: Section, run: Run) -> SectionTables:
    """Protection of a section on the grid of the host loop, and its track; no leading axis."""
    nominal = run.disturbance.nominal(run.trainset)
    guard = protect(section, nominal, declared_bounds(run))
    curves = [getattr(guard, name) for name in PROTECTION_CURVES]
    none = np.float64(0.0)
    return SectionTables(
        vehicle=vehicle_arrays(nominal),
        track=_track(section, nominal),
        protection=guard._replace(**dict.fromkeys(PROTECTION_CURVES, none)),
        node_curves=np.stack([*curves, np.zeros_like(curves[0])], axis=1),
        to_go=np.zeros((2, 2)),
        minimum_s=none,
        length_m=np.float64(section.length_m),
        load=none,
        stop_mps2=none,
        braking_curves=np.zeros((1, 2)),
    )


def make_feature_tables(interface: PolicyInterface) -> Callable[[Section, Run], SectionTables]:
    """A function that makes the tables of a policy, as the driver does in the host loop."""

    def make(section: Section, run: Run) -> SectionTables:
        nominal = run.disturbance.nominal(run.trainset)
        case = (section, nominal, declared_bounds(run))
        tables = map_tree(lambda a: a[0], build_tables([case], interface.spacing_m, np.float64))
        guard = tables.protection._replace(ahead=np.zeros(1, np.int32), slots=np.zeros(1))
        load = np.float64(nominal.mass_kg / interface.mean_mass_kg)
        return tables._replace(load=load, protection=guard, track=_track(section, nominal))

    return make


def _track(section: Section, trainset: Trainset) -> Track:
    """The track under the trainset, padded to one of ``TRACK_NODES``."""
    track = track_arrays(section, trainset)
    return track_arrays(section, trainset, size=padded_size(track.node_m.size, TRACK_NODES))


@lru_cache(maxsize=8)
def table_cache(interface: PolicyInterface | None) -> TableCache:
    """This worker's cache of the tables of a policy interface, or (None) of protection."""
    return TableCache(guard_tables if interface is None else make_feature_tables(interface))


def stack_tables(tables: Sequence[SectionTables], nodes: Sequence[int], slots: int) -> SectionTables:
    """Stack tables along a leading axis, padded so that every shape is one of a few.

    Args:
        tables: Tables without a leading axis.
        nodes: Sizes that the number of position nodes may have.
        slots: Largest number of commands in the dead time of any run.
    """
    rows = [*tables, *[tables[0]] * (padded_size(len(tables), CASES) - len(tables))]
    size = padded_size(max(t.node_curves.shape[0] for t in tables) + 4, nodes)
    columns = padded_size(max(t.to_go.shape[1] for t in tables), SPEEDS)
    ahead = np.arange(max(t.protection.ahead.size for t in tables), dtype=np.int32)
    count = len(rows)
    guards = [t.protection._replace(vehicle=(), ahead=np.int32(0), slots=0.0) for t in rows]
    guard = map_trees(lambda *values: np.stack([np.asarray(v) for v in values]), *guards)
    return SectionTables(
        vehicle=stack([t.vehicle for t in rows]),
        track=stack([t.track for t in rows]),
        protection=guard._replace(
            vehicle=stack([t.protection.vehicle for t in rows]),
            ahead=np.repeat(ahead[None], count, axis=0),
            slots=np.zeros((count, slots)),
        ),
        node_curves=np.stack([_pad_curves(t.node_curves, size) for t in rows]),
        to_go=np.stack([np.pad(t.to_go, ((0, 0), (0, columns - t.to_go.shape[1])), "edge") for t in rows]),
        braking_curves=np.stack([_pad_curves(t.braking_curves, size) for t in rows]),
        **{
            name: np.array([getattr(t, name) for t in rows])
            for name in ("minimum_s", "length_m", "load", "stop_mps2")
        },
    )


def _pad_curves(curves: np.ndarray, size: int) -> np.ndarray:
    """Pad curves to a size; the tables of protection have one row in place of the braking curves."""
    return np.pad(curves, ((0, size - len(curves) if len(curves) > 1 else 0), (0, 0)), "edge")


def map_tree(function: Callable[..., Any], tree: Any) -> Any:  # noqa: ANN401 (a tree of tuples)
    """Apply a function to every array of a tree of tuples."""
    return map_trees(function, tree)


def map_trees(function: Callable[..., Any], *trees: Any) -> Any:  # noqa: ANN401 (trees of tuples)
    """Apply a function to the corresponding arrays of several trees of tuples."""
    if isinstance(trees[0], tuple):
        values = [map_trees(function, *entries) for entries in zip(*trees, strict=True)]
        return type(trees[0])(*values) if hasattr(trees[0], "_fields") else tuple(values)
    return function(*trees)


def most_slots(trainsets: Sequence[tuple[str, str]], dt: float) -> int:
    """The largest number of commands in the dead time of any run of a campaign."""
    delays = [load_trainset(name, load).actuation.delay_s for name, load in trainsets]
    return delay_steps(max(delays), dt) + 1
