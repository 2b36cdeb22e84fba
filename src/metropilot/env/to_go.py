"""Least time to the stop from any state on the way, as a table over distance and speed."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.env.tables import SPEED_STEP_MPS
from metropilot.physics import Track, Vehicle
from metropilot.planning import STEP_MPS, Mesh, Specific, build_mesh, specific

SPACING_M = 5.0
FINER = 4
ROWS = 97
ITERATIONS = 2


class ToGo(NamedTuple):
    """Flat-out time to the stop. Rows are even in the square root of the distance left.

    On a braking curve speed is proportional to that square root, so the table is smooth up to the stop.

    Attributes:
        time_s: Time to go. Shape (R, V).
        top_mps: Highest speed from which the stop and every limit ahead can be met. Shape (R,).
    """

    time_s: Float[ndarray, "rows speeds"]
    top_mps: Float[ndarray, " rows"]


def to_go_table(vehicle: Vehicle, track: Track, *, rows: int = ROWS) -> ToGo:
    """Flat-out time to the stop from every state of a grid.

    Backward over a mesh: from each speed full traction to the next node, at most up to the curve of limits
    and station-stop braking, then the time to go from that node (linear between its speeds, that of the curve
    among them). Forces as in :func:`metropilot.planning.fastest.fastest_profile`. A speed above the curve
    counts as that of the curve.

    Args:
        vehicle: Trainset.
        track: Section.
        rows: Rows of the table.
    """
    length, table = float(track.length_m), specific(vehicle)
    mesh = build_mesh(vehicle, track, np.array([0.0, length]), SPACING_M)
    energy = 0.5 * mesh.cap_mps**2
    energy[-1] = 0.0
    for k in range(mesh.length_m.size - 1, -1, -1):
        reached = _next(table, mesh, k, energy[k + 1 : k + 2], braking=True)
        energy[k] = min(energy[k], float(reached[0]))
    columns = math.ceil(float(vehicle.max_speed_mps) / SPEED_STEP_MPS)
    grid = np.linspace(0.0, columns * SPEED_STEP_MPS, columns * FINER + 1)
    top = np.sqrt(2.0 * energy)
    time = np.zeros((top.size, grid.size))
    for k in range(top.size - 2, -1, -1):
        now = np.minimum(grid, top[k])
        after = _next(table, mesh, k, 0.5 * now**2, braking=False)
        after = np.minimum(np.sqrt(2.0 * after), top[k + 1])
        later = np.interp(after, np.minimum(grid, top[k + 1]), time[k + 1])
        time[k] = 2.0 * mesh.length_m[k] / np.maximum(now + after, 0.3 * np.sqrt(mesh.length_m[k])) + later
    return ToGo(_at_rows(mesh, time[:, ::FINER], rows), _at_rows(mesh, top[:, None], rows)[:, 0])


def _at_rows(mesh: Mesh, values: ndarray, rows: int) -> ndarray:
    """Values at the mesh's nodes, read at rows even in the square root of the distance left."""
    left = np.sqrt(mesh.node_m[-1] - mesh.node_m[::-1])
    at = left[-1] * np.linspace(0.0, 1.0, rows)
    k = np.clip(np.searchsorted(left, at, side="right") - 1, 0, left.size - 2)
    way = ((at - left[k]) / (left[k + 1] - left[k]))[:, None]
    return values[::-1][k] * (1.0 - way) + values[::-1][k + 1] * way


def _next(table: Specific, mesh: Mesh, k: int, energy: ndarray, *, braking: bool) -> ndarray:
    """``v^2/2`` at the other end of segment ``k``: forward under full traction, or backward under braking."""
    effort = table.braking if braking else table.traction
    most = table.deceleration if braking else table.acceleration
    sign = 1.0 if braking else -1.0
    a, b, c = table.davis
    quad = c + mesh.tunnel_n[k] / table.mass_kg
    middle, rate = energy, np.zeros_like(energy)
    for _ in range(ITERATIONS):
        v = np.sqrt(2.0 * middle)
        index = np.minimum((v / STEP_MPS + 0.5).astype(int), effort.size - 1)
        drag = a + v * (b + v * quad) + mesh.slope_mps2[k]
        rate = np.minimum(effort[index] + sign * drag, most)
        middle = np.maximum(energy + 0.5 * rate * mesh.length_m[k], 0.0)
    return np.maximum(energy + rate * mesh.length_m[k], 0.0)
