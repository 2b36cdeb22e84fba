"""Protection of a section: emergency, service and permitted curve on a uniform grid (NumPy)."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray
from numpy.lib.stride_tricks import sliding_window_view

from metropilot._typing import Float
from metropilot.errors import InputError
from metropilot.physics import (
    BrakingBands,
    Vehicle,
    braking_bands,
    davis_n,
    delay_steps,
    effort_at,
    mean_slopes,
    padded_size,
    restrictive_profile,
    track_arrays,
    vehicle_arrays,
)
from metropilot.protection.bounds import Bounds
from metropilot.protection.predict import SLACK_MPS, highest_speed
from metropilot.protection.types import Fading, Protection, Rates
from metropilot.railway import Section, Trainset

NODES = (1024, 2048, 4096, 8192, 16384, 32768, 65536, 131072)
AHEAD = (16, 32, 64, 128, 256, 512)
AT_ONCE_MPS3 = 1e4
"""An immediate build-up, as a number that can be divided by."""
SERVICE_OVER_MPS2 = 0.4
"""The service brake comes in this much over the permitted speed for every second of the emergency brake's
reaction: less than the braking in flight gains on the emergency curve, so that it spares that brake."""
SERVICE_LATE_MPS2 = 0.1
"""And this much for every second of delay and lag, in which a driver's effort trails a changing gradient."""
_RECENT: deque[tuple[Any, ...]] = deque(maxlen=4)
"""Last requests with their answers: a driver asks for what its host has just asked for."""
LEAST_HOLD_MPS2 = 0.1
"""Least deceleration assumed beyond the end of the authority, where a gradient may take all of the brake."""
MOST_NODES = 130_000
BEFORE_M = 50.0
AFTER_M = 500.0


def protect(
    section: Section,
    trainset: Trainset,
    bounds: Bounds,
    *,
    stop_at_m: float | None = None,
    dtype: type = np.float64,
    spacing_m: float = 1.0,
    before_m: float = BEFORE_M,
) -> Protection:
    """Protection of one section for one trainset: NumPy arrays, to be moved to JAX with ``physics.to_jax``.

    Sections share one compiled program: the grid is padded to a few sizes, and its look-ahead depends on the
    bounds and the trainset only.

    Args:
        section: Section with every restriction in force.
        trainset: Nominal trainset.
        bounds: Declared bounds of the plant.
        stop_at_m: Another end of the movement authority than the section's, without a release speed: the
            limit is 0 from there on.
        dtype: Number type.
        spacing_m: Distance between nodes.
        before_m: Distance before the origin at which the map begins.

    Raises:
        InputError: The section is too long for the grid.
    """
    more = (bounds, stop_at_m, dtype, spacing_m, before_m)
    for known_section, known_trainset, known, answer in tuple(_RECENT):
        if known_section is section and known_trainset is trainset and known == more:
            return answer
    answer = _protect(section, trainset, *more)
    _RECENT.append((section, trainset, more, answer))
    return answer


def _protect(
    section: Section,
    trainset: Trainset,
    bounds: Bounds,
    stop_at_m: float | None,
    dtype: type,
    spacing_m: float,
    before_m: float,
) -> Protection:
    """:func:`protect`, computed."""
    vehicle = vehicle_arrays(trainset)
    rates, usual = _rates(bounds), _service_rates(trainset, bounds)
    field = track_grid(section, trainset, stop_at_m, spacing_m, bounds.resistance[0], before_m)
    end = _authority_end(section, field, rates) if stop_at_m is None else AuthorityEnd(stop_at_m)
    if bounds.controlled:
        field = field._replace(pull_mps2=np.maximum(field.pull_mps2, 0.0))
    top, steepest = float(field.ceiling_mps.max()), float(field.pull_mps2.max())
    reach, usual_reach = (_look_ahead(vehicle, each, top, steepest, spacing_m) for each in (rates, usual))
    ahead = padded_size(max(reach, usual_reach), AHEAD)
    before = int(np.ceil(_memory_m(bounds, top, field.pull_mps2) / spacing_m))
    pull = sliding_max(field.pull_mps2, before, reach)
    usual_pull = sliding_max(field.usual_pull_mps2, 0, int(np.ceil(top * usual.reaction_s / spacing_m)))
    rounding = 16.0 * float(np.finfo(dtype).eps) * (np.abs(field.node_m[[0, -1]]).sum() + 0.5 * top * top)

    def emergency_curve(field: TrackGrid, rate_mps2: float) -> ndarray:
        return np.maximum(_emergency_curve(field, bounds, rate_mps2, before) - rounding, 0.0)

    emergency = emergency_curve(field, bounds.emergency_mps2)
    permitted = _permitted_curve(field, vehicle, rates, bounds, emergency, pull, ahead)
    service = _service_curve(field, vehicle, _service_brake(trainset), permitted, _over(rates, bounds))
    # Permitted speed and service curve are those of the line: drivers brake to the stop by laws of their own,
    # with all that the service brake has. Only the emergency brake guards the end beyond the stop.
    most = np.where(field.node_m > end.position_m, end.release_mps, np.inf)
    most = np.where(field.node_m > end.last_m, 0.0, most)
    released = field._replace(ceiling_mps=np.minimum(field.ceiling_mps, most[1:]))
    # A trainset may be guaranteed a weaker emergency brake than the service brake it stops with.
    able = float(effort_at(vehicle, np.linspace(0.0, top, 64)).brake_n.max() / vehicle.effective_mass_kg)
    emergency = np.minimum(emergency, emergency_curve(released, max(bounds.emergency_mps2, able)))
    size = padded_size(permitted.size + ahead + 2, NODES)
    arrays = {
        "authority_m": end.position_m,
        "start_m": field.node_m[0],
        "spacing_m": spacing_m,
        "emergency": _pad(emergency, size, 0.0),
        "service": _pad(service, size, 0.0),
        "pull_mps2": _pad(pull, size, pull[-1]),
        "usual_pull_mps2": _pad(usual_pull, size, usual_pull[-1]),
        "permitted_mps": _pad(permitted, size, 0.0),
        "slots": np.zeros(delay_steps(bounds.delay_s, bounds.dt_s) + 1),
    }
    return Protection(
        vehicle=vehicle_arrays(trainset, dtype),
        rates=Rates(*(dtype(value) for value in rates)),
        service_rates=Rates(*(dtype(value) for value in usual)),
        fading=_fading(bounds, dtype),
        ahead=np.arange(ahead, dtype=np.int32),
        **{key: np.asarray(value, dtype)[()] for key, value in arrays.items()},
    )


class AuthorityEnd(NamedTuple):
    """End of the movement authority on a section.

    Attributes:
        position_m: Position of the end; infinite: none.
        release_mps: Highest speed from there on; infinite: the line's.
        last_m: Node at or beyond the position where the emergency brake, applied at the end at the release
            speed, has stopped any plant within the bounds; the speed limit is 0 from there on.
    """

    position_m: float = np.inf
    release_mps: float = np.inf
    last_m: float = np.inf


def _authority_end(section: Section, field: TrackGrid, rates: Rates) -> AuthorityEnd:
    if section.authority is None:
        return AuthorityEnd()
    end, release = section.length_m + section.authority.distance_m, section.authority.release_mps
    behind = field.pull_mps2[field.node_m[1:] > end]
    pull = max(float(behind.max()), 0.0) if behind.size else 0.0
    # Near the release speed traction is cut before the end, so that only a gradient adds to the speed.
    speed = release + pull * float(rates.reaction_s) + float(rates.speed_error_mps)
    late_s = float(rates.reaction_s) + float(rates.brake_mps2) / float(rates.jerk_mps3)
    rate = max(float(rates.brake_mps2) - pull, LEAST_HOLD_MPS2)
    last = np.searchsorted(field.node_m, end + speed * late_s + speed * speed / (2.0 * rate))
    return AuthorityEnd(end, release, float(field.node_m[min(int(last), field.node_m.size - 1)]))


def _rates(bounds: Bounds) -> Rates:
    return Rates(
        reaction_s=bounds.reaction_s,
        brake_mps2=bounds.emergency_mps2,
        jerk_mps3=min(bounds.emergency_jerk_mps3, AT_ONCE_MPS3),
        mass_low=bounds.mass[0],
        mass_high=bounds.mass[1],
        resistance_low=bounds.resistance[0],
        service_share=bounds.service_share,
        speed_error_mps=bounds.speed_error_mps,
    )


def _service_rates(trainset: Trainset, bounds: Bounds) -> Rates:
    """The nominal service brake, late by the longest dead time and lag; the guarantee does not rest on it."""
    return Rates(
        reaction_s=bounds.dt_s + bounds.delay_s + bounds.lag_s,
        brake_mps2=min(_service_brake(trainset).rates_mps2),
        jerk_mps3=min(bounds.jerk_mps3, AT_ONCE_MPS3),
        mass_low=1.0,
        mass_high=1.0,
        resistance_low=1.0,
        service_share=1.0,
        speed_error_mps=0.0,
    )


def _fading(bounds: Bounds, dtype: type) -> Fading:
    keep = float(np.exp(-bounds.dt_s / bounds.lag_s)) if bounds.lag_s > 0 else 0.0
    return Fading(dtype(keep), dtype(bounds.jerk_mps3 * bounds.dt_s), dtype(bounds.controlled))


def _look_ahead(vehicle: Vehicle, rates: Rates, top_mps: float, pull_mps2: float, spacing_m: float) -> int:
    """Nodes that the prediction can reach at the highest speed under full traction on the steepest fall."""
    speeds = np.linspace(0.0, top_mps + SLACK_MPS, 64)
    push = max(float(np.max(effort_at(vehicle, speeds).traction_n)), 0.0)
    gain = max(push / (rates.mass_low * vehicle.effective_mass_kg) + pull_mps2, 0.0)
    jerk = rates.jerk_mps3
    peak = top_mps + SLACK_MPS + gain * rates.reaction_s + 0.5 * gain**2 / jerk
    built = max(gain + rates.brake_mps2, 0.0) / jerk
    return int(np.ceil(peak * (rates.reaction_s + built) / spacing_m)) + 3


def _memory_m(bounds: Bounds, top_mps: float, pull_mps2: ndarray) -> float:
    """Distance behind at which a gradient still counts: forces are held over a period, brakes have a jerk."""
    change = float(pull_mps2.max() - pull_mps2.min())
    lasting = bounds.dt_s + change / min(bounds.emergency_jerk_mps3, AT_ONCE_MPS3)
    return top_mps * lasting + bounds.position_error_m


def _over(rates: Rates, bounds: Bounds) -> float:
    """Excess over the permitted speed at which the service brake comes in, m/s."""
    late = SERVICE_LATE_MPS2 * (bounds.delay_s + bounds.lag_s)
    return SERVICE_OVER_MPS2 * float(rates.reaction_s) + late + bounds.speed_error_mps


def _emergency_curve(field: TrackGrid, bounds: Bounds, rate_mps2: float, before: int) -> ndarray:
    """Backward from the limits with a braking rate on the worst gradient; the map's end is a stop."""
    spacing = field.node_m[1] - field.node_m[0]
    rate = rate_mps2 - sliding_max(field.pull_mps2, before, 1)[:-1]
    ceiling = field.ceiling_mps
    limit = 0.5 * np.minimum(np.append(ceiling[0], ceiling), np.append(ceiling, 0.0)) ** 2
    curve = np.zeros_like(limit)
    for i in range(limit.size - 2, -1, -1):
        curve[i] = max(min(limit[i], curve[i + 1] + spacing * rate[i]), 0.0)
    if bounds.position_error_m > 0:
        reach = int(np.ceil(bounds.position_error_m / spacing)) + 1
        curve = -sliding_max(-curve, reach, reach + 1)[: curve.size]
    return curve


def _service_brake(trainset: Trainset) -> BrakingBands:
    """The nominal service brake over speed, at most what protection asks for."""
    bands, most = braking_bands(vehicle_arrays(trainset)), trainset.safe_braking.service_deceleration_mps2
    return bands._replace(rates_mps2=[min(rate, most) for rate in bands.rates_mps2])


def _service_curve(
    field: TrackGrid,
    vehicle: Vehicle,
    brake: BrakingBands,
    permitted: ndarray,
    over_mps: float,
) -> ndarray:
    """Backward from a little over the permitted speed with the nominal service brake and resistance."""
    spacing = field.node_m[1] - field.node_m[0]
    curve = 0.5 * np.where(permitted > 0, permitted + over_mps, 0.0) ** 2
    a, b, c = (float(x) / float(vehicle.effective_mass_kg) for x in vehicle.davis_n)
    for i in range(curve.size - 2, -1, -1):
        v = (2.0 * curve[i + 1]) ** 0.5
        rate = brake.at(v) - field.usual_pull_mps2[i] + a + v * (b + v * c)
        curve[i] = max(min(curve[i], curve[i + 1] + spacing * rate), 0.0)
    return curve


def _permitted_curve(
    field: TrackGrid,
    vehicle: Vehicle,
    rates: Rates,
    bounds: Bounds,
    emergency: ndarray,
    pull: ndarray,
    ahead: int,
) -> ndarray:
    """Highest speed at each node that any plant within the bounds can hold without being overruled."""
    count = emergency.size
    windows = sliding_window_view(_pad(emergency, count + ahead, 0.0), ahead)[:count]
    distance = (field.node_m[1] - field.node_m[0]) * np.arange(ahead)
    weight = np.maximum(bounds.mass[0] * field.weight_n, bounds.mass[1] * field.weight_n)

    def hold(speed: ndarray) -> ndarray:
        needed = weight + bounds.resistance[1] * davis_n(vehicle, speed)
        return needed / vehicle.effective_mass_kg

    speed = highest_speed(vehicle, rates, windows, distance, pull, hold)
    return -sliding_max(-np.append(speed[:-1], 0.0), 1, 2)[:count]


def _pad(values: ndarray, size: int, fill: float) -> ndarray:
    return np.concatenate([values, np.full(size - values.size, fill)])


class TrackGrid(NamedTuple):
    """Limits and gradients of a section, node by node (N) and between them (N-1).

    Attributes:
        node_m: Positions, uniformly spaced. Shape (N,).
        ceiling_mps: Lowest limit between each node and the next. Shape (N-1,).
        pull_mps2: Largest pull of the gradient there, less certain curve resistance. Shape (N-1,).
        usual_pull_mps2: The same less all curve resistance. Shape (N-1,).
        weight_n: Force that gradient and curve ask for at each node. Shape (N,).
    """

    node_m: Float[ndarray, " nodes"]
    ceiling_mps: Float[ndarray, " nodes-1"]
    pull_mps2: Float[ndarray, " nodes-1"]
    usual_pull_mps2: Float[ndarray, " nodes-1"]
    weight_n: Float[ndarray, " nodes"]


def track_grid(
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
        stop_at_m: End of the movement authority, if the limit is 0 from there on.
        spacing_m: Distance between nodes.
        resistance_low: Share of the curve resistance that is certain.
        before_m: Distance before the origin at which the grid begins.

    Raises:
        InputError: The section is too long for the spacing.
    """
    nodes = _nodes(section, stop_at_m, spacing_m, before_m)
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    gradient, curve, _ = mean_slopes(vehicle, track, nodes)
    return TrackGrid(
        node_m=nodes,
        ceiling_mps=_ceilings(nodes, section, trainset, stop_at_m),
        pull_mps2=_cell_pulls(nodes, section, trainset, resistance_low),
        usual_pull_mps2=_cell_pulls(nodes, section, trainset, 1.0),
        weight_n=vehicle.mass_kg * (vehicle.gravity_mps2 * gradient + curve),
    )


def sliding_max(cells: Float[ndarray, " cells"], back: int, ahead: int) -> Float[ndarray, " cells+1"]:
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
    gradient, curve, _ = mean_slopes(vehicle, track, points)
    inertia = trainset.mass_kg / trainset.effective_mass_kg
    pull = -inertia * (vehicle.gravity_mps2 * gradient + resistance * curve)
    at = np.searchsorted(points, nodes)
    return np.maximum(np.maximum.reduceat(pull, at)[:-1], pull[at[1:]])
