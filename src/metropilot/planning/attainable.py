"""The optimum that knows the actuation: what a trainset with jerk limit, dead time and lag can attain."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.errors import SolverError
from metropilot.physics import Track, Vehicle, delay_steps
from metropilot.planning.cone_program import Programme, TimeBound
from metropilot.planning.effort_table import Specific, specific
from metropilot.planning.fastest import fastest_profile, relaxed_cap
from metropilot.planning.loads import build_loads
from metropilot.planning.mesh import Mesh, build_mesh
from metropilot.planning.optimal import (
    Plan,
    PlanOptions,
    limit_acceleration,
    plan_arrays,
    solve_until_settled,
)
from metropilot.planning.prices import is_mapped, prices_at
from metropilot.units import J_PER_KWH

STRETCH_M = 30.0
"""Stretch behind the departure and before the stop in which the least times count."""
ATTAINABLE_SPACING_M = 25.0
ATTAINABLE_PASSES = 2
"""Mesh and passes of the plan; on metro sections finer and more of them change its energy by 0.06 %."""
BOUND_SPACING_M = 6.0
"""Mesh of the bound: on one of 25 m drives of 300 m needed up to 0.7 % less than it."""
LATE_W = 500.0
LATE_S = 0.5
"""A plan later than this is none for the running time asked for."""
SETTLED_LAGS = 8.0
"""Lags after which a command acts in full."""


class Ramp(NamedTuple):
    """Largest acceleration away from a standstill (or, backward in time, deceleration down to it).

    Attributes:
        period_s: Time for which each acceleration holds.
        acceleration_mps2: Acceleration in each period, never falling; the last one stays. Shape (N,).
    """

    period_s: float
    acceleration_mps2: Float[ndarray, " periods"]

    @property
    def lost_s(self) -> float:
        """Time that the ramp loses to its last acceleration from the start, s."""
        last = float(self.acceleration_mps2[-1])
        return float(np.sum(1.0 - self.acceleration_mps2 / last)) * self.period_s

    def times_s(self, distance_m: Float[ndarray, " places"]) -> Float[ndarray, " places"]:
        """Least time in which each distance can be covered, s."""
        a, dt = self.acceleration_mps2, self.period_s
        speed = np.concatenate([[0.0], np.cumsum(a[:-1] * dt)])
        way = np.concatenate([[0.0], np.cumsum((speed * dt + 0.5 * a * dt * dt)[:-1])])
        k = np.searchsorted(way, distance_m, side="right") - 1
        left = distance_m - way[k]
        after = np.sqrt(speed[k] ** 2 + 2.0 * a[k] * left)
        return k * dt + 2.0 * left / np.maximum(speed[k] + after, 1e-9)


def departure_ramp(vehicle: Vehicle, track: Track, dt: float) -> Ramp:
    """Largest acceleration in each control period after departure, whatever the commands.

    A command acts after the dead time and through the lag; the acceleration rises by no more than the jerk
    limit allows, and the steepest fall and the least resistance of the first metres count throughout.

    Args:
        vehicle: Trainset.
        track: Section.
        dt: Control period, s.
    """
    table = specific(vehicle)
    most, drag = float(table.traction.max()), _least_drag(vehicle, track, table)
    top = max(min(table.acceleration, most - drag), 1e-3)
    late, lag, jerk = float(vehicle.delay_s), float(vehicle.lag_s), float(vehicle.jerk_mps3)
    keep = float(np.exp(-dt / lag)) if lag > 0 else 0.0
    rise_s = top / jerk if np.isfinite(jerk) else 0.0
    count = delay_steps(late, dt) + int(np.ceil((SETTLED_LAGS * lag + rise_s) / dt)) + 2
    # dead time between two periods: the first command acts by the share of the period that is left of it
    target = np.clip(np.arange(1, count + 1) - late / dt + 1e-9, 0.0, 1.0)
    found, share, now = np.zeros(count), 0.0, 0.0
    for k in range(count):
        share = target[k] + (share - target[k]) * keep
        now = min(top, now + jerk * dt, share * most - drag) if share > 0 else 0.0
        found[k] = now = max(now, 0.0)
    found[-1] = top
    return Ramp(dt, found)


def stop_ramp(vehicle: Vehicle, track: Track, dt: float, *, early_periods: int = 1) -> Ramp:
    """Largest deceleration in each control period before a stop that keeps the jerk limit, the last first.

    The acceleration jumps to zero at the stop, which counts as jerk: the last deceleration is at most the
    jerk limit times the period.

    Args:
        vehicle: Trainset.
        track: Section.
        dt: Control period, s.
        early_periods: Steps of jerk that the last whole period may hold. 1: the trainset stops at the end of
            a period. 2: it stops just after one begins, so that the last period takes no time; no stop within
            the jerk limit is faster than that.
    """
    table = specific(vehicle)
    drag = _most_drag(vehicle, track, table)
    top = max(min(table.deceleration, float(table.braking.max()) + drag), 1e-3)
    jerk = float(vehicle.jerk_mps3)
    if not np.isfinite(jerk):
        return Ramp(dt, np.array([top]))
    count = int(np.ceil(top / (jerk * dt))) + 1
    return Ramp(dt, np.minimum(top, jerk * dt * (np.arange(count) + early_periods)))


def _slopes(vehicle: Vehicle, track: Track, start_m: float, end_m: float) -> ndarray:
    """Mean force of gradient and curves on the segments of a stretch, per kg of effective mass."""
    return build_mesh(vehicle, track, np.array([start_m, end_m]), ATTAINABLE_SPACING_M).slope_mps2


def _davis_range(table: Specific) -> tuple[float, float]:
    """Least and largest running resistance on straight open track at any speed, per kg."""
    a, b, c = table.davis
    r = a + table.speed_mps * (b + table.speed_mps * c)
    return float(r.min()), float(r.max())


def _least_drag(vehicle: Vehicle, track: Track, table: Specific) -> float:
    """Least resistance and gradient in the first metres, per kg."""
    slopes = _slopes(vehicle, track, 0.0, min(STRETCH_M, float(track.length_m)))
    return _davis_range(table)[0] + float(slopes.min())


def _most_drag(vehicle: Vehicle, track: Track, table: Specific) -> float:
    """Largest resistance and gradient in the last metres, per kg."""
    length = float(track.length_m)
    return _davis_range(table)[1] + float(_slopes(vehicle, track, max(length - STRETCH_M, 0.0), length).max())


class Attainable(NamedTuple):
    """Energy that a trainset with jerk limit, dead time and lag needs under protection.

    Attributes:
        plan: The plan whose energy is attainable.
        bound_j: Lower bound: no drive that stays under the permitted speed and within the jerk limit, also at
            the stop, needs less.
        departure_s: Time that jerk limit, dead time and lag cost at departure, s.
        stop_s: Time that the jerk limit costs at the stop, s.
    """

    plan: Plan
    bound_j: float
    departure_s: float
    stop_s: float

    @property
    def energy_j(self) -> float:
        """Attainable energy, J."""
        return self.plan.energy_j

    @property
    def energy_kwh(self) -> float:
        """Attainable energy, kWh."""
        return self.plan.energy_j / J_PER_KWH


def is_immediate(vehicle: Vehicle) -> bool:
    """True for a trainset without jerk limit, dead time and lag."""
    return not (np.isfinite(vehicle.jerk_mps3) or vehicle.delay_s > 0 or vehicle.lag_s > 0)


def attainable_plan(
    vehicle: Vehicle,
    track: Track,
    time_s: float,
    options: PlanOptions,
    dt: float,
    ideal: Plan,
    error_mps: float = 0.0,
    deceleration_mps2: float = np.inf,
) -> Attainable | None:
    """The plan of least energy that a trainset can drive under its actuation, and a lower bound beside it.

    The plan keeps the jerk limit and the cap on speed and has the running time less what dead time and lag
    cost at departure. The bound is the dual value of the programme without jerk rows, its first and last
    metres taking at least the time of the ramps (:func:`departure_ramp`, :func:`stop_ramp`).

    Args:
        vehicle: True plant.
        track: Section.
        time_s: Running time, s.
        options: Objective, mesh of an immediate trainset and cap, as for the ideal optimum.
        dt: Control period, s.
        ideal: The optimum of the same drive without the actuation.
        error_mps: Largest error of the measured speed, by which the cap of the bound is higher.
        deceleration_mps2: Largest deceleration that protection leaves before the stop. The plan keeps it; the
            bound does not, as a drive may brake a little harder at the last.

    Returns:
        None where the actuation does not allow the running time.
    """
    if deceleration_mps2 < float(vehicle.max_deceleration_mps2):
        braked = vehicle._replace(max_deceleration_mps2=np.float64(deceleration_mps2))
        free = attainable_plan(vehicle, track, time_s, options, dt, ideal, error_mps)
        found = attainable_plan(braked, track, time_s, options, dt, ideal, error_mps)
        # a drive that braked harder may have been faster than any plan that does not
        return free if found is None or free is None else found._replace(bound_j=free.bound_j)
    options = replace(options, late_w=LATE_W)
    leave = departure_ramp(vehicle, track, dt)
    halt, hardest = (stop_ramp(vehicle, track, dt, early_periods=k) for k in (1, 2))
    if is_immediate(vehicle):
        plan = _in_time(vehicle, track, time_s, options, ideal)
        return None if plan is None else Attainable(plan, max(plan.bound_j, ideal.bound_j), 0.0, 0.0)
    jerk = float(vehicle.jerk_mps3)
    options = replace(options, spacing_m=max(options.spacing_m, ATTAINABLE_SPACING_M))
    known_s = 0.0
    if np.isfinite(jerk):
        # the plan's own ramps are continuous: what they cost is in the plan, and no time is taken off for it
        options = replace(options, jerk_mps3=jerk, release_mps3=jerk, passes=ATTAINABLE_PASSES)
        known_s = 0.5 * float(leave.acceleration_mps2[-1] + halt.acceleration_mps2[-1]) / jerk
    plan = _in_time(vehicle, track, time_s - (leave.lost_s + halt.lost_s - known_s), options, ideal)
    if plan is None:
        return None
    wide = replace(options, spacing_m=BOUND_SPACING_M)
    if wide.cap_mps is not None:
        wide = replace(wide, cap_mps=wide.cap_mps + error_mps)
    bound = attainable_bound(vehicle, track, time_s, wide, leave, hardest, ideal)
    return Attainable(plan, min(max(bound, ideal.bound_j), plan.energy_j), leave.lost_s, halt.lost_s)


def _in_time(vehicle: Vehicle, track: Track, time_s: float, options: PlanOptions, ideal: Plan) -> Plan | None:
    """The plan for a running time, None if it comes too late."""
    if time_s <= 0.0:
        return None
    try:
        plan = plan_arrays(vehicle, track, time_s, options, ideal)
    except SolverError:
        return None
    return plan if plan.running_time_s <= time_s + LATE_S else None


def attainable_bound(
    vehicle: Vehicle,
    track: Track,
    time_s: float,
    options: PlanOptions,
    leave: Ramp,
    halt: Ramp,
    ideal: Plan,
) -> float:
    """Energy below which no drive gets whose first and last metres take the time of their ramps, J.

    Args:
        vehicle: Trainset.
        track: Section.
        time_s: Running time, s.
        options: Objective, mesh and cap.
        leave: Ramp of the departure.
        halt: Ramp of the stop.
        ideal: A plan of much the same drive, about which effort curves are linearised first.

    Returns:
        Minus infinity where the programme has no solution or the objective has an efficiency map.
    """
    table = limit_acceleration(specific(vehicle), options)
    if options.objective == "line" and is_mapped(vehicle):
        return -np.inf
    ends = np.array([0.0, float(track.length_m)])
    cap = options.cap_mps, options.cap_m
    mesh = build_mesh(vehicle, track, ends, options.spacing_m, *cap, options.coupled)
    energy = fastest_profile(table, mesh)
    energy = np.minimum(energy, np.interp(mesh.node_m, ideal.position_m, 0.5 * ideal.speed_mps**2))
    loads = build_loads(vehicle, table, mesh)
    programme = Programme(
        mesh=mesh,
        table=table,
        loads=loads,
        prices=prices_at(loads, options.objective, energy, None),
        start_mps=0.0,
        end_mps=0.0,
        cap_mps=relaxed_cap(table, mesh, 0.0),
        bounds=(*least_times(mesh, leave, halt), TimeBound(0, mesh.length_m.size, None, time_s)),
    )
    try:
        answer, _ = solve_until_settled(programme, energy, options.passes)
    except SolverError:
        return -np.inf
    return answer.dual * table.mass_kg


def least_times(mesh: Mesh, leave: Ramp, halt: Ramp) -> list[TimeBound]:
    """Lower bounds on the time of the first metres, one a node, and of the last."""
    node, size, length = mesh.node_m, mesh.length_m.size, float(mesh.node_m[-1])
    reach = min(STRETCH_M, 0.5 * length)
    first = np.flatnonzero((node > 0.0) & (node <= reach))
    last = np.flatnonzero((node < length) & (node >= length - reach))
    began = leave.times_s(node[first])
    ended = halt.times_s(length - node[last])
    return [
        *(TimeBound(0, int(k), float(t), None) for k, t in zip(first, began, strict=True)),
        *(TimeBound(int(k), size, float(t), None) for k, t in zip(last, ended, strict=True)),
    ]
