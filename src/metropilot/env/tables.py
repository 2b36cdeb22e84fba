"""Tables of a task's cases (sections with trainsets) as stacked arrays, and look-ups in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from metropilot._typing import Array, Float, Index, Scalar
from metropilot.physics import (
    Track,
    Vehicle,
    davis_n,
    effort_at,
    locate,
    mean_slopes,
    namespace,
    scalars,
    stack,
    track_arrays,
    vehicle_arrays,
)
from metropilot.planning import interpolate_time_to_go, limit_at, tabulate_time_to_go
from metropilot.protection import (
    Bounds,
    Protection,
    asks_for_less,
    guarantees_less,
    permitted_before_end,
    permitted_before_service,
    protect,
    usable_deceleration,
)
from metropilot.railway import Section, Trainset


class SectionTables(NamedTuple):
    """Every case of a task, one row each. A row that is the same in all cases is stored once.

    Attributes:
        vehicle: Trainset as the driver knows it.
        track: Section.
        protection: Its protection; the curves are in ``node_curves``.
        node_curves: At protection's nodes: its ``PROTECTION_CURVES``, and the climb from the origin (gradient
            and curves, J/kg).
        to_go: Flat-out time to the stop, see :class:`metropilot.planning.TimeToGo`.
        minimum_s: Minimum running time.
        length_m: Distance to the stop.
        load: Mass over the mean of all cases.
        stop_mps2: Surely available deceleration with which station-stop braking is planned.
        braking_curves: Braking curves at the same nodes: energy that the brakes surely dissipate from here
            to the stop, J/kg; speed from which they surely respect all permitted speeds ahead, m/s; and for
            each of ``PACES_MPS`` the time to the stop when that speed is held wherever these two curves
            admit it, s; and the time that a drive flat out loses on the way at lower limits, s.
    """

    vehicle: Vehicle
    track: Track
    protection: Protection
    node_curves: Float[Array, "cases nodes 6"]
    to_go: Float[Array, "cases distances speeds"]
    minimum_s: Float[Array, " cases"]
    length_m: Float[Array, " cases"]
    load: Float[Array, " cases"]
    stop_mps2: Float[Array, " cases"]
    braking_curves: Float[Array, "cases nodes curves"]


PARTS = 8
"""Places between two nodes at which gradient and curves are read for their mean."""
STOP_STRETCH_M = 300.0
STOP_USE = 0.95
STOP_PASSES = 4
LEAST_STOP_MPS2 = 0.03
"""Least deceleration that a stop is planned with."""
FADE_MPS, FADE_STEP_MPS = 1.5, 0.5
"""Range of speed over which a brake that fades is taken at its weakest, and step of its table."""
LEAST_DRIVEN = 0.5
"""Least speed that errors of measurement leave, as a share of the permitted one."""
SURE_RESISTANCE = 0.8
"""Share of the running resistance that the plan of a late stop includes."""
PACES_MPS = (3.0, 5.0, 7.0, 9.0, 11.0, 13.0, 15.0, 17.0, 19.5, 22.5, 26.5, 32.0)
"""Speeds for which the time to go is tabulated."""
SLOWEST_MPS = 0.3
"""Least sum of the speeds at two nodes that a tabled time counts with."""
LOST_MPS, LOST_SHARE = 0.16, 2.0
"""Speed that a drive flat out stays below the limits, and delays by which it brakes early for a lower one."""
PROTECTION_CURVES = ("emergency", "service", "permitted_mps", "pull_mps2", "usual_pull_mps2")
"""Protection's curves in ``SectionTables.node_curves``, in this order; the climb comes last."""
PERMITTED_COLUMN, CLIMB_COLUMN = 2, 5


def build_tables(
    cases: Sequence[tuple[Section, Trainset, Bounds]],
    spacing_m: float,
    dtype: type = np.float32,
    jobs: int = 1,
    *,
    fading: bool = False,
    steady: bool = False,
) -> SectionTables:
    """Build the tables of the cases (NumPy).

    Args:
        cases: Sections, each with a trainset and its load, and the bounds declared to protection.
        spacing_m: Distance between protection's nodes.
        dtype: Number type.
        jobs: Number of processes; 0: one a core.
        fading: See :attr:`metropilot.env.AbstractAction.fading`.
        steady: The last braking is at one deceleration, which the brakes can sustain from everywhere on its
            way, not as late as they allow.
    """
    masses = [trainset.mass_kg for _, trainset, _ in cases]
    rows = _rows(cases, jobs, partial(_case, spacing_m=spacing_m, fading=fading, steady=steady))
    vehicles, tracks, protections, node_curves, tables, least, lengths, stops, braking = zip(
        *rows, strict=True
    )
    nodes = max(node_curves.shape[0] for node_curves in node_curves)
    ahead = np.arange(max(_look_ahead(protection) for protection in protections), dtype=np.int32)
    small = [p._replace(**dict.fromkeys(PROTECTION_CURVES, 0.0)) for p in protections]
    stacked = _stack_protection(small, ahead)
    whole = SectionTables(
        vehicle=stack(vehicles),
        track=stack(tracks),
        protection=stacked,
        node_curves=np.stack([_pad(node_curves, nodes + ahead.size + 2) for node_curves in node_curves]),
        to_go=np.stack([np.pad(t, ((0, 0), (0, _widest(tables) - t.shape[1])), mode="edge") for t in tables]),
        minimum_s=np.array(least),
        length_m=np.array(lengths),
        load=np.array(masses) / np.mean(masses),
        stop_mps2=np.array(stops),
        braking_curves=np.stack([np.pad(b, ((0, nodes + ahead.size + 2 - len(b)), (0, 0))) for b in braking]),
    )
    return _map_tree(lambda a: a if a.dtype.kind in "iub" else a.astype(dtype), whole)


def _rows(
    cases: Sequence[tuple[Section, Trainset, Bounds]], jobs: int, build: Callable[..., tuple[Any, ...]]
) -> list[Any]:
    """Rows of the cases, computed in several processes for thousands of cases."""
    if jobs == 1:
        return [build(*case) for case in cases]
    from joblib import Parallel, cpu_count, delayed

    pool = Parallel(n_jobs=jobs or cpu_count())
    return list(pool(delayed(build)(*case) for case in cases))


def _case(
    section: Section, trainset: Trainset, bounds: Bounds, *, spacing_m: float, fading: bool, steady: bool
) -> tuple[Any, ...]:
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    most = usable_deceleration(section, trainset, bounds)
    vehicle = vehicle._replace(max_deceleration_mps2=np.float64(most))
    protection = protect(section, trainset, bounds, spacing_m=spacing_m)
    used = int(np.flatnonzero(protection.permitted_mps)[-1]) + 2
    at = protection.start_m + spacing_m * np.arange(used)
    if guarantees_less(trainset, bounds):
        # who follows the permitted speed of such a trainset would meet the other two curves
        permitted = protection.permitted_mps.copy()
        for most_mps in (permitted_before_service, permitted_before_end):
            permitted[:used] = np.minimum(permitted[:used], most_mps(protection, track, at))
        protection = protection._replace(permitted_mps=permitted)
    permitted = protection.permitted_mps[:used]
    if fading and asks_for_less(trainset):
        # the brake at low speed is stronger than the service brake that protection reckons with
        permitted = np.minimum(permitted, permitted_before_service(protection, track, at))
    uphill = _mean_uphill(vehicle, track, at)
    climb = _integral(uphill, at) * float(vehicle.effective_mass_kg) / float(vehicle.mass_kg)
    node_curves = np.stack([*(getattr(protection, name)[:used] for name in PROTECTION_CURVES), climb], axis=1)
    driven_track = _driven_track(track, bounds)
    table = tabulate_time_to_go(vehicle, driven_track).time_s
    minimum_s = table[-1, 0] if driven_track is track else tabulate_time_to_go(vehicle, track).time_s[-1, 0]
    # a change of gradient comes to a point mass at once, but in the simulation at the next period
    felt_s = bounds.dt_s if fading and vehicle.length_m <= 0.0 else 0.0
    work = _stop_work(vehicle, track, at, uphill, section.length_m, felt_s)
    if steady:
        work = _sustained_work(at, work, section.length_m)
    follow = _follow_mps(vehicle, at, uphill, permitted, fading=fading)
    free = _follow_mps(vehicle, at, uphill, limit_at(track, at), fading=fading)
    stop = _stop_speed(work)
    driven = np.maximum(follow - bounds.speed_error_mps, LEAST_DRIVEN * follow)
    braking_curves = np.stack(
        [
            work,
            follow,
            *_pace_times(at, np.minimum(driven, stop), section.length_m),
            _lost_s(at, follow, np.minimum(free, stop), section.length_m, bounds),
        ],
        axis=1,
    )
    stop_mps2 = _stop_mps2(vehicle, track)
    lengths = minimum_s, section.length_m
    return vehicle, track, protection, node_curves, table, *lengths, stop_mps2, braking_curves


def _mean_uphill(
    vehicle: Vehicle, track: Track, at: np.ndarray, felt_m: np.ndarray | float = 0.0
) -> np.ndarray:
    """Mean of what gradient and curves take from each node to the next, m/s^2. Shape (N - 1,).

    A point mass feels a change of gradient at once, wherever between two nodes it lies.

    Args:
        vehicle: Trainset.
        track: Section.
        at: Nodes, m.
        felt_m: Ways over which the gradient before may still be felt, where it helps less. Shape (N - 1,).
    """

    def uphill(positions_m: np.ndarray) -> np.ndarray:
        gradient, curve, _ = mean_slopes(vehicle, track, positions_m)
        return vehicle.gravity_mps2 * gradient + curve

    inside = at[:-1, None] + np.diff(at)[:, None] * (np.arange(PARTS) + 0.5) / PARTS
    taken = uphill(inside)
    if np.any(felt_m):
        taken = np.minimum(taken, uphill(inside - np.reshape(felt_m, (-1, 1))))
    return taken.mean(axis=1) * float(vehicle.mass_kg) / float(vehicle.effective_mass_kg)


def _integral(means: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Integral to each node of what has these means between them. Shape (N,)."""
    return np.concatenate([[0.0], np.cumsum(means * np.diff(at))])


def _driven_track(track: Track, bounds: Bounds) -> Track:
    """The track with the limits that can be driven where the speed is measured with an error.

    Protection permits less by the largest error, and a measurement may be too high by as much again.
    """
    if bounds.speed_error_mps <= 0.0:
        return track
    most = track.limit_mps
    return track._replace(limit_mps=np.maximum(most - 2.0 * bounds.speed_error_mps, LEAST_DRIVEN * most))


def _follow_mps(
    vehicle: Vehicle, at: np.ndarray, pull: np.ndarray, permitted: np.ndarray, *, fading: bool
) -> np.ndarray:
    """Highest speed at each node from which the service brake keeps under the permitted speed. Shape (N,).

    A brake that fades counts at its weakest, or (``fading``) with what it gives up to ``FADE_MPS`` above the
    speed at the next node.
    """
    speeds = np.arange(0.0, float(vehicle.max_speed_mps) + FADE_MPS + FADE_STEP_MPS, FADE_STEP_MPS)
    brake = effort_at(vehicle, np.minimum(speeds, float(vehicle.max_speed_mps))).brake_n
    sure = sliding_window_view(brake / float(vehicle.effective_mass_kg), int(FADE_MPS / FADE_STEP_MPS) + 1)
    least = np.full(sure.shape[0], _sure_brake(vehicle))
    sure, last = (sure.min(axis=1) if fading else least).tolist(), sure.shape[0] - 1
    most = float(vehicle.max_deceleration_mps2)
    energy, pull, way = (
        (0.5 * permitted.astype(np.float64) ** 2).tolist(),
        pull.tolist(),
        np.diff(at).tolist(),
    )
    for k in range(at.size - 2, -1, -1):
        node = min(int(math.sqrt(2.0 * energy[k + 1]) / FADE_STEP_MPS), last)
        able = STOP_USE * min(max(sure[node] + pull[k], LEAST_STOP_MPS2), most)
        energy[k] = min(energy[k], energy[k + 1] + able * way[k])
    return np.sqrt(2.0 * np.array(energy))


def _stop_work(
    vehicle: Vehicle, track: Track, at: np.ndarray, uphill: np.ndarray, length_m: float, felt_s: float
) -> np.ndarray:
    """Energy that brakes and resistance surely dissipate between each node and the stop, J/kg. Shape (N,).

    The braking effort depends on the speed of the braking curve, and that on the effort: a fixed point.

    Args:
        vehicle: Trainset.
        track: Section.
        at: Nodes, m.
        uphill: Mean of what gradient and curves take from each node to the next, m/s^2. Shape (N - 1,).
        length_m: Distance to the stop.
        felt_s: Time for which the gradient before may still be felt.
    """
    mass, ends = float(vehicle.effective_mass_kg), float(vehicle.max_deceleration_mps2)

    def dissipated_work(sure: np.ndarray) -> np.ndarray:
        able = np.clip(0.5 * (sure[1:] + sure[:-1]) + uphill, LEAST_STOP_MPS2, ends)
        work = _integral(able, at)
        return np.interp(length_m, at, work) - work

    work = dissipated_work(np.full(at.size, _sure_brake(vehicle)))
    for _ in range(STOP_PASSES):
        speed = np.minimum(_stop_speed(work), float(vehicle.max_speed_mps))
        if felt_s > 0.0:
            uphill = _mean_uphill(vehicle, track, at, felt_s * speed[:-1])
        sure = effort_at(vehicle, speed).brake_n + SURE_RESISTANCE * davis_n(vehicle, speed)
        work = dissipated_work(sure / mass)
    return work


def _sustained_work(at: np.ndarray, work: np.ndarray, length_m: float) -> np.ndarray:
    """Work of one deceleration to the stop that the brakes sustain from everywhere on the way. Shape (N,)."""
    found, before = work.copy(), at < length_m
    left = length_m - at[before]
    found[before] = left * np.minimum.accumulate((work[before] / left)[::-1])[::-1]
    return found


def _stop_speed(work: np.ndarray) -> np.ndarray:
    """Speed from which station-stop braking stops, m/s; 0 beyond the stop."""
    return np.sqrt(2.0 * np.maximum(work, 0.0))


def _pace_times(at: np.ndarray, most_mps: np.ndarray, length_m: float) -> list[np.ndarray]:
    """Time to the stop from each node at each of ``PACES_MPS``, or at the highest possible lower speed, s."""
    found = []
    for pace in PACES_MPS:
        speed = np.minimum(pace, most_mps)
        taken = 2.0 * np.diff(at) / np.maximum(speed[1:] + speed[:-1], SLOWEST_MPS)
        passed = np.concatenate([[0.0], np.cumsum(taken)])
        found.append(np.interp(length_m, at, passed) - passed)
    return found


def _lost_s(
    at: np.ndarray, follow: np.ndarray, free: np.ndarray, length_m: float, bounds: Bounds
) -> np.ndarray:
    """Time that a drive flat out loses between each node and the stop beyond the least, s. Shape (N,).

    It stays below each limit, and begins to brake for a lower one earlier by some control periods and by
    what a command is late. Fitted to 112 drives on random sections, see ``docs/decisions/0024``. Where
    protection permits much less than the limits, that counts instead.

    Args:
        at: Nodes, m.
        follow: Highest speeds under the permitted one, m/s. Shape (N,).
        free: Highest speeds under the limits and with the stop, m/s. Shape (N,).
        length_m: Distance to the stop.
        bounds: Bounds declared to protection.
    """
    slower = np.maximum(0.5 * (follow[1:] + follow[:-1]), SLOWEST_MPS)
    falls = np.maximum(follow[:-1] - follow[1:], 0.0) / np.maximum(follow[1:], SLOWEST_MPS)
    late_s = bounds.dt_s + bounds.delay_s + bounds.lag_s
    lost = LOST_MPS * np.diff(at) / (slower * slower) + LOST_SHARE * late_s * falls
    quicker = np.maximum(0.5 * (free[1:] + free[:-1]), SLOWEST_MPS)
    lost = np.maximum(lost, np.diff(at) * (1.0 / np.minimum(slower, quicker) - 1.0 / quicker))
    passed = np.concatenate([[0.0], np.cumsum(lost)])
    return np.maximum(np.interp(length_m, at, passed) - passed, 0.0)


def _sure_brake(vehicle: Vehicle) -> float:
    """Deceleration of the service brake at the speed where it is weakest, on the level."""
    speeds = np.linspace(0.0, float(vehicle.max_speed_mps), 32)
    return float(np.min(effort_at(vehicle, speeds).brake_n)) / float(vehicle.effective_mass_kg)


def _stop_mps2(vehicle: Vehicle, track: Track) -> float:
    """Surely available deceleration over the last stretch at any speed, at most the service limit, m/s^2."""
    at = float(track.length_m) - np.linspace(0.0, STOP_STRETCH_M, 41)
    gradient, curve, _ = mean_slopes(vehicle, track, at)
    pull = (vehicle.gravity_mps2 * gradient + curve) * vehicle.mass_kg / vehicle.effective_mass_kg
    means = np.cumsum(pull) / np.arange(1, at.size + 1)
    sure = min(_sure_brake(vehicle) + float(means[5:].min()), float(vehicle.max_deceleration_mps2))
    return max(STOP_USE * sure, LEAST_STOP_MPS2)


def _look_ahead(protection: Protection) -> int:
    """Nodes ahead that protection can need at the highest speed; with fewer it is only stricter."""
    vehicle, most = protection.vehicle, 0.0
    top = float(protection.permitted_mps.max()) + 1.0
    push = float(np.max(effort_at(vehicle, np.linspace(0.0, top, 64)).traction_n)) / vehicle.effective_mass_kg
    for rates in (protection.rates, protection.service_rates):
        gain = push / rates.mass_low + float(protection.pull_mps2.max())
        peak = top + gain * rates.reaction_s + 0.5 * gain**2 / rates.jerk_mps3
        most = max(most, peak * (rates.reaction_s + (gain + rates.brake_mps2) / rates.jerk_mps3))
    return min(int(np.ceil(most / float(protection.spacing_m))) + 2, protection.ahead.size)


def _widest(tables: Sequence[np.ndarray]) -> int:
    return max(table.shape[1] for table in tables)


def _pad(node_curves: np.ndarray, size: int) -> np.ndarray:
    """Beyond the map nothing may move: zero curves, the rest as at its end."""
    extra = np.repeat(node_curves[-1:], size - node_curves.shape[0], axis=0)
    extra[:, : PERMITTED_COLUMN + 1] = 0.0
    return np.concatenate([node_curves, extra])


def _stack_protection(protections: Sequence[Protection], ahead: np.ndarray) -> Protection:
    """Stack the scalars of protection; look-ahead and slots are shapes, common to all."""
    slots = max((p.slots for p in protections), key=len)
    plain = [p._replace(ahead=np.int32(0), slots=0.0) for p in protections]

    def column(*values: Any) -> Any:  # noqa: ANN401 (numbers or tuples of them)
        if isinstance(values[0], tuple):
            return type(values[0])(*(column(*entries) for entries in zip(*values, strict=True)))
        return np.stack([np.asarray(value) for value in values])

    vehicle = stack([p.vehicle for p in protections])
    stacked = column(*(p._replace(vehicle=()) for p in plain))
    repeat = len(protections)
    return stacked._replace(
        vehicle=vehicle,
        ahead=np.repeat(ahead[None].astype(np.int32), repeat, axis=0),
        slots=np.repeat(np.asarray(slots)[None], repeat, axis=0),
    )


def _map_tree(function: Any, tree: Any, *, traced: bool = False) -> Any:  # noqa: ANN401 (a tree of tuples)
    if isinstance(tree, tuple):
        values = [_map_tree(function, entry, traced=traced) for entry in tree]
        return type(tree)(*values) if hasattr(tree, "_fields") else tuple(values)
    return function(tree if traced else np.asarray(tree))


class SectionRows:
    """Look-ups in the tables; values common to all cases are constants.

    Args:
        tables: Tables from :func:`build_tables`.
        jax: Store them as JAX arrays.
        spacing_m: Distance between protection's nodes, if the tables are an argument of a compiled function:
            then no value is a constant, and tables of the same shapes reuse the program.
    """

    def __init__(self, tables: SectionTables, *, jax: bool, spacing_m: float | None = None) -> None:
        if jax:
            import jax.numpy as xp
        else:
            xp = np
        traced = spacing_m is not None
        self.count = int(tables.minimum_s.shape[0])
        self.xp = xp
        self.spacing_m = float(tables.protection.spacing_m[0]) if spacing_m is None else spacing_m
        self.start_m = xp.asarray(tables.protection.start_m)
        self.ahead = tables.protection.ahead[0]
        self.slots = int(tables.protection.slots.shape[1])
        self.node_curves = xp.asarray(tables.node_curves)
        self.to_go = xp.asarray(tables.to_go)
        self.braking_curves = xp.asarray(tables.braking_curves)
        self.length_m = xp.asarray(tables.length_m)
        self.tables = tables
        none = np.zeros(self.count)
        small = tables._replace(node_curves=none, to_go=none, braking_curves=none)
        if xp is np:
            count = self.node_curves.shape[1]
            self._nodes_m = self.start_m[:, None] + self.spacing_m * np.arange(count)
            self._columns = np.ascontiguousarray(self.node_curves.transpose(0, 2, 1))
            self._braking = np.ascontiguousarray(self.braking_curves[..., :2].transpose(0, 2, 1))
        self._shared = _map_tree(lambda a: not traced and bool((a == a[:1]).all()), small, traced=traced)
        if traced:
            self._small = _map_tree(xp.asarray, small, traced=True)
        else:
            # single numbers as such on the host: arithmetic on arrays without dimensions is ten times as slow
            number = (lambda a: a.item() if a.ndim == 0 else a) if xp is np else xp.asarray
            self._small = _map_tree(lambda a: number(np.asarray(a[0] if (a == a[:1]).all() else a)), small)

    def case(self, case: Index) -> SectionTables:
        """The row of a case, without the large tables and with the whole track."""
        return _pick(self._small, self._shared, case)

    def namespace(self, position_m: Scalar) -> Any:  # noqa: ANN401 (a module)
        """Array namespace for states: JAX's, or NumPy for many positions and ``scalars`` for one."""
        return scalars if self.xp is np and namespace(position_m) is scalars else self.xp

    def node(self, case: Index, position_m: Scalar) -> tuple[Scalar, Scalar]:
        """Last node not beyond a position, and the fraction of the distance to the next."""
        xp = self.xp
        last = self.node_curves.shape[1] - self.ahead.size - 2.0
        steps = (position_m - self.start_m[case]) / self.spacing_m
        if type(steps) in {float, np.float64}:
            node = int(min(max(steps, 0.0), last))
            return node, min(max(steps - node, 0.0), 1.0)
        whole = xp.minimum(xp.maximum(xp.floor(steps), 0.0), last)
        return whole.astype(np.int32), xp.minimum(xp.maximum(steps - whole, 0.0), 1.0)

    def curve_at(self, column: int, case: Index, position_m: Scalar) -> Scalar:
        """Value of a column of ``node_curves`` at one or many positions, interpolated."""
        if self.xp is np and namespace(position_m) is np and np.ndim(case) == 0:
            curve = self._columns[case, column, : self.node_curves.shape[1] - self.ahead.size]
            return np.interp(position_m, self._nodes_m[case, : curve.size], curve)
        node, way = self.node(case, position_m)
        here = self.node_curves[case, node, column]
        return here + (self.node_curves[case, node + 1, column] - here) * way

    def stop_at(self, case: Index, position_m: Scalar) -> tuple[Scalar, Scalar]:
        """Energy that the brakes surely dissipate to the stop, J/kg, and its rate here, m/s^2."""
        node, way = self.node(case, position_m)
        here, after = self.braking_curves[case, node, 0], self.braking_curves[case, node + 1, 0]
        return here + (after - here) * way, (here - after) / self.spacing_m

    def stop_work_at(self, case: Index, position_m: Scalar) -> Scalar:
        """Energy that the brakes surely dissipate to the stop from one or many positions, J/kg."""
        return self._braking_at(0, case, position_m)

    def follow_at(self, case: Index, position_m: Scalar) -> Scalar:
        """Speed from which the brakes surely respect all permitted speeds ahead; at one or many places."""
        return self._braking_at(1, case, position_m)

    def _braking_at(self, column: int, case: Index, position_m: Scalar) -> Scalar:
        """Value of a column of ``braking_curves`` at one or many positions, interpolated."""
        if self.xp is np and namespace(position_m) is np and np.ndim(case) == 0:
            curve = self._braking[case, column]
            return np.interp(position_m, self._nodes_m[case, : curve.size], curve)
        node, way = self.node(case, position_m)
        here, after = self.braking_curves[case, node, column], self.braking_curves[case, node + 1, column]
        return here + (after - here) * way

    def pace_times_s(self, case: Index, position_m: Scalar) -> Float[Array, "... paces"]:
        """Time to the stop at each of ``PACES_MPS``, or slower where limits and braking require it, s.

        Shape (..., paces).
        """
        node, way = self.node(case, position_m)
        here, after = self.braking_curves[case, node, 2:-1], self.braking_curves[case, node + 1, 2:-1]
        return here + (after - here) * (way[..., None] if np.ndim(way) or self.xp is not np else way)

    def lost_s(self, case: Index, position_m: Scalar) -> Scalar:
        """Time that a drive flat out loses at the limits ahead, beyond :meth:`to_go_s`, s."""
        node, way = self.node(case, position_m)
        here, after = self.braking_curves[case, node, -1], self.braking_curves[case, node + 1, -1]
        return here + (after - here) * way

    def to_go_s(self, case: Index, distance_m: Scalar, length_m: Scalar, speed_mps: Scalar) -> Scalar:
        """Flat-out time to the stop, s."""
        share = distance_m / length_m
        return interpolate_time_to_go(
            lambda row, column: self.to_go[case, row, column], self.to_go.shape[1:], share, speed_mps
        )


def _pick(tree: Any, shared: Any, case: Index) -> Any:  # noqa: ANN401 (a tree of tuples)
    if isinstance(tree, tuple):
        return type(tree)(*(_pick(a, b, case) for a, b in zip(tree, shared, strict=True)))
    return tree if shared else tree[case]


def near_track(track: Track, vehicle: Vehicle, position_m: Scalar) -> Track:
    """Pieces of a track under head and tail: all that the plant needs at this position.

    Look-ups give the same numbers as on the whole track, which a compiled step need not hold.
    """
    xp = namespace(track.node_m, position_m)
    tail, head = locate(track.node_m, position_m - vehicle.length_m), locate(track.node_m, position_m)
    both = xp.stack([tail, head])
    return track._replace(node_m=track.node_m[both], potential=track.potential[both], slope=track.slope[both])


def near_protection(rows: SectionRows, protection: Protection, case: Index, position_m: Scalar) -> Protection:
    """Window of protection's curves that one decision at a position needs, from the node before it."""
    xp = rows.xp
    node, _ = rows.node(case, position_m)
    count = rows.ahead.size + 2
    window = rows.node_curves[case, node + xp.arange(count)]
    return protection._replace(
        start_m=protection.start_m + node.astype(window.dtype) * rows.spacing_m,
        **{name: window[:, column] for column, name in enumerate(PROTECTION_CURVES)},
        ahead=xp.asarray(rows.ahead),
        slots=xp.zeros(rows.slots, window.dtype),
    )
