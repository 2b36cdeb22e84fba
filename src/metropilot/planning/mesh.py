"""The space mesh a plan lives on, and what the track asks for on each of its segments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.physics import Track, Vehicle
from metropilot.planning.effort_table import Specific

GAUSS_X, GAUSS_W = np.polynomial.legendre.leggauss(4)
NEAREST_M = 2.5
JUMP_MPS = 0.3
BEND_MPS2 = 0.2
"""A cap whose slope rises by more than this has a node there: between nodes the plan runs along the chord."""
END_SPACING_M = 12.0 * (np.arange(1, 10) / 9) ** 2.5
"""Distances from a stop at which nodes lie: dense at the stop, where speed grows as its square root."""


class Coupled(NamedTuple):
    """A trainset that keeps a constant distance behind the one that a plan is for: a member of a convoy.

    Attributes:
        vehicle: Trainset.
        table: The same, per kg.
        track: Track under it, at the positions of the head (see :func:`shift_track`).
    """

    vehicle: Vehicle
    table: Specific
    track: Track


class CoupledMeans(NamedTuple):
    """A coupled trainset with what the track asks of it on each segment.

    Attributes:
        vehicle: Trainset.
        table: The same, per kg of its own effective mass.
        slope_mps2: As ``Mesh.slope_mps2``. Shape (N,).
        tunnel_n: As ``Mesh.tunnel_n``. Shape (N,).
    """

    vehicle: Vehicle
    table: Specific
    slope_mps2: Float[ndarray, " segments"]
    tunnel_n: Float[ndarray, " segments"]


class Mesh(NamedTuple):
    """Nodes and segment means, SI units.

    Attributes:
        node_m: Increasing positions. Shape (N+1,).
        length_m: Length of each segment. Shape (N,).
        cap_mps: Largest speed at each node. Shape (N+1,).
        slope_mps2: Mean force of gradient and curves on each segment, per kg of effective mass. Shape (N,).
        tunnel_n: Mean tunnel coefficient of each segment, N/(m/s)^2. Shape (N,).
        stop: Indices of the nodes where the trainset stands or a time is fixed, increasing. Shape (S,).
        coupled: Trainsets coupled behind it, which move at the same speed.
    """

    node_m: Float[ndarray, " nodes"]
    length_m: Float[ndarray, " segments"]
    cap_mps: Float[ndarray, " nodes"]
    slope_mps2: Float[ndarray, " segments"]
    tunnel_n: Float[ndarray, " segments"]
    stop: ndarray
    coupled: tuple[CoupledMeans, ...] = ()


def shift_track(track: Track, offset_m: float) -> Track:
    """The track under a trainset ``offset_m`` behind the head (front to front), at the head's positions."""
    return track._replace(node_m=track.node_m + offset_m, limit_from_m=track.limit_from_m + offset_m)


def potential_at(track: Track, position_m: Float[ndarray, "..."]) -> Float[ndarray, "... 3"]:
    """Altitude, curve and tunnel potential at many positions (vectorised twin of the plant's look-up)."""
    k = np.maximum(np.searchsorted(track.node_m, position_m, side="right") - 1, 0)
    return track.potential[k] + track.slope[k] * (position_m - track.node_m[k])[..., None]


def mean_slopes_at(
    vehicle: Vehicle, track: Track, position_m: Float[ndarray, "..."]
) -> Float[ndarray, "... 3"]:
    """Gradient (1), curve resistance (N/kg) and tunnel coefficient felt over the trainset's length."""
    if vehicle.length_m > 0:
        return (
            potential_at(track, position_m) - potential_at(track, position_m - vehicle.length_m)
        ) / vehicle.length_m
    k = np.maximum(np.searchsorted(track.node_m, position_m, side="right") - 1, 0)
    return track.slope[k]


def limit_at(track: Track, position_m: Float[ndarray, "..."]) -> Float[ndarray, "..."]:
    """Speed limit of the head at many positions."""
    k = np.maximum(np.searchsorted(track.limit_from_m, position_m, side="right") - 1, 0)
    return track.limit_mps[k]


def build_mesh(
    vehicle: Vehicle,
    track: Track,
    stops_m: Float[ndarray, " stops"],
    spacing_m: float = 12.5,
    cap_mps: Float[ndarray, " grid"] | None = None,
    cap_at_m: Float[ndarray, " grid"] | None = None,
    coupled: Sequence[Coupled] = (),
) -> Mesh:
    """Nodes at every stop, limit change and (where not too close) gradient change, dense near the stops.

    Args:
        vehicle: Trainset.
        track: Track.
        stops_m: First node, intermediate nodes that must exist (stops, timing points), last node; increasing.
        spacing_m: Largest segment.
        cap_mps: Further speed cap, e.g. what protection permits, at the positions ``cap_at_m``.
        cap_at_m: Positions of ``cap_mps``.
        coupled: Trainsets coupled behind it; the speed limits of all hold.
    """
    tracks = [(vehicle, track), *((each.vehicle, each.track) for each in coupled)]
    first, last = float(stops_m[0]), float(stops_m[-1])
    limits = np.concatenate([each.limit_from_m[np.isfinite(each.limit_from_m)] for _, each in tracks])
    jumps = np.zeros(0)
    if cap_mps is not None and cap_at_m is not None:
        leaps = np.flatnonzero(np.abs(np.diff(cap_mps)) > JUMP_MPS)
        bends = np.flatnonzero(np.diff(np.diff(0.5 * cap_mps**2) / np.diff(cap_at_m)) > BEND_MPS2) + 1
        jumps = np.concatenate([cap_at_m[leaps], cap_at_m[leaps + 1], cap_at_m[bends]])
    needed = np.concatenate([stops_m, limits, jumps])
    needed = np.unique(needed[(needed >= first) & (needed <= last)])
    near = np.concatenate([np.concatenate([s + END_SPACING_M, s - END_SPACING_M]) for s in stops_m])
    breaks = np.concatenate([_slope_changes(*each) for each in tracks])
    nodes = _merge(needed, near, gap=0.01)
    nodes = _merge(nodes, breaks, gap=NEAREST_M)
    nodes = nodes[(nodes >= first) & (nodes <= last)]
    nodes = _fill(nodes, spacing_m)
    length = np.diff(nodes)
    points = nodes[:-1, None] + 0.5 * length[:, None] * (1 + GAUSS_X)
    means = [_means(*each, points) for each in tracks]
    middle = 0.5 * (nodes[:-1] + nodes[1:])
    cap = np.min([limit_at(each, middle) for _, each in tracks], axis=0)
    node_cap = np.minimum(np.append(cap, cap[-1]), np.append(cap[0], cap))
    if cap_mps is not None and cap_at_m is not None:
        node_cap = np.minimum(node_cap, np.interp(nodes, cap_at_m, cap_mps))
    return Mesh(
        node_m=nodes,
        length_m=length,
        cap_mps=node_cap,
        slope_mps2=means[0][0],
        tunnel_n=means[0][1],
        stop=np.searchsorted(nodes, np.asarray(stops_m)),
        coupled=tuple(
            CoupledMeans(own.vehicle, own.table, *mean) for own, mean in zip(coupled, means[1:], strict=True)
        ),
    )


def _slope_changes(vehicle: Vehicle, track: Track) -> ndarray:
    """Positions of the head at which front or rear passes a change of slope."""
    slopes = track.node_m[np.isfinite(track.node_m)]
    return np.concatenate([slopes, slopes + float(vehicle.length_m)])


def _means(vehicle: Vehicle, track: Track, points: ndarray) -> tuple[ndarray, ndarray]:
    """Mean of gradient and curves (per kg of effective mass) and of the tunnel on segments."""
    slopes = np.einsum("skp,k->sp", mean_slopes_at(vehicle, track, points), GAUSS_W / 2)
    ratio = vehicle.mass_kg / vehicle.effective_mass_kg
    return ratio * (vehicle.gravity_mps2 * slopes[:, 0] + slopes[:, 1]), slopes[:, 2]


def _merge(kept: ndarray, extra: ndarray, gap: float) -> ndarray:
    """``kept`` plus those of ``extra`` that are at least ``gap`` away from every neighbour already there."""
    result = kept
    for x in np.sort(extra):
        i = np.searchsorted(result, x)
        left = x - result[i - 1] if i > 0 else np.inf
        right = result[i] - x if i < result.size else np.inf
        if min(left, right) >= gap:
            result = np.insert(result, i, x)
    return result


def _fill(nodes: ndarray, spacing_m: float) -> ndarray:
    # A distance that is a whole number of spacings but for rounding gets no segment more.
    counts = np.maximum(np.ceil(np.diff(nodes) / spacing_m - 1e-9).astype(int), 1)
    parts = [a + (b - a) * np.arange(n) / n for a, b, n in zip(nodes[:-1], nodes[1:], counts, strict=True)]
    return np.append(np.concatenate(parts), nodes[-1])
