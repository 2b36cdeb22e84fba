"""The flat-out run: the fastest any driver can be, and the minimum running time that follows."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.errors import Infeasible, InputError
from metropilot.planning.effort_table import STEP_MPS, Specific
from metropilot.planning.mesh import Mesh

LONGEST_RATIO = 30.0
"""Longest scheduled running time over the minimum: ten times, the slowest a campaign asks for, put off
threefold on the way. A run is given up after twice its time, so that every run has an end."""
NEARLY_FULL = 0.98
"""Share of the brakes a start above a cap is braked with: the rest keeps the plan's programme feasible."""


def stated_s(minimum_s: float) -> float:
    """Minimum running time to show to a user: rounded up, so that asking for it is enough."""
    return math.ceil(100.0 * minimum_s) / 100.0


def check_running_time(
    time_s: float, minimum_s: float, what: str = "minimum running time", field: str = "time_s"
) -> None:
    """Refuse a scheduled running time that nobody can keep, or that is out of all proportion.

    Args:
        time_s: The running time.
        minimum_s: The minimum running time.
        what: Name of that minimum.
        field: The field that holds the time.

    Raises:
        Infeasible: Below the minimum.
        InputError: Not a number, or beyond ``LONGEST_RATIO`` times the minimum.
    """
    if not math.isfinite(minimum_s):
        raise Infeasible(
            f"{what} is without end: the trainset stalls on the way", field=field, value=time_s, unit="s"
        )
    least, most = stated_s(minimum_s), math.floor(LONGEST_RATIO * minimum_s)
    allowed = f"{least:.2f} to {most} s"
    if not time_s <= most:
        words = f"running time out of range, {what} is {least:.2f} s"
        raise InputError(words, field=field, value=time_s, unit="s", allowed=allowed)
    if time_s < minimum_s:
        raise Infeasible(f"{what} is {least:.2f} s", field=field, value=time_s, unit="s", allowed=allowed)


def fastest_profile(
    table: Specific, mesh: Mesh, start_mps: float = 0.0, end_mps: float = 0.0
) -> Float[ndarray, " nodes"]:
    """Highest kinetic energy per kg reachable at each node: forward under traction, backward under braking.

    Both passes evaluate effort and resistance at the middle of the segment (second order in its length).
    Intermediate stops are nodes whose cap is zero.

    Args:
        table: Trainset.
        mesh: Mesh, its caps in force.
        start_mps: Speed at the first node; above the caps it is braked down at the service rate.
        end_mps: Speed at the last node.

    Returns:
        ``v^2/2`` at each node, J/kg.
    """
    start = 0.5 * start_mps**2
    cap = 0.5 * relaxed_cap(table, mesh, start_mps) ** 2
    cap[-1] = min(cap[-1], 0.5 * end_mps**2)
    cap[0] = start
    back = _sweep(table, mesh, cap, end=True)
    back[0] = min(back[0], start)
    return _sweep(table, mesh, back, end=False)


def braking_energy(table: Specific, mesh: Mesh, start_mps: float) -> Float[ndarray, " nodes"]:
    """``v^2/2`` at each node when (nearly) full braking begins at the start, J/kg."""
    energy = np.zeros(mesh.node_m.size)
    energy[0] = 0.5 * start_mps**2
    for k, ds in enumerate(mesh.length_m):
        v = math.sqrt(2 * energy[k])
        rate = min(table.braking[_index(table, v)] + _resistance(table, mesh, k, v), table.deceleration)
        energy[k + 1] = energy[k] - NEARLY_FULL * rate * ds
        if energy[k + 1] <= 0:
            energy[k + 1] = 0.0
            break
    return energy


def relaxed_cap(table: Specific, mesh: Mesh, start_mps: float) -> Float[ndarray, " nodes"]:
    """The caps, lifted to what (nearly) full braking from the start leaves where no brake could meet them."""
    return np.maximum(mesh.cap_mps, np.sqrt(2 * braking_energy(table, mesh, start_mps)))


def _index(table: Specific, speed: float) -> int:
    return min(int(speed / STEP_MPS + 0.5), table.speed_mps.size - 1)


def _resistance(table: Specific, mesh: Mesh, k: int, speed: float) -> float:
    a, b, c = table.davis
    return a + b * speed + (c + mesh.tunnel_n[k] / table.mass_kg) * speed * speed + mesh.slope_mps2[k]


def _sweep(table: Specific, mesh: Mesh, cap: ndarray, *, end: bool) -> ndarray:
    """One pass from a boundary, never above ``cap``: traction forward, braking backward."""
    energy = cap.tolist()
    count = len(energy) - 1
    effort = (table.braking if end else table.traction).tolist()
    most = table.deceleration if end else table.acceleration
    a, b, c = (float(x) for x in table.davis)
    quad = (c + mesh.tunnel_n / table.mass_kg).tolist()
    slope, length = mesh.slope_mps2.tolist(), mesh.length_m.tolist()
    last = len(effort) - 1
    sign = 1.0 if end else -1.0
    for k in range(count - 1, -1, -1) if end else range(count):
        here, there = (k + 1, k) if end else (k, k + 1)
        e = energy[here]
        rate = 0.0
        middle = e
        for _ in range(3):
            v = math.sqrt(2 * middle)
            drag = a + v * (b + v * quad[k]) + slope[k]
            rate = min(effort[min(int(v / STEP_MPS + 0.5), last)] + sign * drag, most)
            middle = max(e + 0.5 * rate * length[k], 0.0)
        energy[there] = max(min(energy[there], e + rate * length[k]), 0.0)
    return np.array(energy)


def times(mesh: Mesh, energy: Float[ndarray, " nodes"]) -> Float[ndarray, " segments"]:
    """Time on each segment at constant acceleration, s; infinite where the trainset cannot move."""
    speed = np.sqrt(2 * np.maximum(energy, 0.0))
    total = speed[:-1] + speed[1:]
    with np.errstate(divide="ignore"):
        return np.where(total > 0, 2 * mesh.length_m / np.maximum(total, 1e-300), np.inf)
