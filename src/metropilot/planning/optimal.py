"""The energy-optimal plan of a section, from rest or from any state, with its certificate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple, get_args

import numpy as np
from numpy import ndarray

from metropilot._schema import check_fields, declare
from metropilot._typing import Float
from metropilot.errors import Infeasible, InputError, SolverError
from metropilot.physics import Track, Vehicle, effort_at, mean_slopes, track_arrays, vehicle_arrays
from metropilot.planning.cone_program import (
    Answer,
    Effort,
    Exchange,
    NoSolution,
    Programme,
    TimeBound,
    solve,
    solve_together,
    tangents,
)
from metropilot.planning.effort_table import Specific, specific
from metropilot.planning.fastest import braking_energy, fastest_profile, relaxed_cap, times
from metropilot.planning.follow_map import follow_map
from metropilot.planning.loads import all_trainsets, build_loads, total_weight
from metropilot.planning.mesh import Coupled, CoupledMeans, Mesh, build_mesh
from metropilot.planning.prices import Objective, cost_per_metre, is_mapped, prices_at
from metropilot.railway import Section, Trainset
from metropilot.units import J_PER_KWH

PASSES = 6
DUAL_TOLERANCE = 5e-5
"""Relative change of the dual value below which the linearisation has settled."""
ENERGY_TOLERANCE = 1e-3
"""Change of kinetic energy, relative to its largest, that makes a tangent stale."""
BINDING_TOLERANCE = 1e-4
"""Distance from an effort curve, relative to its largest force, at which it counts as met."""
EARLY_S = 0.01
LOOSE_GAP, LOOSE_S = 5e-4, 0.1
"""Excess over the bound and time left unused that are due to speeds below the kinetic energies."""
TIGHT = 1e-3
"""Relative distance of the speeds from the kinetic energies up to which the cones count as met."""
MESH_TOLERANCE = 2e-4
"""Share of the minimum running time by which a plan may be late: what meshes and tables differ by."""
SLOW_PER_M = 1e-6
NOTHING_J = 1e3
"""Below this an energy counts as none in the certificate."""
COUNTS_J = 1.8e4
"""Optimum, 0.00 kWh in a table, below which no excess over it is stated: on a long fall it is zero."""
FINE_M = 2.0
START_STRETCH_M = 3.0
LEAST_HELD_MPS2 = 0.15
"""Deceleration that the service brake must leave on a fall at the stop: with less some drivers overshoot."""
RATIOS = (1.02, 1.03, 1.05, 1.075, 1.1, 1.15, 1.2, 1.25, 1.3, 1.4, 1.5, 1.6)


@dataclass(frozen=True)
class PlanOptions:
    """Options of a plan.

    Attributes:
        objective: ``wheel``: mechanical traction energy; ``line``: net electrical energy with efficiency,
            auxiliaries and recovered braking.
        spacing_m: Largest segment of the mesh.
        start_m: Position the plan begins at.
        start_mps: Speed there.
        start_mps2: Acceleration there (only the jerk bound asks for it).
        end_mps: Speed at the destination.
        jerk_mps3: Bound on jerk the plan allows for, or None.
        release_mps3: Jerk at which the last brake is let go, or None for ``jerk_mps3``.
        late_w: Price of a second later than asked for, W per kg of effective mass (of all trainsets); None
            forbids it. A driver
            that re-plans on the way sets it: then there is a plan even when the time cannot be met.
        cap_m: Positions of a further speed cap, or None.
        cap_mps: The cap at those positions (for instance what protection permits).
        coupled: Trainsets coupled behind at constant distances, for which the plan is made too: energies and
            bound are sums over all, speed and acceleration keep the limits of each.
        acceleration_mps2: Acceleration limit below the trainset's, or None for that.
        deceleration_mps2: Deceleration limit below the trainset's, or None for that.
        passes: Most passes of the linearisation; the second one is within 0.06 % of the last.
    """

    objective: Objective = declare("wheel", choices=get_args(Objective))
    spacing_m: float = declare(12.5, unit="m", low=0.0, above=True)
    start_m: float = 0.0
    start_mps: float = declare(0.0, unit="m/s", low=0.0)
    start_mps2: float = declare(0.0, unit="m/s^2", low=-math.inf)
    end_mps: float = declare(0.0, unit="m/s", low=0.0)
    jerk_mps3: float | None = declare(None, unit="m/s^3", low=0.0, above=True)
    release_mps3: float | None = declare(None, unit="m/s^3", low=0.0, above=True)
    late_w: float | None = declare(None, unit="W/kg", low=0.0)
    cap_m: Float[ndarray, " grid"] | None = None
    cap_mps: Float[ndarray, " grid"] | None = None
    coupled: tuple[Coupled, ...] = ()
    acceleration_mps2: float | None = declare(None, unit="m/s^2", low=0.0, above=True)
    deceleration_mps2: float | None = declare(None, unit="m/s^2", low=0.0, above=True)
    passes: int = declare(PASSES, low=1)

    def __post_init__(self) -> None:
        """Refuse fields out of range, and a cap without as many positions.

        Raises:
            InputError: Naming the field and what is allowed.
        """
        check_fields(self)
        at, cap = (() if each is None else np.shape(each) for each in (self.cap_m, self.cap_mps))
        if at != cap:
            words = "not a speed for each position"
            raise InputError(words, field="cap_mps", value=str(cap), allowed=f"shape {at} of cap_m")


@dataclass(frozen=True)
class Plan:
    """A speed profile over distance with what it costs and what nothing can undercut.

    Attributes:
        position_m: Nodes. Shape (N+1,).
        speed_mps: Speed at the nodes. Shape (N+1,).
        time_s: Time since the start at the nodes, dwells included. Shape (N+1,).
        traction_n: Traction force of the (first) trainset on each segment. Shape (N,).
        brake_n: Its braking force. Shape (N,).
        electric_brake_n: The part of it that the electric brake gives. Shape (N,).
        running_time_s: Total time, dwells included.
        energy_j: Objective of the plan, evaluated on its own speed profile.
        bound_j: Dual value: no drive of the convex problem costs less (if it may be late: no drive as late).
        energy_wheel_j: Mechanical traction energy of the plan.
        second_w: Cost of the last second: the energy saved by one more second of running time, J/s.
        tightness: Largest relative gap of the cones ``v^2 <= 2E`` (0: tight).
        effort_excess: Largest share by which a force of the plan exceeds the effort curve at its own speed.
        passes: Linearisation passes used.
        dwell_s: Dwell at each free stop, in order.
        trainset_energy_j: Part of each coupled trainset in ``energy_j``, the head first.
    """

    position_m: Float[ndarray, " nodes"]
    speed_mps: Float[ndarray, " nodes"]
    time_s: Float[ndarray, " nodes"]
    traction_n: Float[ndarray, " segments"]
    brake_n: Float[ndarray, " segments"]
    electric_brake_n: Float[ndarray, " segments"]
    running_time_s: float
    energy_j: float
    bound_j: float
    energy_wheel_j: float
    second_w: float
    tightness: float
    effort_excess: float
    passes: int
    dwell_s: tuple[float, ...] = ()
    trainset_energy_j: tuple[float, ...] = ()

    @property
    def gap(self) -> float:
        """Certificate: share by which the plan's energy lies above the bound."""
        return (self.energy_j - self.bound_j) / max(abs(self.bound_j), NOTHING_J)

    @property
    def energy_kwh(self) -> float:
        """Objective, kWh."""
        return self.energy_j / J_PER_KWH


def excess_percent(energy_j: float, least_j: float) -> float | None:
    """Energy above the least one, %; None where there is next to nothing to compare with.

    Args:
        energy_j: Energy of a drive.
        least_j: Energy of the optimum; at the line it may be negative, more returned than drawn.
    """
    return 100.0 * (energy_j / least_j - 1.0) if least_j >= COUNTS_J else None


def minimum_running_time(
    section: Section, trainset: Trainset, *, start_mps: float = 0.0, end_mps: float = 0.0
) -> float:
    """Running time of the flat-out run, s: no drive under these limits is faster.

    Raises:
        Infeasible: The service brake does not hold the trainset at the stop.
    """
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    if end_mps <= 0.0:
        _check_held(vehicle, track)
    return fastest_time(vehicle, track, PlanOptions(start_mps=start_mps, end_mps=end_mps))


def fastest_time(vehicle: Vehicle, track: Track, options: PlanOptions) -> float:
    """Flat-out time from the state in ``options`` on a mesh of ``FINE_M``, s."""
    table = limit_acceleration(specific(vehicle), options)
    mesh = _mesh(vehicle, track, options, FINE_M)
    energy = fastest_profile(table, mesh, options.start_mps, options.end_mps)
    return float(times(mesh, energy).sum())


def optimal_plan(
    section: Section, trainset: Trainset, time_s: float, options: PlanOptions | None = None
) -> Plan:
    """The plan of least energy that covers the section within a running time.

    Args:
        section: Section.
        trainset: Trainset with its load.
        time_s: Running time (or time left, when starting on the way).
        options: See :class:`PlanOptions`.

    Raises:
        Infeasible: The running time is below the minimum, which the message names, the jerk limit is too
            low for it, or the trainset cannot cover the section at all.
        SolverError: The solver did not finish.
    """
    options = options or PlanOptions()
    with within_jerk(options):
        return plan_arrays(vehicle_arrays(trainset), track_arrays(section, trainset), time_s, options)


@contextmanager
def within_jerk(options: PlanOptions) -> Iterator[None]:
    """Refuse the jerk limit of a plan that exists only without it: the time is checked before.

    Raises:
        Infeasible: The programme made inside has no solution.
    """
    try:
        yield
    except NoSolution:
        if options.jerk_mps3 is None:
            raise
        raise Infeasible(
            "no plan keeps this jerk limit in this time",
            field="jerk",
            value=options.jerk_mps3,
            unit="m/s³",
            allowed="a higher limit, or more time",
        ) from None


def plan_arrays(
    vehicle: Vehicle, track: Track, time_s: float, options: PlanOptions, about: Plan | None = None
) -> Plan:
    """:func:`optimal_plan` for arrays already built; see there.

    ``about`` is a plan of much the same drive, made before: starting from its speeds saves passes.
    """
    table = limit_acceleration(specific(vehicle), options)
    mesh = _mesh(vehicle, track, options, options.spacing_m)
    energy = fastest_profile(table, mesh, options.start_mps, options.end_mps)
    fastest = float(times(mesh, energy).sum())
    # before the time is judged: one made from a minimum that does not end is no fault of its own
    if not np.isfinite(fastest):
        explain_stall(mesh, energy)
    if not np.isfinite(time_s) or time_s <= 0:
        raise InputError(
            "running time out of range", field="time", value=time_s, unit="s", allowed="finite, > 0"
        )
    if options.late_w is None:
        _check_stop(table, mesh, options)
        if options.end_mps <= 0.0:
            _check_held(vehicle, track)
        time_s = _possible(vehicle, track, time_s, fastest, options)
    if about is not None:
        known = np.interp(mesh.node_m, about.position_m, 0.5 * about.speed_mps**2)
        energy = np.minimum(energy, known)
    bounds = (TimeBound(0, mesh.length_m.size, None, time_s - float(_ramp_times(mesh, options).sum())),)
    return iterate(vehicle, table, mesh, energy, bounds, (), options)


def _possible(vehicle: Vehicle, track: Track, time_s: float, fastest: float, options: PlanOptions) -> float:
    """The time asked for, or what the mesh can keep where that is a hair later than the true minimum.

    Raises:
        Infeasible: The time is below the minimum running time.
    """
    kept = fastest * (1.0 + MESH_TOLERANCE)
    if time_s >= kept:
        return time_s
    exact = fastest_time(vehicle, track, options)
    if time_s < exact:
        least = math.ceil(exact * 10.0) / 10.0
        raise Infeasible(
            f"minimum running time is {least:.1f} s",
            field="time",
            value=round(time_s, 3),
            unit="s",
            allowed=f">= {least:.1f} s",
        )
    return kept


def _check_stop(table: Specific, mesh: Mesh, options: PlanOptions) -> None:
    """Refuse a start that is too fast for the end.

    Raises:
        Infeasible: Full braking from the start does not do.
    """
    left = float(braking_energy(table, mesh, options.start_mps)[-1])
    if left > 0.5 * options.end_mps**2 + 1e-9:
        raise Infeasible(
            f"the brakes cannot bring it below {math.sqrt(2 * left):.1f} m/s before the destination",
            field="start",
            value=round(options.start_mps, 3),
            unit="m/s",
        )


def _check_held(vehicle: Vehicle, track: Track) -> None:
    """Refuse a stop on a fall that leaves next to nothing of the service brake.

    Raises:
        Infeasible: Less than ``LEAST_HELD_MPS2`` is left.
    """
    still = np.float64(0.0)
    gradient, curve, _ = mean_slopes(vehicle, track, np.float64(track.length_m))
    pull_n = -float(vehicle.mass_kg * (vehicle.gravity_mps2 * gradient + curve))
    left = (float(effort_at(vehicle, still).brake_n) - pull_n) / float(vehicle.effective_mass_kg)
    if left < LEAST_HELD_MPS2:
        raise Infeasible(
            "the service brake hardly holds the trainset at the stop",
            field="section",
            value=round(left, 3),
            unit="m/s^2",
            allowed=f">= {LEAST_HELD_MPS2:g} m/s^2 left on the fall",
        )


def _ramp_times(mesh: Mesh, options: PlanOptions) -> ndarray:
    """Time that the jerk bound costs on the first and last segment beyond constant acceleration, s.

    From rest ``x = J t^3 / 6``: the segment takes 3/2 of the time that its end speed suggests. Shape (2,).
    """
    jerk = options.jerk_mps3
    if jerk is None:
        return np.zeros(2)
    release = options.release_mps3 or jerk
    ends = ((options.start_mps, mesh.length_m[0], jerk), (options.end_mps, mesh.length_m[-1], release))
    return np.array([(6 * ds / j) ** (1 / 3) / 3 if v == 0 else 0.0 for v, ds, j in ends])


def limit_acceleration(table: Specific, options: PlanOptions) -> Specific:
    """The trainset's table with the acceleration limits of the options where they are lower."""
    if options.acceleration_mps2 is None and options.deceleration_mps2 is None:
        return table
    faster, slower = (
        math.inf if own is None else own for own in (options.acceleration_mps2, options.deceleration_mps2)
    )
    return table._replace(
        acceleration=min(faster, table.acceleration), deceleration=min(slower, table.deceleration)
    )


def _mesh(vehicle: Vehicle, track: Track, options: PlanOptions, spacing_m: float) -> Mesh:
    length = float(track.length_m)
    if not 0 <= options.start_m < length:
        raise InputError(
            "start outside the section",
            field="start",
            value=options.start_m,
            unit="m",
            allowed=f"0 to {length:g} m",
        )
    ends = np.array([options.start_m, length])
    cap = options.cap_mps, options.cap_m
    return build_mesh(vehicle, track, ends, spacing_m, *cap, options.coupled)


def explain_stall(mesh: Mesh, energy: ndarray) -> None:
    """Say where a trainset stalls and what holds it.

    Raises:
        Infeasible: Always.
    """
    stalled = np.flatnonzero((energy[:-1] <= 0) & (energy[1:] <= 0))
    where = float(mesh.node_m[stalled[0]]) if stalled.size else float("nan")
    steepest = np.max([mesh.slope_mps2, *(each.slope_mps2 for each in mesh.coupled)], axis=0)
    force = float(steepest[stalled[0]]) if stalled.size else float("nan")
    raise Infeasible(
        f"the trainset stalls at {where:.0f} m, where gradient and curve take {force:.3f} N/kg",
        field="section",
    )


def iterate(
    vehicle: Vehicle,
    table: Specific,
    mesh: Mesh,
    energy: ndarray,
    bounds: Sequence[TimeBound],
    dwells: Sequence[tuple[float, float]],
    options: PlanOptions,
    floor_mps: Float[ndarray, " nodes"] | None = None,
) -> Plan:
    """Solve, move the linearisation to the answer, and repeat until the energy settles.

    Prices of an efficiency map move along with it: see :func:`follow_map`.
    """
    loads = build_loads(vehicle, table, mesh)
    # the programme counts per kg of the first trainset
    late_w = None if options.late_w is None else options.late_w * total_weight(loads)
    base = Programme(
        mesh=mesh,
        table=table,
        loads=loads,
        prices=prices_at(loads, options.objective, energy, None),
        start_mps=options.start_mps,
        end_mps=options.end_mps,
        cap_mps=relaxed_cap(table, mesh, options.start_mps),
        bounds=tuple(bounds),
        dwells=tuple(dwells),
        floor_mps=floor_mps,
        jerk_mps3=options.jerk_mps3,
        start_mps2=options.start_mps2,
        stands=options.start_mps == 0,
        release_mps3=options.release_mps3,
        late_w=late_w,
    )
    answer, count = _solve(base, energy, options)
    if _slack(answer) > TIGHT and _drives_otherwise(base, answer, _evaluate(base, answer, options, count)):
        base, answer, more = _tighten(base, answer, options)
        count += more
    if _too_early(base, answer):
        # the bound without the stricter rows stays one with them
        strict = replace(base, strictly_early=True)
        kept, more = solve_until_settled(strict, answer.energy, options.passes)
        answer, count = replace(kept, dual=answer.dual), count + more
    return _evaluate(base, answer, options, count)


def _solve(base: Programme, energy: ndarray, options: PlanOptions) -> tuple[Answer, int]:
    """Solve a programme about an energy until it settles; the answer and the number of passes."""
    if options.objective == "line" and any(map(is_mapped, base.loads.vehicles)):
        return follow_map(base, energy)
    answer, count = solve_until_settled(base, energy, options.passes)
    if _uses_less_time(base, answer):
        return _use_full_running_time(base, answer), count + 1
    return answer, count


def _tighten(base: Programme, loose: Answer, options: PlanOptions) -> tuple[Programme, Answer, int]:
    """A plan with the resistance of its own speeds, where the answer has speeds below ``sqrt(2 E)``.

    Where time is worth less than drag, as in a valley in which the limit is reached by rolling, the programme
    gains from a resistance at a speed it does not have. The plan then takes the resistance by its tangent
    over kinetic energy, which lies above it: every answer can be driven. The bound is that of the programme
    with the secant of the speeds, which is nearest to them of all that is convex.

    Returns:
        The programme of the plan, its answer and the number of passes.
    """
    secant = replace(base, secant_speeds=True)
    strict = replace(base, linear_drag=True)
    try:
        kept, more = _solve(strict, loose.energy, options)
        bound, count = _solve(secant, loose.energy, options)
    except SolverError:
        # a tangent may ask for more than full traction gives; the loose answer is a plan, too
        return base, loose, 1
    return strict, replace(kept, dual=max(loose.dual, bound.dual)), count + more


def _drives_otherwise(base: Programme, answer: Answer, plan: Plan) -> bool:
    """True if the answer's own speeds cost more than its bound or leave time unused, by what counts."""
    if plan.energy_j < NOTHING_J:
        return False
    seconds = float(times(base.mesh, answer.energy).sum() - answer.time.sum())
    return plan.gap > LOOSE_GAP or seconds < -LOOSE_S


def _slack(answer: Answer) -> float:
    """Largest distance of the answer's speeds from its kinetic energies, relative to the largest energy."""
    return float((2 * answer.energy - answer.speed**2).max()) / max(float(2 * answer.energy.max()), 1e-9)


def solve_until_settled(base: Programme, energy: ndarray, passes: int = PASSES) -> tuple[Answer, int]:
    """Solve about the last answer until the energy settles; the answer and the number of passes."""
    answers, _, count = _settle([base], [energy], None, passes)
    return answers[0], count


def solve_together_until_settled(
    programmes: Sequence[Programme], energies: Sequence[ndarray], exchange: Exchange
) -> tuple[list[Answer], float]:
    """Solve programmes that exchange energy in the same way; the answers and the dual objective of all."""
    answers, dual, _ = _settle(programmes, energies, exchange, PASSES)
    return answers, dual


def _settle(
    programmes: Sequence[Programme], energies: Sequence[ndarray], exchange: Exchange | None, passes: int
) -> tuple[list[Answer], float, int]:
    (answers, dual), last, count = solve_together(programmes, energies, exchange), np.inf, 1
    while count < passes:
        each = zip(programmes, energies, answers, strict=True)
        if abs(dual - last) <= DUAL_TOLERANCE * abs(dual) or all(_curves_fit(*one) for one in each):
            break
        energies, last = [answer.energy for answer in answers], dual
        (answers, dual), count = solve_together(programmes, energies, exchange), count + 1
    return answers, dual, count


def _curves_fit(base: Programme, energy: ndarray, answer: Answer) -> bool:
    """True if every effort curve the answer runs into is met where its tangent was taken.

    A tangent matters only where it binds, and there it is the curve itself if the energy has not moved.
    """
    if base.jerk_mps3 is not None or base.strictly_early or base.linear_drag:
        return float(np.max(np.abs(answer.energy - energy))) < ENERGY_TOLERANCE * float(answer.energy.max())
    here = base.loads.segment
    before, after = (0.5 * (e[1:] + e[:-1]) for e in (energy, answer.energy))
    change = (after - before)[here]
    moved = np.abs(change) > ENERGY_TOLERANCE * float(after.max())
    efforts: list[tuple[Effort, ndarray]] = [
        ("traction", answer.traction),
        ("braking", answer.braking),
        ("electric", answer.recovered),
    ]
    for effort, force in efforts:
        value, slope = tangents(base.loads, effort, before)
        binds = force > value + slope * change - BINDING_TOLERANCE * value.max()
        if np.any(binds & moved & (force > 0)):
            return False
    return True


def _uses_less_time(base: Programme, answer: Answer) -> bool:
    """True if the answer leaves time unused, by the programme's clock or by its own speeds."""
    asked = base.bounds[0].high_s if len(base.bounds) == 1 else None
    given = float(answer.time.sum()) if asked is None else asked
    return float(given - times(base.mesh, answer.energy).sum()) > EARLY_S


def _too_early(base: Programme, answer: Answer) -> bool:
    """True if the answer's own speeds undercut a lower time bound that its time variables keep."""
    seconds = times(base.mesh, answer.energy)
    return any(
        float(seconds[b.first : b.last].sum() + answer.dwell[list(b.waits)].sum()) < b.low_s - EARLY_S
        for b in base.bounds
        if b.low_s is not None
    )


def _use_full_running_time(base: Programme, answer: Answer) -> Answer:
    """Of all drives that cost no more, a slow one that uses the time.

    Where going slower saves nothing, as on a section that is all downhill, the optimum may arrive early; a
    negligible price on kinetic energy breaks the tie. The bound stays that of the programme itself.
    """
    slow = np.full(base.loads.segment.size, SLOW_PER_M)
    prices = base.prices._replace(energy=slow, energy_at=np.zeros_like(slow))
    return replace(solve(replace(base, prices=prices), answer.energy), dual=answer.dual)


def _evaluate(base: Programme, answer: Answer, options: PlanOptions, passes: int) -> Plan:
    """The plan of an answer: its speed profile evaluated by itself, and what the answer says beyond it."""
    vehicle, table = base.loads.vehicles[0], base.table
    return replace(
        evaluate_profile(vehicle, table, base.mesh, answer.energy, options),
        bound_j=(answer.dual - (base.late_w or 0.0) * answer.late) * table.mass_kg,
        second_w=answer.second * table.mass_kg,
        tightness=_slack(answer),
        passes=passes,
        dwell_s=tuple(float(w) for w in answer.dwell),
    )


def evaluate_profile(
    vehicle: Vehicle, table: Specific, mesh: Mesh, energy: Float[ndarray, " nodes"], options: PlanOptions
) -> Plan:
    """Evaluate a speed profile: forces from the dynamics, times from the speeds; it has no bound.

    Args:
        vehicle: Trainset.
        table: The same, per kg.
        mesh: Mesh, with the coupled trainsets.
        energy: ``v^2/2`` at the nodes.
        options: Objective, speeds at the ends, jerk.
    """
    speed = np.sqrt(2 * energy)
    speed[0], speed[-1] = options.start_mps, options.end_mps
    duration = times(mesh, 0.5 * speed**2)
    duration[[0, -1]] += _ramp_times(mesh, options)
    needs = [
        _evaluate_forces(each, mesh.length_m, speed, duration, options.objective)
        for each in all_trainsets(vehicle, table, mesh)
    ]
    head = needs[0]
    clock = np.concatenate([[0.0], np.cumsum(duration)])
    return Plan(
        position_m=mesh.node_m,
        speed_mps=speed,
        time_s=clock,
        traction_n=head.traction * table.mass_kg,
        brake_n=head.brake * table.mass_kg,
        electric_brake_n=head.electric * table.mass_kg,
        running_time_s=float(clock[-1]),
        energy_j=sum(each.cost_j for each in needs),
        bound_j=-math.inf,
        energy_wheel_j=sum(each.wheel_j for each in needs),
        second_w=math.nan,
        tightness=0.0,
        effort_excess=max(each.excess for each in needs),
        passes=0,
        trainset_energy_j=tuple(each.cost_j for each in needs),
    )


class _Needs(NamedTuple):
    """Forces that a trainset needs for a speed profile, per kg, and what they cost, J."""

    traction: ndarray
    brake: ndarray
    electric: ndarray
    wheel_j: float
    cost_j: float
    excess: float


def _evaluate_forces(
    own: CoupledMeans, ds: ndarray, speed: ndarray, duration: ndarray, objective: Objective
) -> _Needs:
    """Forces of one trainset from the dynamics."""
    table, energy = own.table, 0.5 * speed**2
    a, b, c = table.davis
    quad = c + own.tunnel_n / table.mass_kg
    drag = a + 0.5 * b * (speed[1:] + speed[:-1]) + quad * (energy[1:] + energy[:-1]) + own.slope_mps2
    effort = np.diff(energy) / ds + drag
    traction, brake = np.maximum(effort, 0.0), np.maximum(-effort, 0.0)
    recovered = np.minimum(
        brake, np.interp(np.sqrt(energy[1:] + energy[:-1]), table.speed_mps, table.electric)
    )
    middle = 0.5 * (energy[1:] + energy[:-1])
    work = cost_per_metre(own.vehicle, table, objective, middle, traction, recovered)
    cost = float(np.sum(ds * work))
    if objective == "line":
        cost += float(own.vehicle.auxiliary_w) / table.mass_kg * float(duration.sum())
    available = np.interp(np.sqrt(2 * middle), table.speed_mps, table.traction)
    excess = traction / np.maximum(available, 1e-9) - 1.0
    return _Needs(
        traction,
        brake,
        recovered,
        float(np.sum(traction * ds)) * table.mass_kg,
        cost * table.mass_kg,
        float(np.max(np.where(traction > 1e-6, excess, 0.0))),
    )


def plan_speed(plan: Plan, position_m: float) -> float:
    """Speed of the plan at a position; kinetic energy is linear between its nodes."""
    return float(np.sqrt(np.interp(position_m, plan.position_m, plan.speed_mps**2)))


def plan_time(plan: Plan, position_m: float) -> float:
    """Time since the plan's start at a position, at constant acceleration between its nodes."""
    k = int(np.clip(np.searchsorted(plan.position_m, position_m, side="right") - 1, 0, plan.time_s.size - 2))
    v0, v = float(plan.speed_mps[k]), plan_speed(plan, position_m)
    gone = min(max(position_m, float(plan.position_m[k])), float(plan.position_m[-1])) - float(
        plan.position_m[k]
    )
    return float(plan.time_s[k]) + (2 * gone / (v0 + v) if v0 + v > 1e-6 else 0.0)


def ramped_acceleration(plan: Plan, position_m: float) -> float:
    """Acceleration of a plan that allows for the jerk limit: linear between the middles of its segments."""
    change = np.diff(plan.speed_mps**2) / (2 * np.diff(plan.position_m))
    return float(np.interp(position_m, 0.5 * (plan.position_m[1:] + plan.position_m[:-1]), change))


def pull_away(plan: Plan, position_m: float) -> float:
    """Acceleration to ask for just after departure: the largest planned near by; the plant builds it up."""
    change = np.diff(plan.speed_mps**2) / (2 * np.diff(plan.position_m))
    near = plan.position_m[:-1] < position_m + START_STRETCH_M
    return float(change[near].max())


@dataclass(frozen=True)
class Front:
    """Optimal energy over running time.

    Attributes:
        minimum_s: Minimum running time.
        time_s: Running times, increasing. Shape (P,).
        energy_j: Optimal energy at each. Shape (P,).
        second_w: Energy saved by one more second at each, J/s. Shape (P,).
        plans: The plans themselves.
    """

    minimum_s: float
    time_s: Float[ndarray, " points"]
    energy_j: Float[ndarray, " points"]
    second_w: Float[ndarray, " points"]
    plans: tuple[Plan, ...]


def time_energy_front(
    section: Section,
    trainset: Trainset,
    times_s: Sequence[float] | None = None,
    options: PlanOptions | None = None,
) -> Front:
    """Optimal plans at several running times.

    Args:
        section: Section.
        trainset: Trainset with its load.
        times_s: Running times; None takes 1.02 to 1.6 of the minimum.
        options: See :class:`PlanOptions`.

    Raises:
        Infeasible: A time is below the minimum.
    """
    minimum = minimum_running_time(section, trainset)
    wanted = sorted(times_s) if times_s is not None else [minimum * r for r in RATIOS]
    plans = tuple(optimal_plan(section, trainset, t, options) for t in wanted)
    return Front(
        minimum_s=minimum,
        time_s=np.array(wanted),
        energy_j=np.array([p.energy_j for p in plans]),
        second_w=np.array([p.second_w for p in plans]),
        plans=plans,
    )
