"""The energy-optimal drive as a convex cone programme, solved by Clarabel.

On a space mesh take kinetic energy ``E`` and speed ``v`` at each node, and traction ``f``, braking ``b`` and
time ``t`` on each segment, all per kg of effective mass::

    minimise   sum ds (c(f) - d(e)) + p sum t               (c convex, d concave: lines for a constant)
    subject to (E' - E) / ds = f - b - r(v, E) - g          (linear: Davis in the mean v and mean 2 E)
               v^2 <= 2 E,   t (v + v') >= 2 ds             (cones, tight at the optimum)
               0 <= f <= F(E),  0 <= b <= B(E),  0 <= e <= min(b, R(E))
               |E' - E| <= a ds,   E <= V^2 / 2,   sums of t within the timing points

``e`` (recovered braking) exists only if it is worth something. The effort curves ``F, B, R`` are replaced by
their tangents at the last iterate; a few passes settle them. The bound on jerk, if any, is linearised the
same way: the change of acceleration between neighbouring segments over the time between their middles.

Trainsets coupled behind the first share ``E, v, t``; the dynamics and the forces ``f, b, e`` are there once
for each load (see :mod:`metropilot.planning.loads`), weighted by mass in the objective.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import clarabel as _clarabel
import numpy as np
from numpy import ndarray
from scipy import sparse

from metropilot._typing import Float, Int
from metropilot.errors import SolverError
from metropilot.planning.effort_table import Specific
from metropilot.planning.fastest import lowest_service_rate
from metropilot.planning.loads import Loads
from metropilot.planning.mesh import Mesh
from metropilot.planning.prices import Prices

clarabel: Any = _clarabel
"""The solver ships no type information."""
SLOWEST_J = 1e-4
DRAG_LEAST_J = 0.5
"""Kinetic energy, J/kg, below which the tangent of a drag is not taken: it would rise too steeply."""
SOFT_START = 6 ** (4 / 3) / 8
"""Under a constant jerk J from rest ``v^2/2 = SOFT_START * J^(2/3) * x^(4/3)``."""


class NoSolution(SolverError):
    """No drive keeps every constraint of the programme."""


@dataclass
class ConstraintRows:
    """Sparse rows ``A x <= / = b`` being collected, whole blocks at a time."""

    row: list[ndarray] = field(default_factory=list)
    col: list[ndarray] = field(default_factory=list)
    val: list[ndarray] = field(default_factory=list)
    rhs: list[ndarray] = field(default_factory=list)
    count: int = 0

    def add(self, terms: Sequence[tuple[ndarray, ndarray | float]], rhs: ndarray | float, size: int) -> None:
        """``size`` rows; each term is (column of each row, coefficient of each row)."""
        rows = self.count + np.arange(size)
        for col, val in terms:
            self.row.append(rows)
            self.col.append(np.broadcast_to(col, (size,)))
            self.val.append(np.broadcast_to(np.asarray(val, np.float64), (size,)))
        self.rhs.append(np.broadcast_to(np.asarray(rhs, np.float64), (size,)))
        self.count += size

    def add_cones(
        self, triples: list[list[tuple[ndarray, float]]], rhs: list[ndarray | float], size: int
    ) -> None:
        """``size`` second-order cones of three rows each: ``b - A x`` of the first >= norm of the others."""
        for part, (terms, constant) in enumerate(zip(triples, rhs, strict=True)):
            rows = self.count + 3 * np.arange(size) + part
            for col, val in terms:
                self.row.append(rows)
                self.col.append(col)
                self.val.append(np.full(size, val))
            if part == 0:
                self.rhs.append(np.zeros(3 * size))
            self.rhs[-1][part::3] = constant
        self.count += 3 * size

    def add_sum(self, terms: Sequence[tuple[ndarray, ndarray | float]], rhs: float) -> int:
        """One row over many columns; returns its number."""
        for col, val in terms:
            self.row.append(np.full(col.size, self.count))
            self.col.append(col.astype(int))
            self.val.append(np.broadcast_to(np.asarray(val, np.float64), col.shape))
        self.rhs.append(np.array([rhs]))
        self.count += 1
        return self.count - 1


@dataclass(frozen=True)
class TimeBound:
    """``low <= t(segments first..last) + waits <= high`` for one partial sum of the running time.

    Attributes:
        first: First segment of the sum.
        last: One past the last segment.
        low_s: Lower bound or None.
        high_s: Upper bound or None.
        waits: Indices of the dwell variables added to the sum.
    """

    first: int
    last: int
    low_s: float | None
    high_s: float | None
    waits: tuple[int, ...] = ()


@dataclass(frozen=True)
class Programme:
    """Data of the cone programme.

    Attributes:
        mesh: Mesh.
        table: Trainset.
        loads: Forces to decide on: those of the trainset and of the ones coupled behind it.
        prices: Objective.
        start_mps: Speed at the first node.
        end_mps: Speed at the last node.
        cap_mps: Speed caps, relaxed where the start is too fast. Shape (N+1,).
        bounds: Timing.
        dwells: Shortest and longest dwell of each free stop.
        floor_mps: Lowest speed at each node, or None. Shape (N+1,).
        jerk_mps3: Bound on jerk or None.
        start_mps2: Acceleration before the first node, for the jerk bound.
        stands: True if the run begins from rest (the acceleration then starts from zero).
        release_mps3: Jerk at which the brake is let go at the last node, or None for the bound on jerk.
        late_w: Price of a second later than the last bound, W per kg, or None to forbid it.
        strictly_early: True to linearise lower time bounds about the last iterate, rather than put them on
            the time variables, which may exceed the true times where going slower saves nothing.
        linear_drag: True to take the linear part of the resistance at the tangent of ``sqrt(2 E)`` about the
            last iterate, rather than at ``v``, which may lie below it where time is worth less than drag.
        secant_speeds: True to add the secant ``v >= 2 E / cap`` of each node, which every drive keeps.
    """

    mesh: Mesh
    table: Specific
    loads: Loads
    prices: Prices
    start_mps: float
    end_mps: float
    cap_mps: Float[ndarray, " nodes"]
    bounds: tuple[TimeBound, ...]
    dwells: tuple[tuple[float, float], ...] = ()
    floor_mps: Float[ndarray, " nodes"] | None = None
    jerk_mps3: float | None = None
    start_mps2: float = 0.0
    stands: bool = True
    release_mps3: float | None = None
    late_w: float | None = None
    strictly_early: bool = False
    linear_drag: bool = False
    secant_speeds: bool = False


@dataclass(frozen=True)
class Answer:
    """A solved programme.

    Attributes:
        energy: Kinetic energy per kg at the nodes. Shape (N+1,).
        speed: The programme's speeds at the nodes, at most ``sqrt(2 energy)``. Shape (N+1,).
        traction: Per kg, of each load. Shape (U,).
        braking: Per kg, of each load. Shape (U,).
        recovered: Per kg, the electric part that is recovered. Shape (U,).
        time: On each segment. Shape (N,).
        dwell: Dwell at each free stop. Shape (D,).
        seconds: Cost of one second less: the multiplier of each upper time bound, W per kg.
        primal: Objective, J/kg.
        dual: Dual objective: no drive of the programme costs less, J/kg.
        late: Delay beyond the last bound, s.
        status: The solver's word.
    """

    energy: Float[ndarray, " nodes"]
    speed: Float[ndarray, " nodes"]
    traction: Float[ndarray, " loads"]
    braking: Float[ndarray, " loads"]
    recovered: Float[ndarray, " loads"]
    time: Float[ndarray, " segments"]
    dwell: Float[ndarray, " dwells"]
    seconds: tuple[float, ...]
    primal: float
    dual: float
    late: float
    status: str

    @property
    def second(self) -> float:
        """Cost of one second less of the last upper time bound."""
        return self.seconds[-1] if self.seconds else 0.0


Effort = Literal["traction", "braking", "electric"]


def tangents(loads: Loads, effort: Effort, energy: ndarray) -> tuple[ndarray, ndarray]:
    """Value and slope over kinetic energy of an effort of each load at the mid energies of the segments."""
    parts = [
        _tangent(table, getattr(table, effort), energy[loads.segment[loads.of_kind(kind)]])
        for kind, table in enumerate(loads.tables)
    ]
    value, slope = zip(*parts, strict=True)
    return np.concatenate(value), np.concatenate(slope)


def _tangent(table: Specific, values: ndarray, energy: ndarray) -> tuple[ndarray, ndarray]:
    speed = np.sqrt(2 * np.maximum(energy, 0.0))
    step = table.speed_mps[1]
    value = np.interp(speed, table.speed_mps, values)
    ahead = np.interp(speed + step, table.speed_mps, values)
    behind = np.interp(np.maximum(speed - step, 0.0), table.speed_mps, values)
    slope = (ahead - behind) / (2 * step) / np.maximum(speed, 1.0)
    return value, slope


def solve(programme: Programme, energy: Float[ndarray, " nodes"]) -> Answer:
    """Solve the programme with its curves linearised about the kinetic energies ``energy``.

    Raises:
        SolverError: The solver did not finish (also if the timing cannot be met: check that first).
    """
    return solve_together([programme], [energy])[0][0]


class Exchange(NamedTuple):
    """Energy that drives solved together receive of each other, by groups of segments.

    Returned energy of a group is received up to a power over the time on its segments, and beyond that by
    groups whose traction draws, each joule once.

    Attributes:
        group: Group of each segment of all programmes, one after the other. Shape (N,).
        pairs: Group of returns and group of draws that may meet. Shape (P, 2).
        power_w: Power received in any case on each segment, W per kg. Shape (N,).
    """

    group: Int[ndarray, " segments"]
    pairs: Int[ndarray, "pairs 2"]
    power_w: Float[ndarray, " segments"]


def solve_together(
    programmes: Sequence[Programme], energies: Sequence[ndarray], exchange: Exchange | None = None
) -> tuple[list[Answer], float]:
    """Solve programmes in one, with what they exchange, and the dual objective of all.

    Raises:
        SolverError: The solver did not finish.
    """
    total, ats = 0, []
    for p in programmes:
        at, total = _columns(p, total, exchange is not None)
        ats.append(at)
    own = total
    total += 0 if exchange is None else exchange.pairs.shape[0]
    parts = list(zip(programmes, ats, energies, strict=True))
    costs = [_objective(p, at, total) for p, at, _ in parts]
    cost, constant = sum(each for each, _ in costs), sum(each for _, each in costs)

    rows = ConstraintRows()
    for p, at, energy in parts:
        _equalities(p, rows, at, energy)
    equal, clocks = rows.count, []
    for p, at, energy in parts:
        _effort_rows(p, rows, at, energy)
        _price_rows(p, rows, at)
        _motion_rows(p, rows, at)
        if p.jerk_mps3 is not None:
            _jerk_rows(p, rows, at, energy)
        clocks.append(_time_rows(p, rows, at, energy))
    if exchange is not None:
        _exchange_rows(programmes, ats, rows, exchange, own)
    inequal = rows.count - equal
    for p, at, _ in parts:
        _cone_rows(p, rows, at)
    matrix = sparse.csc_matrix(
        (np.concatenate(rows.val), (np.concatenate(rows.row), np.concatenate(rows.col))),
        shape=(rows.count, total),
    )
    cones = [clarabel.ZeroConeT(equal), clarabel.NonnegativeConeT(inequal)]
    cones += [clarabel.SecondOrderConeT(3)] * ((rows.count - equal - inequal) // 3)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False
    settings.max_threads = 1
    zero = sparse.csc_matrix((total, total))
    solution = clarabel.DefaultSolver(zero, cost, matrix, np.concatenate(rows.rhs), cones, settings).solve()
    status = str(solution.status)
    if status == "PrimalInfeasible":
        raise NoSolution(f"the plan's solver stopped: {status}")
    if status not in {"Solved", "AlmostSolved"}:
        raise SolverError(f"the plan's solver stopped: {status}")
    x, dual = np.asarray(solution.x), float(solution.obj_val_dual) + constant
    primal = float(solution.obj_val) + constant
    return [
        Answer(
            energy=np.maximum(x[at["E"]], 0.0),
            speed=np.maximum(x[at["v"]], 0.0),
            traction=np.maximum(x[at["f"]], 0.0),
            braking=np.maximum(x[at["b"]], 0.0),
            recovered=x[at["e"]] if "e" in at else np.zeros(p.loads.segment.size),
            time=x[at["t"]],
            dwell=x[at["w"]] if p.dwells else np.zeros(0),
            seconds=tuple(float(solution.z[row]) for row in clock),
            primal=primal,
            dual=dual,
            late=max(float(x[at["late"]][0]), 0.0) if "late" in at else 0.0,
            status=status,
        )
        for (p, at, _), clock in zip(parts, clocks, strict=True)
    ], dual


def _columns(p: Programme, first: int, exchanged: bool) -> tuple[dict[str, ndarray], int]:
    """Columns of the variables of a programme from a first one on, and the next free one."""
    n, loads = p.mesh.length_m.size, p.loads.segment.size
    recovers = bool(np.any(p.prices.recovered.slope > 0))
    wanted = {
        "e": recovers,
        "w": bool(p.dwells),
        "late": p.late_w is not None,
        "cost": not (p.prices.traction.single and p.prices.surplus_w is None),
        "gain": recovers
        and not (p.prices.recovered.single and p.prices.received_w is None and not exchanged),
    }
    names = ["E", "v", "f", "b", "t", *(name for name, there in wanted.items() if there)]
    sizes = {"E": n + 1, "v": n + 1, "t": n, "w": len(p.dwells), "late": 1}
    starts = first + np.cumsum([0, *(sizes.get(k, loads) for k in names)])
    return {k: s + np.arange(sizes.get(k, loads)) for k, s in zip(names, starts[:-1], strict=True)}, int(
        starts[-1]
    )


def _exchange_rows(
    programmes: Sequence[Programme],
    ats: Sequence[dict[str, ndarray]],
    rows: ConstraintRows,
    exchange: Exchange,
    first: int,
) -> None:
    """Rows of what is received of each group, which is no more than is drawn."""
    ds = np.concatenate([p.mesh.length_m for p in programmes])
    gain, force, clock = (np.concatenate([at[name] for at in ats]) for name in ("gain", "f", "t"))
    slope = np.concatenate([p.prices.traction.slope[0] for p in programmes])
    taken = first + np.arange(exchange.pairs.shape[0])
    for group in range(int(exchange.group.max()) + 1):
        of = np.flatnonzero(exchange.group == group)
        some = taken[exchange.pairs[:, 0] == group]
        rows.add_sum([(gain[of], ds[of]), (clock[of], -exchange.power_w[of]), (some, -1.0)], 0.0)
    for group in np.unique(exchange.pairs[:, 1]):
        of = np.flatnonzero(exchange.group == group)
        rows.add_sum([(taken[exchange.pairs[:, 1] == group], 1.0), (force[of], -(ds * slope)[of])], 0.0)
    rows.add([(taken, -1.0)], 0.0, taken.size)


def _objective(p: Programme, at: dict[str, ndarray], total: int) -> tuple[ndarray, float]:
    """Cost of each variable and the constant beside it."""
    segment, prices = p.loads.segment, p.prices
    ds = p.loads.weight * p.mesh.length_m[segment]
    cost = np.zeros(total)
    np.add.at(cost, at["E"][1:][segment], 0.5 * ds * prices.energy)
    np.add.at(cost, at["E"][:-1][segment], 0.5 * ds * prices.energy)
    if "cost" in at:
        cost[at["cost"]] = ds
    else:
        cost[at["f"]] = ds * prices.traction.slope[0]
    if "gain" in at:
        cost[at["gain"]] = -ds
    elif "e" in at:
        cost[at["e"]] = -ds * prices.recovered.slope[0]
    cost[at["t"]] = prices.second_w
    if p.late_w is not None:
        cost[at["late"]] = p.late_w
    return cost, -float(np.sum(ds * prices.energy * prices.energy_at))


def _price_rows(p: Programme, rows: ConstraintRows, at: dict[str, ndarray]) -> None:
    """``cost >= slope f + offset``, ``gain <= slope e + offset`` for every line of a price with several."""
    for name, force, lines, sign in (
        ("cost", "f", p.prices.traction, 1.0),
        ("gain", "e", p.prices.recovered, -1.0),
    ):
        if name in at:
            for slope, offset in zip(*lines, strict=True):
                terms = [(at[force], sign * slope), (at[name], -sign)]
                if name == "cost" and p.prices.surplus_w is not None:
                    # over a segment no less than what exceeds this power in its time
                    here = p.loads.segment
                    terms.append((at["t"][here], -p.prices.surplus_w / p.mesh.length_m[here]))
                rows.add(terms, -sign * offset, offset.size)
    if "cost" in at and p.prices.surplus_w is not None:
        rows.add([(at["cost"], -1.0)], 0.0, at["cost"].size)
    if "gain" in at and p.prices.received_w is not None:
        # over a segment no more than this power in its time
        some = np.flatnonzero(np.isfinite(p.prices.received_w))
        here, most = p.loads.segment[some], p.prices.received_w[some]
        clock = at["t"][here], -most / p.mesh.length_m[here]
        rows.add([(at["gain"][some], 1.0), clock], 0.0, some.size)


def _equalities(p: Programme, rows: ConstraintRows, at: dict[str, ndarray], energy: ndarray) -> None:
    """Dynamics on each segment, and the speeds at the ends and stops."""
    here = p.loads.segment
    ds, (a, b, quad) = p.mesh.length_m[here], p.loads.davis
    e, v = at["E"], at["v"]
    constant = -a - p.loads.slope_mps2
    terms: list[tuple[ndarray, ndarray | float]] = [
        (e[here + 1], 1 / ds + quad),
        (e[here], -1 / ds + quad),
    ]
    if p.linear_drag:
        about = np.sqrt(2 * np.maximum(energy, DRAG_LEAST_J))
        for node in (here + 1, here):
            terms.append((e[node], 0.5 * b / about[node]))
            constant = constant - 0.25 * b * about[node]
    else:
        terms += [(v[here + 1], 0.5 * b), (v[here], 0.5 * b)]
    terms += [(at["f"], -1.0), (at["b"], 1.0)]
    rows.add(terms, constant, here.size)
    nodes = _pinned_nodes(p)
    speeds = np.zeros(nodes.size)
    speeds[0], speeds[-1] = p.start_mps, p.end_mps
    rows.add([(e[nodes], 1.0)], 0.5 * speeds**2, nodes.size)
    rows.add([(v[nodes], 1.0)], speeds, nodes.size)


def _pinned_nodes(p: Programme) -> ndarray:
    """The ends and the stops: nodes whose speed is given (a cone there would have no interior)."""
    stops = p.mesh.stop[p.cap_mps[p.mesh.stop] == 0.0]
    return np.unique(np.concatenate([[0], stops, [p.mesh.length_m.size]])).astype(int)


def _effort_rows(p: Programme, rows: ConstraintRows, at: dict[str, ndarray], energy: ndarray) -> None:
    """``f <= F(E), b <= B(E), e <= R(E), e <= b`` by tangents; everything at least zero."""
    here, middle = p.loads.segment, 0.5 * (energy[1:] + energy[:-1])
    n, e = here.size, at["E"]
    efforts: list[tuple[str, Effort]] = [("f", "traction"), ("b", "braking")]
    if "e" in at:
        efforts.append(("e", "electric"))
        rows.add([(at["e"], 1.0), (at["b"], -1.0)], 0.0, n)
    for name, effort in efforts:
        value, slope = tangents(p.loads, effort, middle)
        terms = [(at[name], 1.0), (e[here + 1], -0.5 * slope), (e[here], -0.5 * slope)]
        rows.add(terms, value - slope * middle[here], n)
        rows.add([(at[name], -1.0)], 0.0, n)


def _motion_rows(p: Programme, rows: ConstraintRows, at: dict[str, ndarray]) -> None:
    """Speed limits, acceleration and deceleration limits."""
    ds, e = p.mesh.length_m, at["E"]
    n = ds.size
    inner = np.arange(1, n)
    rows.add([(e[inner], 1.0)], 0.5 * p.cap_mps[inner] ** 2, inner.size)
    if p.floor_mps is not None:
        above = inner[p.floor_mps[inner] > 0]
        rows.add([(at["v"][above], -1.0)], -p.floor_mps[above], above.size)
    if p.secant_speeds:
        free = np.setdiff1d(inner, _pinned_nodes(p))
        rows.add([(e[free], 2.0 / p.cap_mps[free]), (at["v"][free], -1.0)], 0.0, free.size)
    acceleration, deceleration = (
        lowest_service_rate(p.table, p.mesh, braking=braking) for braking in (False, True)
    )
    if np.isfinite(acceleration):
        rows.add([(e[1:], 1 / ds), (e[:-1], -1 / ds)], acceleration, n)
    if np.isfinite(deceleration):
        lifted = p.cap_mps[1:] > p.mesh.cap_mps[1:]
        rows.add([(e[1:], -1 / ds), (e[:-1], 1 / ds)], deceleration + np.where(lifted, 0.5, 0.0), n)


def _jerk_rows(p: Programme, rows: ConstraintRows, at: dict[str, ndarray], energy: ndarray) -> None:
    """Change of acceleration between neighbouring segments, and up from and down to standstill."""
    ds, e = p.mesh.length_m, at["E"]
    jerk = float(p.jerk_mps3 or 0.0)
    speed = np.sqrt(2 * np.maximum(energy, 0.0))
    time = 2 * ds / np.maximum(speed[1:] + speed[:-1], 0.05)
    room = jerk * 0.5 * (time[1:] + time[:-1])
    if p.release_mps3 is not None and p.end_mps == 0:
        room[_brake_release_rows(p)] *= p.release_mps3 / jerk
    standing = np.isin(np.arange(1, ds.size), p.mesh.stop[p.cap_mps[p.mesh.stop] == 0.0])
    here, there = np.flatnonzero(~standing), np.flatnonzero(~standing) + 1
    change = [
        (e[there + 1], 1 / ds[there]),
        (e[there], -1 / ds[there] - 1 / ds[here]),
        (e[here], 1 / ds[here]),
    ]
    rows.add(change, room[here], here.size)
    rows.add([(c, -np.asarray(w)) for c, w in change], room[here], here.size)
    rest_start = [0] if p.stands else []
    rest_end = [ds.size - 1] if p.end_mps == 0 else []
    inner = np.flatnonzero(standing)
    first = np.array([*rest_start, *(inner + 1)], dtype=int)
    last = np.array([*inner, *rest_end], dtype=int)
    soft = SOFT_START * jerk ** (2 / 3)
    let_go = np.full(last.size, soft)
    if rest_end and p.release_mps3 is not None:
        let_go[-1] = SOFT_START * p.release_mps3 ** (2 / 3)
    rows.add([(e[first + 1], 1 / ds[first])], soft * ds[first] ** (1 / 3), first.size)
    rows.add([(e[last], 1 / ds[last])], let_go * ds[last] ** (1 / 3), last.size)
    if not p.stands:
        lead = np.array([0])
        rows.add([(e[1:2], 1 / ds[:1]), (e[:1], -1 / ds[:1])], p.start_mps2 + jerk * time[lead], 1)
        rows.add([(e[1:2], -1 / ds[:1]), (e[:1], 1 / ds[:1])], -p.start_mps2 + jerk * time[lead], 1)


def _brake_release_rows(p: Programme) -> ndarray:
    """Changes of acceleration that lie where the brake is let go before the last stop."""
    rate = lowest_service_rate(p.table, p.mesh, braking=True)
    rate = min(rate, *(float(table.braking[0]) for table in p.loads.tables))
    stretch = rate**3 / (6.0 * float(p.release_mps3 or 1.0) ** 2)
    return p.mesh.node_m[1:-1] > p.mesh.node_m[-1] - stretch


def _time_rows(p: Programme, rows: ConstraintRows, at: dict[str, ndarray], energy: ndarray) -> list[int]:
    """Partial sums of time, and the range of each free dwell; returns the rows of the upper bounds."""
    clock: list[int] = []
    none = np.zeros(0, int)
    for bound in p.bounds:
        waits = at["w"][list(bound.waits)] if bound.waits else none
        part = at["t"][bound.first : bound.last]
        if bound.high_s is not None:
            late = at["late"] if bound is p.bounds[-1] and p.late_w is not None else none
            clock.append(rows.add_sum([(part, 1.0), (waits, 1.0), (late, -1.0)], bound.high_s))
        if bound.low_s is not None and p.strictly_early:
            rows.add_sum(*_not_before(p, at, energy, bound, waits))
        elif bound.low_s is not None:
            rows.add_sum([(part, -1.0), (waits, -1.0)], -bound.low_s)
    if "late" in at:
        rows.add_sum([(at["late"], -1.0)], 0.0)
    if p.dwells:
        low, high = np.array(p.dwells).T
        rows.add([(at["w"], 1.0)], high, len(p.dwells))
        rows.add([(at["w"], -1.0)], -low, len(p.dwells))
    return clock


def _not_before(
    p: Programme, at: dict[str, ndarray], energy: ndarray, bound: TimeBound, waits: ndarray
) -> tuple[list[tuple[ndarray, ndarray | float]], float]:
    """A lower bound on time by its tangent over kinetic energy.

    Time is convex in the energies, so its tangent lies below it: who keeps this row is not too early.
    """
    part = slice(bound.first, bound.last)
    speed = np.sqrt(2 * np.maximum(energy, SLOWEST_J))
    total = speed[1:] + speed[:-1]
    share = -2 * p.mesh.length_m / total**2
    slope = np.zeros(energy.size)
    slope[1:][part] += share[part] / speed[1:][part]
    slope[:-1][part] += share[part] / speed[:-1][part]
    slope[_pinned_nodes(p)] = 0.0
    seconds = float(np.sum((2 * p.mesh.length_m / total)[part]) - slope @ energy)
    nodes = np.arange(bound.first, bound.last + 1)
    return [(at["E"][nodes], -slope[nodes]), (waits, -1.0)], seconds - float(bound.low_s or 0.0)


def _cone_rows(p: Programme, rows: ConstraintRows, at: dict[str, ndarray]) -> None:
    """``v^2 <= 2 E`` at the nodes and ``t (v + v') >= 2 ds`` on the segments."""
    ds, e, v, t = p.mesh.length_m, at["E"], at["v"], at["t"]
    n = ds.size
    free = np.setdiff1d(np.arange(n + 1), _pinned_nodes(p))
    rows.add_cones([[(e[free], -1.0)], [(e[free], -1.0)], [(v[free], -1.0)]], [0.5, -0.5, 0.0], free.size)
    rows.add_cones(
        [[(t, -1.0), (v[1:], -1.0), (v[:-1], -1.0)], [(t, -1.0), (v[1:], 1.0), (v[:-1], 1.0)], []],
        [0.0, 0.0, 2 * np.sqrt(2 * ds)],
        n,
    )
