"""The ground under protection: limits and gradients on a uniform grid, the worst of each cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray
from numpy.lib.stride_tricks import sliding_window_view

from metropilot.errors import InputError
from metropilot.physics import felt_slopes, restrictive_profile, track_arrays, vehicle_arrays
from metropilot.railway import Section, Trainset

MOST_NODES = 130_000
BEFORE_M = 50.0
AFTER_M = 500.0


class TrackGrid(NamedTuple):
    """What a section asks of a trainset, node by node (N) and between them (N-1).

    Attributes:
        node_m: Positions, uniformly spaced. Shape (N,).
        ceiling_mps: Lowest limit between each node and the next. Shape (N-1,).
        pull_mps2: Largest pull of the gradient there, less certain curve resistance. Shape (N-1,).
        usual_pull_mps2: The same less all curve resistance. Shape (N-1,).
        weight_n: Force that gradient and curve ask for at each node. Shape (N,).
    """

    node_m: ndarray
    ceiling_mps: ndarray
    pull_mps2: ndarray
    usual_pull_mps2: ndarray
    weight_n: ndarray


def ground(
    section: Section,
    trainset: Trainset,
    stop_at_m: float | None,
    spacing_m: float,
    resistance_low: float,
    before_m: float = BEFORE_M,
) -> TrackGrid:
    """Lay the grid over a section.

    Args:
        section: Section with every restriction in force.
        trainset: Nominal trainset.
        stop_at_m: End of the movement authority, if there is one.
        spacing_m: Distance between nodes.
        resistance_low: Share of the curve resistance that is certain.
        before_m: How far before the origin the grid begins.

    Raises:
        InputError: The section is too long for the spacing.
    """
    nodes = _nodes(section, stop_at_m, spacing_m, before_m)
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    gradient, curve, _ = felt_slopes(vehicle, track, nodes)
    return TrackGrid(
        node_m=nodes,
        ceiling_mps=_ceilings(nodes, section, trainset, stop_at_m),
        pull_mps2=_cell_pulls(nodes, section, trainset, resistance_low),
        usual_pull_mps2=_cell_pulls(nodes, section, trainset, 1.0),
        weight_n=vehicle.mass_kg * (vehicle.gravity_mps2 * gradient + curve),
    )


def sliding_max(cells: ndarray, back: int, ahead: int) -> ndarray:
    """At each node, the largest value of the cells from ``back`` before it to ``ahead`` after it."""
    wide = np.pad(cells, (back, ahead), mode="edge")
    return sliding_window_view(wide, back + ahead).max(axis=1)


def _nodes(section: Section, stop_at_m: float | None, spacing_m: float, before_m: float) -> ndarray:
    """Uniform grid; an authority end lies on a node, so that nothing is lost there to rounding."""
    anchor = section.length_m if stop_at_m is None else stop_at_m
    first = -int(np.ceil((anchor + before_m) / spacing_m))
    last = int(np.ceil((section.length_m + AFTER_M - anchor) / spacing_m))
    if last - first > MOST_NODES:
        raise InputError(
            "section too long for protection's grid",
            value=section.length_m,
            unit="m",
            allowed=f"at most {MOST_NODES} times the spacing of {spacing_m:g} m",
        )
    return anchor + spacing_m * np.arange(first, last + 1)


def _ceilings(nodes: ndarray, section: Section, trainset: Trainset, stop_at_m: float | None) -> ndarray:
    """Lowest limit between each node and the next."""
    starts, speeds = restrictive_profile(section, trainset.length_m, trainset.max_speed_mps)
    low = np.maximum(np.searchsorted(starts, nodes[:-1], side="right") - 1, 0)
    high = np.maximum(np.searchsorted(starts, nodes[1:], side="left") - 1, low)
    ceiling = speeds[low]
    for step in range(1, int((high - low).max()) + 1):
        ceiling = np.minimum(ceiling, speeds[np.minimum(low + step, high)])
    return ceiling if stop_at_m is None else np.where(nodes[1:] > stop_at_m, 0.0, ceiling)


def _cell_pulls(nodes: ndarray, section: Section, trainset: Trainset, resistance: float) -> ndarray:
    """Largest pull of the gradient, less certain curve resistance, between each node and the next, m/s^2.

    What a trainset feels is straight between the breaks of the track under its head and under its tail, so
    its extremes lie on those or on nodes.
    """
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    breaks = track.node_m[np.isfinite(track.node_m)]
    kinks = np.concatenate([breaks, breaks + trainset.length_m])
    points = np.unique(np.concatenate([nodes, kinks[(kinks > nodes[0]) & (kinks < nodes[-1])]]))
    gradient, curve, _ = felt_slopes(vehicle, track, points)
    inertia = trainset.mass_kg / trainset.effective_mass_kg
    pull = -inertia * (vehicle.gravity_mps2 * gradient + resistance * curve)
    at = np.searchsorted(points, nodes)
    return np.maximum(np.maximum.reduceat(pull, at)[:-1], pull[at[1:]])
