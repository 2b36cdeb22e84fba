"""The plan of a whole journey: one convex problem, so that the optimum itself spreads the reserve."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy import ndarray

from metropilot.errors import Infeasible, InputError
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning.cone_program import NoSolution, TimeBound
from metropilot.planning.effort_table import specific
from metropilot.planning.fastest import check_running_time, fastest_profile, times
from metropilot.planning.mesh import Mesh, build_mesh
from metropilot.planning.optimal import (
    Plan,
    PlanOptions,
    explain_stall,
    iterate,
    limit_acceleration,
    within_jerk,
)
from metropilot.railway import Journey, Line, Station, Trainset

Window = tuple[float | None, float | None]
FREE: Window = (None, None)
BEYOND_END_M = 1.0
"""Distance by which the last waypoint may lie beyond the destination: positions of files are rounded."""


@dataclass(frozen=True)
class Waypoint:
    """A point of the journey with what is asked of the trainset there; times since the journey's time zero.

    Attributes:
        position_m: Position from the journey's origin, in the direction of travel.
        name: Name.
        stop: True if the trainset stops here.
        arrival_s: Earliest and latest arrival (or passing), s; None is free.
        departure_s: Earliest and latest departure, s. The first waypoint is left as early as it may be.
        dwell_s: Shortest and longest dwell, s; equal: fixed.
        slowest_mps: Lowest speed, if passing.
        fastest_mps: Highest speed, if passing.
    """

    position_m: float
    name: str = ""
    stop: bool = True
    arrival_s: Window = FREE
    departure_s: Window = FREE
    dwell_s: tuple[float, float] = (0.0, 0.0)
    slowest_mps: float = 0.0
    fastest_mps: float = float("inf")

    def __post_init__(self) -> None:
        """Refuse what nothing could drive: windows upside down, numbers that are none.

        Raises:
            InputError: Naming the waypoint, the field and what is allowed.
        """
        where = self.name or f"{self.position_m:g} m"
        if not (math.isfinite(self.position_m) and self.position_m >= 0.0):
            words = f"{where}: not in the direction of travel"
            raise InputError(words, field="position_m", value=self.position_m, unit="m", allowed=">= 0 m")
        for field, window, least, unit in (
            ("arrival_s", self.arrival_s, -math.inf, "s"),
            ("departure_s", self.departure_s, -math.inf, "s"),
            ("dwell_s", self.dwell_s, 0.0, "s"),
            ("fastest_mps", (self.slowest_mps, self.fastest_mps), 0.0, "m/s"),
        ):
            low = least if window[0] is None else window[0]
            high = math.inf if window[1] is None else window[1]
            if not least <= low <= high or low == math.inf:
                bounds = f"{least:g} {unit} <= " if math.isfinite(least) else ""
                raise InputError(
                    f"{where}: no window",
                    field=field,
                    value=f"{low:g} to {high:g}",
                    unit=unit,
                    allowed=f"{bounds}lowest <= highest",
                )


@dataclass(frozen=True)
class Call:
    """One waypoint of a planned journey, times since the journey's time zero.

    Attributes:
        name: Waypoint.
        position_m: Its position.
        arrival_s: Arrival or passing.
        departure_s: Departure.
        running_time_s: Running time from the last stop.
        minimum_s: Minimum running time from the last stop.
        energy_j: Wheel traction energy from the last stop.
    """

    name: str
    position_m: float
    arrival_s: float
    departure_s: float
    running_time_s: float
    minimum_s: float
    energy_j: float


@dataclass(frozen=True)
class JourneyPlan:
    """An optimal journey.

    Attributes:
        plan: The speed profile over the whole journey; its ``time_s`` counts running only, without dwells.
        calls: Every waypoint in order.
    """

    plan: Plan
    calls: tuple[Call, ...]


def timetable_waypoints(
    line: Line,
    origin: Station | None = None,
    destination: Station | None = None,
    *,
    total_s: float | None = None,
) -> tuple[Waypoint, ...]:
    """Every station from origin to destination with the line's planned times and dwells.

    Args:
        line: Line.
        origin: First station, or None for the line's first.
        destination: Last station, or None for the line's last.
        total_s: None keeps the timetable: no departure before its time, no arrival after it. A number frees
            the intermediate times and asks only that the whole journey, dwells included, takes no longer: the
            reserve is then spread by the optimum.

    Raises:
        InputError: The line has no planned times and no total is given.
    """
    stops = list(line.stations)
    first, last = stops.index(origin or stops[0]), stops.index(destination or stops[-1])
    way = stops[first : last + 1] if first < last else stops[last : first + 1][::-1]
    if len(way) < 2:
        raise InputError("a journey needs two stations", file=line.id, field="destination")
    dwell = dict(zip((s.code for s in stops[1:-1]), line.dwell_s, strict=False))
    points, clock = [Waypoint(0.0, way[0].code)], 0.0
    for here, there in itertools.pairwise(way):
        planned = line.section(here, there).planned_time_s
        if planned is None and total_s is None:
            raise InputError(
                "the line has no planned running time",
                file=line.id,
                field=f"{here.code}-{there.code}",
                allowed="a timetable in the line's file, or a time for the whole journey",
            )
        clock += planned or 0.0
        stay = dwell.get(there.code, 0.0) if there is not way[-1] else 0.0
        position = abs(there.position_m - way[0].position_m)
        call = Waypoint(position, there.code, dwell_s=(stay, stay))
        if total_s is None:
            call = replace(call, arrival_s=(None, clock))
            if there is not way[-1]:
                call = replace(call, departure_s=(clock + stay, None), dwell_s=(stay, float("inf")))
        points.append(call)
        clock += stay
    if total_s is not None:
        points[-1] = replace(points[-1], arrival_s=(None, total_s))
    return tuple(points)


def journey_waypoints(journey: Journey) -> tuple[Waypoint, ...]:
    """A journey's timing points as waypoints: two stops at one position are arrival and departure.

    The window of a single first timing point is one of departure.
    """
    result: list[Waypoint] = []
    start = journey.points[0].position_m
    for k, point in enumerate(journey.points):
        window = (point.earliest_s, point.latest_s)
        position = abs(point.position_m - start)
        if result and position == result[-1].position_m:
            result[-1] = replace(result[-1], departure_s=window, dwell_s=(0.0, float("inf")))
            continue
        result.append(
            Waypoint(
                position_m=position,
                name=f"{point.position_m:g} m",
                stop=point.is_stop or k == 0,
                arrival_s=window,
                slowest_mps=point.slowest_mps or 0.0,
                fastest_mps=float("inf") if point.fastest_mps is None else point.fastest_mps,
            )
        )
    if journey.points[1].position_m != start:
        result[0] = replace(result[0], arrival_s=FREE, departure_s=result[0].arrival_s)
    return tuple(result)


def plan_journey(
    line: Line,
    trainset: Trainset,
    waypoints: Sequence[Waypoint],
    options: PlanOptions | None = None,
    *,
    origin: Station | None = None,
    destination: Station | None = None,
) -> JourneyPlan:
    """The journey of least energy through all waypoints, from the earliest departure at the first.

    Args:
        line: Line.
        trainset: Trainset with its load.
        waypoints: First at position 0, last at the journey's end.
        options: Objective, mesh and limits; its start is not used.
        origin: Station it begins at, or None for the line's first station.
        destination: Station it ends at, or None for the line's last station.

    Raises:
        Infeasible: A window or a lowest speed cannot be met even flat out, when the message names waypoint
            and what can be, or not all of them together, or not within the jerk limit.
        InputError: Waypoints out of order, or no latest arrival at the last one.
    """
    options = replace(options or PlanOptions(), start_m=0.0, start_mps=0.0, start_mps2=0.0, end_mps=0.0)
    section = line.section(origin or line.stations[0], destination or line.stations[-1])
    _check_order(waypoints, section.length_m)
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    table = limit_acceleration(specific(vehicle), options)
    stops_m = np.array([w.position_m for w in waypoints])
    mesh = _with_stops(build_mesh(vehicle, track, stops_m, options.spacing_m), waypoints)
    energy = fastest_profile(table, mesh)
    duration = times(mesh, energy)
    if not np.isfinite(duration).all():
        explain_stall(mesh, energy)
    start_s = _check_windows(waypoints, mesh, duration)
    _check_speeds(waypoints, np.sqrt(2.0 * energy[mesh.stop]))
    bounds, dwells = _bounds(waypoints, mesh, start_s)
    floor = np.zeros(mesh.node_m.size)
    floor[mesh.stop] = [0.0 if w.stop else w.slowest_mps for w in waypoints]
    try:
        with within_jerk(options):
            plan = iterate(
                vehicle, table, mesh, energy, bounds, dwells, options, floor if floor.any() else None
            )
    except NoSolution:
        raise Infeasible(
            "no drive keeps the windows and speeds of all points together",
            field="journey",
            allowed="wider windows, or lower slowest speeds",
        ) from None
    return JourneyPlan(plan, _calls(waypoints, mesh, plan, duration, start_s))


def _check_order(waypoints: Sequence[Waypoint], length_m: float) -> None:
    """Refuse waypoints that do not begin at 0 and lead on from there, to the destination at most.

    Raises:
        InputError: They do not.
    """
    if len(waypoints) < 2:
        raise InputError("a journey needs two waypoints", field="journey", value=len(waypoints))
    first = waypoints[0].position_m
    if first != 0.0:
        raise InputError(
            "the first waypoint is not at the origin",
            field="position_m",
            value=first,
            unit="m",
            allowed="0 m",
        )
    for before, after in itertools.pairwise(waypoints):
        if not before.position_m < after.position_m:
            raise InputError(
                f"{after.name or 'a waypoint'} out of order",
                field="position_m",
                value=after.position_m,
                unit="m",
                allowed=f"> {before.position_m:g} m",
            )
    last = waypoints[-1].position_m
    if last > length_m + BEYOND_END_M:
        words = "the last waypoint is beyond the destination"
        raise InputError(words, field="position_m", value=last, unit="m", allowed=f"<= {length_m:g} m")


def _check_speeds(waypoints: Sequence[Waypoint], flat_out_mps: ndarray) -> None:
    """Refuse a lowest speed that the flat-out run does not reach.

    Raises:
        Infeasible: There is one.
    """
    for point, top in zip(waypoints, flat_out_mps.tolist(), strict=True):
        if point.slowest_mps > top + 1e-9:
            most = math.floor(100.0 * top) / 100.0
            raise Infeasible(
                f"{point.name} cannot be passed faster than {most:.2f} m/s",
                field="slowest",
                value=round(point.slowest_mps, 3),
                unit="m/s",
                allowed=f"<= {most:.2f} m/s",
            )


def _with_stops(mesh: Mesh, waypoints: Sequence[Waypoint]) -> Mesh:
    cap = mesh.cap_mps.copy()
    cap[mesh.stop] = np.minimum(cap[mesh.stop], [0.0 if w.stop else w.fastest_mps for w in waypoints])
    return mesh._replace(cap_mps=cap)


def _check_windows(waypoints: Sequence[Waypoint], mesh: Mesh, duration: ndarray) -> float:
    """Walk the waypoints flat out with the shortest dwells; name the first window that cannot be met.

    Returns:
        Earliest departure from the first waypoint, s.

    Raises:
        Infeasible: There is one.
        InputError: The whole may take far longer than it needs.
    """
    start = clock = 0.0
    for k, point in enumerate(waypoints):
        if k:
            clock += float(duration[mesh.stop[k - 1] : mesh.stop[k]].sum())
        clock = _earliest(point, clock, point.arrival_s, "reached")
        if point is waypoints[-1]:
            _check_end(point, start, clock)
        clock = _earliest(point, clock + point.dwell_s[0], point.departure_s, "left")
        start = clock if k == 0 else start
    return start


def _earliest(point: Waypoint, clock: float, window: Window, what: Literal["reached", "left"]) -> float:
    """Earliest time within a window from a time on, s.

    Raises:
        Infeasible: The window has ended.
    """
    earliest, latest = window
    if latest is not None and clock > latest + 1e-6:
        raise Infeasible(
            f"{point.name} cannot be reached before {clock:.1f} s"
            if what == "reached"
            else f"{point.name} cannot be left before {clock:.1f} s",
            field="journey",
            value=latest,
            unit="s",
            allowed=f">= {clock:.1f} s",
        )
    return clock if earliest is None else max(clock, earliest)


def _check_end(point: Waypoint, start: float, clock: float) -> None:
    """Refuse a last waypoint without a latest arrival: without one the slowest drive is the optimum.

    Raises:
        InputError: There is none, or far more time than the journey needs.
    """
    latest = point.arrival_s[1]
    if latest is None:
        raise InputError(
            f"{point.name} needs a latest arrival", field="journey", allowed=f"latest >= {clock:.1f} s"
        )
    check_running_time(max(latest, clock) - start, clock - start, field="journey")


def _bounds(
    waypoints: Sequence[Waypoint], mesh: Mesh, start_s: float
) -> tuple[list[TimeBound], list[tuple[float, float]]]:
    """Partial sums of running time for every window; fixed dwells are constants, free ones variables."""
    bounds: list[TimeBound] = []
    dwells: list[tuple[float, float]] = []
    fixed, waits = start_s, ()
    for point, node in zip(waypoints[1:], mesh.stop[1:].tolist(), strict=True):
        if point.arrival_s != FREE:
            bounds.append(_bound(node, point.arrival_s, fixed, waits))
        low, high = point.dwell_s
        if high > low:
            waits = (*waits, len(dwells))
            dwells.append((low, min(high, 86400.0)))
        else:
            fixed += low
        if point.departure_s != FREE and node < mesh.length_m.size:
            bounds.append(_bound(node, point.departure_s, fixed, waits))
    return bounds, dwells


def _bound(node: int, window: Window, fixed: float, waits: tuple[int, ...]) -> TimeBound:
    low, high = (None if t is None else t - fixed for t in window)
    return TimeBound(0, node, low if low is None or low > 0 else None, high, waits)


def _calls(
    waypoints: Sequence[Waypoint], mesh: Mesh, plan: Plan, fastest: ndarray, start_s: float
) -> tuple[Call, ...]:
    origin = waypoints[0]
    calls = [Call(origin.name, 0.0, start_s - origin.dwell_s[0], start_s, 0.0, 0.0, 0.0)]
    free = iter(plan.dwell_s)
    clock, last = start_s, 0
    for point, node in zip(waypoints[1:], mesh.stop[1:].tolist(), strict=True):
        running = float(plan.time_s[node] - plan.time_s[last])
        arrival = clock + running
        dwell = next(free) if point.dwell_s[1] > point.dwell_s[0] else point.dwell_s[0]
        clock = arrival + dwell
        work = float(np.sum(plan.traction_n[last:node] * mesh.length_m[last:node]))
        minimum = float(fastest[last:node].sum())
        calls.append(Call(point.name, point.position_m, arrival, clock, running, minimum, work))
        last = node
    return tuple(calls)
