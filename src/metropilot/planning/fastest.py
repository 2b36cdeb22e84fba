"""The flat-out run: the fastest any driver can be, the minimum running time, and the time to go."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Index, Scalar
from metropilot.errors import Infeasible, InputError
from metropilot.physics import Track, Vehicle, namespace, scalars
from metropilot.planning.effort_table import STEP_MPS, Specific, same_efforts, specific
from metropilot.planning.mesh import Mesh, build_mesh

LONGEST_RATIO = 30.0
"""Longest scheduled running time over the minimum: ten times, the slowest a campaign asks for, put off
threefold on the way. A run is given up after twice its time, so that every run has an end."""
NEARLY_FULL = 0.98
"""Share of the brakes a start above a cap is braked with: the rest keeps the plan's programme feasible."""

TO_GO_STEP_MPS = 0.5
"""Step of speed between the columns of the time to go."""
TO_GO_FINER = 4
"""Speeds computed for each column."""
TO_GO_SPACING_M = 5.0
TO_GO_ROWS = 97


def round_up_time(minimum_s: float) -> float:
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
    least, most = round_up_time(minimum_s), math.floor(LONGEST_RATIO * minimum_s)
    allowed = f"{least:.2f} to {most} s"
    if not time_s <= most:
        words = f"running time out of range, {what} is {least:.2f} s"
        raise InputError(words, field=field, value=time_s, unit="s", allowed=allowed)
    if time_s < minimum_s:
        raise Infeasible(f"{what} is {least:.2f} s", field=field, value=time_s, unit="s", allowed=allowed)


def fastest_profile(
    table: Specific, mesh: Mesh, start_mps: float = 0.0, end_mps: float = 0.0, *, passes: int = 3
) -> Float[ndarray, " nodes"]:
    """Highest kinetic energy per kg reachable at each node: forward under traction, backward under braking.

    Both passes evaluate effort and resistance at the middle of the segment (second order in its length).
    Intermediate stops are nodes whose cap is zero.

    Args:
        table: Trainset.
        mesh: Mesh, its caps in force.
        start_mps: Speed at the first node; above the caps it is braked down at the service rate.
        end_mps: Speed at the last node.
        passes: 1 evaluates them at the beginning of the segment, which is enough for very short ones.

    Returns:
        ``v^2/2`` at each node, J/kg.
    """
    start = 0.5 * start_mps**2
    cap = 0.5 * relaxed_cap(table, mesh, start_mps) ** 2
    cap[-1] = min(cap[-1], 0.5 * end_mps**2)
    cap[0] = start
    back = _sweep(table, mesh, cap, end=True, passes=passes)
    back[0] = min(back[0], start)
    return _sweep(table, mesh, back, end=False, passes=passes)


def braking_energy(table: Specific, mesh: Mesh, start_mps: float) -> Float[ndarray, " nodes"]:
    """``v^2/2`` at each node when (nearly) full braking begins at the start, J/kg."""
    energy = np.zeros(mesh.node_m.size)
    energy[0] = 0.5 * start_mps**2
    rate_at = _rates(table, mesh, braking=True, passes=1)
    for k, ds in enumerate(mesh.length_m):
        rate = rate_at(k, energy[k])
        energy[k + 1] = energy[k] - NEARLY_FULL * rate * ds
        if energy[k + 1] <= 0:
            energy[k + 1] = 0.0
            break
    return energy


def relaxed_cap(table: Specific, mesh: Mesh, start_mps: float) -> Float[ndarray, " nodes"]:
    """The caps, lifted to what (nearly) full braking from the start leaves where no brake could meet them."""
    return np.maximum(mesh.cap_mps, np.sqrt(2 * braking_energy(table, mesh, start_mps)))


def lowest_service_rate(table: Specific, mesh: Mesh, *, braking: bool) -> float:
    """Largest acceleration (or deceleration) in service that every trainset of the mesh has."""
    tables = [table, *(each.table for each in mesh.coupled)]
    return min(own.deceleration if braking else own.acceleration for own in tables)


def _weakest(table: Specific, mesh: Mesh, *, steepest: bool) -> list[tuple[Specific, ndarray, ndarray]]:
    """Trainsets with the slope and the tunnel of each segment, without those that are never the weakest.

    Of trainsets with the same efforts, the one on the steepest climb is weakest under traction, and that on
    the steepest fall under braking.
    """
    worst = np.maximum if steepest else np.minimum
    found = [(table, mesh.slope_mps2, mesh.tunnel_n)]
    for each in mesh.coupled:
        for k, (own, slope, tunnel) in enumerate(found):
            if same_efforts(own, each.table) and np.array_equal(tunnel, each.tunnel_n):
                found[k] = own, worst(slope, each.slope_mps2), tunnel
                break
        else:
            found.append((each.table, each.slope_mps2, each.tunnel_n))
    return found


def _rates(
    table: Specific, mesh: Mesh, *, braking: bool, passes: int, many: bool = False
) -> Callable[[int, Scalar], Scalar]:
    """Change of kinetic energy over distance on a segment, m/s^2, from its number and the energy at one end.

    Under full traction from the start, or under full braking (backward, so positive) from the end.

    Args:
        table: Trainset.
        mesh: Mesh.
        braking: Braking instead of traction.
        passes: 1 takes effort and resistance at that end; each further one in the middle that the last gave.
        many: True for arrays of energies. Single ones are read from lists, ten times as fast.
    """
    sign = 1.0 if braking else -1.0
    length, most = mesh.length_m, lowest_service_rate(table, mesh, braking=braking)
    sqrt, least, largest, whole = np.sqrt, np.minimum, np.maximum, np.int64
    weakest = [
        (own.braking if braking else own.traction, own.davis, own.davis[2] + tunnel / own.mass_kg, slope)
        for own, slope, tunnel in _weakest(table, mesh, steepest=not braking)
    ]
    if not many:
        length = length.tolist()
        weakest = [tuple(x.tolist() for x in each) for each in weakest]
        sqrt, least, largest, whole = math.sqrt, min, max, int
    weakest = [(effort, len(effort) - 1, *davis[:2], quad, slope) for effort, davis, quad, slope in weakest]

    def rate_at(k: int, energy: Scalar) -> Scalar:
        middle, rate = energy, 0.0
        for _ in range(passes):
            v = sqrt(2.0 * middle)
            rate = most
            for effort, last, a, b, quad, slope in weakest:
                drag = a + v * (b + v * quad[k]) + slope[k]
                rate = least(effort[whole(least(v / STEP_MPS + 0.5, last))] + sign * drag, rate)
            middle = largest(energy + 0.5 * rate * length[k], 0.0)
        return rate

    return rate_at


def _sweep(table: Specific, mesh: Mesh, cap: ndarray, *, end: bool, passes: int = 3) -> ndarray:
    """One pass from a boundary, never above ``cap``: traction forward, braking backward."""
    energy, length = cap.tolist(), mesh.length_m.tolist()
    rate_at = _rates(table, mesh, braking=end, passes=passes)
    for k in range(len(length) - 1, -1, -1) if end else range(len(length)):
        here, there = (k + 1, k) if end else (k, k + 1)
        e = energy[here]
        energy[there] = max(min(energy[there], e + rate_at(k, e) * length[k]), 0.0)
    return np.array(energy)


def times(mesh: Mesh, energy: Float[ndarray, " nodes"]) -> Float[ndarray, " segments"]:
    """Time on each segment at constant acceleration, s; infinite where the trainset cannot move."""
    speed = np.sqrt(2 * np.maximum(energy, 0.0))
    total = speed[:-1] + speed[1:]
    with np.errstate(divide="ignore"):
        # ``where`` computes both sides; the least positive number keeps the unused one free of 0 / 0.
        return np.where(total > 0, 2 * mesh.length_m / np.maximum(total, 1e-300), np.inf)


class TimeToGo(NamedTuple):
    """Flat-out time to the stop. Rows are even in the square root of the distance left.

    On a braking curve speed is proportional to that square root, so the table is smooth up to the stop.

    Attributes:
        time_s: Time to go; columns in steps of ``TO_GO_STEP_MPS``. Shape (R, V).
        top_mps: Highest speed from which the stop and every limit ahead can be met. Shape (R,).
    """

    time_s: Float[ndarray, "rows speeds"]
    top_mps: Float[ndarray, " rows"]


@no_type_check
def interpolate_time_to_go(
    time_at: Callable[[Index, Index], Scalar], shape: tuple[int, int], left_share: Scalar, speed_mps: Scalar
) -> Scalar:
    """Flat-out time to the stop from a table: bilinear in speed and the square root of the distance left, s.

    Args:
        time_at: Entry of a table of :func:`tabulate_time_to_go`, by row and column.
        shape: Rows and columns of the table.
        left_share: Distance left over the section's length.
        speed_mps: Speed.
    """
    xp = namespace(left_share, speed_mps)
    rows, columns = shape
    u = (rows - 1.0) * xp.sqrt(xp.clip(left_share, 0.0, 1.0))
    w = xp.clip(speed_mps / TO_GO_STEP_MPS, 0.0, columns - 1.0)
    if xp is scalars:
        i, j = min(int(u), rows - 2), min(int(w), columns - 2)
        u, w = u - i, w - j
    else:
        i, j = xp.minimum(xp.floor(u), rows - 2.0), xp.minimum(xp.floor(w), columns - 2.0)
        u, w, i, j = u - i, w - j, i.astype(np.int32), j.astype(np.int32)
    low = time_at(i, j) * (1.0 - w) + time_at(i, j + 1) * w
    high = time_at(i + 1, j) * (1.0 - w) + time_at(i + 1, j + 1) * w
    return low * (1.0 - u) + high * u


def tabulate_time_to_go(vehicle: Vehicle, track: Track) -> TimeToGo:
    """Flat-out time to the stop from every state of a grid.

    Backward over a mesh: from each speed full traction to the next node, at most up to the curve of limits
    and station-stop braking, then the time to go from that node (linear between its speeds, that of the curve
    among them). A speed above the curve counts as that of the curve.

    Args:
        vehicle: Trainset.
        track: Section.
    """
    table = specific(vehicle)
    mesh = build_mesh(vehicle, track, np.array([0.0, float(track.length_m)]), TO_GO_SPACING_M)
    energy = 0.5 * mesh.cap_mps**2
    energy[-1] = 0.0
    top = np.sqrt(2.0 * _sweep(table, mesh, energy, end=True, passes=2))
    columns = math.ceil(float(vehicle.max_speed_mps) / TO_GO_STEP_MPS)
    grid = np.linspace(0.0, columns * TO_GO_STEP_MPS, columns * TO_GO_FINER + 1)
    time = np.zeros((top.size, grid.size))
    rate_at = _rates(table, mesh, braking=False, passes=2, many=True)
    for k in range(top.size - 2, -1, -1):
        now, ds = np.minimum(grid, top[k]), mesh.length_m[k]
        before = 0.5 * now**2
        after = np.sqrt(2.0 * np.maximum(before + rate_at(k, before) * ds, 0.0))
        after = np.minimum(after, top[k + 1])
        later = np.interp(after, np.minimum(grid, top[k + 1]), time[k + 1])
        time[k] = 2.0 * ds / np.maximum(now + after, 0.3 * np.sqrt(ds)) + later
    # rows even in the square root of the distance left
    left = np.sqrt(mesh.node_m[-1] - mesh.node_m[::-1])
    at = left[-1] * np.linspace(0.0, 1.0, TO_GO_ROWS)
    k = np.clip(np.searchsorted(left, at, side="right") - 1, 0, left.size - 2)
    way = ((at - left[k]) / (left[k + 1] - left[k]))[:, None]
    found = np.column_stack([time[:, ::TO_GO_FINER], top])[::-1]
    found = found[k] * (1.0 - way) + found[k + 1] * way
    return TimeToGo(found[:, :-1], found[:, -1])
