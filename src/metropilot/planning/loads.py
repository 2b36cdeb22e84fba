"""The forces that a plan decides on: those of one trainset, or of every trainset that moves with it.

Trainsets that are coupled at constant distances have one speed, so a plan for all of them has one kinetic
energy per node but one traction and one braking force for each trainset and segment. Trainsets alike under
the same slope need the same forces; they are one load that counts several times.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Int
from metropilot.physics import Vehicle
from metropilot.planning.effort_table import Specific
from metropilot.planning.mesh import CoupledMeans, Mesh

SAME_MPS2 = 1e-9
"""Difference of slopes that counts as none."""


class Loads(NamedTuple):
    """Pairs of a segment and the forces on it, per kg of the effective mass of their own trainset.

    Attributes:
        vehicles: Kinds of trainset, that of the head first.
        tables: The same, per kg.
        kind: Kind of each load. Shape (U,).
        segment: Segment of each load. Shape (U,).
        weight: Effective mass over that of the head, times the number of trainsets. Shape (U,).
        davis: Running resistance with the tunnel's part. Shape (3, U).
        slope_mps2: Gradient and curves. Shape (U,).
    """

    vehicles: tuple[Vehicle, ...]
    tables: tuple[Specific, ...]
    kind: Int[ndarray, " loads"]
    segment: Int[ndarray, " loads"]
    weight: Float[ndarray, " loads"]
    davis: Float[ndarray, "3 loads"]
    slope_mps2: Float[ndarray, " loads"]

    def of_kind(self, kind: int) -> slice:
        """The loads of one kind; they lie together."""
        return slice(*np.searchsorted(self.kind, [kind, kind + 1]).tolist())


def all_trainsets(vehicle: Vehicle, table: Specific, mesh: Mesh) -> tuple[CoupledMeans, ...]:
    """The trainset and those coupled behind it, each with the segment means under it."""
    return CoupledMeans(vehicle, table, mesh.slope_mps2, mesh.tunnel_n), *mesh.coupled


def build_loads(vehicle: Vehicle, table: Specific, mesh: Mesh) -> Loads:
    """Loads of a trainset and of those coupled behind it.

    Args:
        vehicle: Trainset.
        table: The same, per kg.
        mesh: Mesh, with the coupled trainsets.
    """
    kinds: list[list[CoupledMeans]] = []
    for each in all_trainsets(vehicle, table, mesh):
        same = next((kind for kind in kinds if _alike(kind[0].vehicle, each.vehicle)), None)
        if same is None:
            kinds.append([each])
        else:
            same.append(each)
    parts = [_distinct(members) for members in kinds]
    sizes = [part[0].size for part in parts]
    heads = [members[0].table for members in kinds]
    davis = [
        np.stack([np.full(n, own.davis[0]), np.full(n, own.davis[1]), own.davis[2] + tunnel / own.mass_kg])
        for n, own, (_, _, _, tunnel) in zip(sizes, heads, parts, strict=True)
    ]
    return Loads(
        vehicles=tuple(members[0].vehicle for members in kinds),
        tables=tuple(heads),
        kind=np.repeat(np.arange(len(kinds)), sizes),
        segment=np.concatenate([part[0] for part in parts]),
        weight=np.concatenate(
            [part[1] * (own.mass_kg / table.mass_kg) for part, own in zip(parts, heads, strict=True)]
        ),
        davis=np.concatenate(davis, axis=1),
        slope_mps2=np.concatenate([part[2] for part in parts]),
    )


def total_weight(loads: Loads) -> float:
    """Effective mass of all trainsets over that of the head."""
    return float(np.sum(loads.weight, where=loads.segment == 0))


def _alike(vehicle: Vehicle, other: Vehicle) -> bool:
    """True if two trainsets are the same in every number."""
    return vehicle is other or all(np.array_equal(a, b) for a, b in zip(vehicle, other, strict=True))


def _distinct(members: list[CoupledMeans]) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Segment, number of trainsets, slope and tunnel of the distinct forces on trainsets of one kind."""
    slope = np.stack([each.slope_mps2 for each in members])
    tunnel = np.stack([each.tunnel_n for each in members])
    order = np.argsort(slope, axis=0, kind="stable")
    slope, tunnel = (np.take_along_axis(x, order, axis=0).T for x in (slope, tunnel))
    first = np.ones(slope.shape, bool)
    first[:, 1:] = (np.diff(slope) > SAME_MPS2) | (np.diff(tunnel) != 0)
    segment = np.nonzero(first)[0]
    counts = np.diff(np.append(np.flatnonzero(first), first.size))
    return segment, counts.astype(float), slope[first], tunnel[first]
