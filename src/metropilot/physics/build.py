"""From the railway schema to the plant's arrays, padded so that sections share one compiled program."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.errors import InputError
from metropilot.physics.types import Track, Vehicle
from metropilot.railway import Curve, Efficiency, EffortCurve, SafeBraking, Section, Trainset

SIZES = (16, 32, 64, 128, 256, 512, 1024)
PIECES = (4, 8, 16, 32, 64)
CLOTHOID_STEP_M = 10.0


def padded_size(count: int, sizes: Sequence[int] = SIZES) -> int:
    """The smallest of the agreed sizes that holds ``count`` entries; beyond the largest, sizes double."""
    size = next((size for size in sizes if count <= size), sizes[-1])
    while size < count:
        size *= 2
    return size


def _pad(values: ndarray, size: int, fill: float | None = None) -> ndarray:
    extra = size - values.shape[0]
    last = values[-1:] if fill is None else np.full_like(values[-1:], fill)
    tail = np.repeat(last, extra, axis=0)
    return np.concatenate([values, tail]) if extra else values


def _effort(curve: EffortCurve, size: int | None) -> tuple[ndarray, ndarray]:
    starts = np.array([p.from_mps for p in curve.pieces])
    rows = np.array([[p.power_w, *p.polynomial, p.cap_n] for p in curve.pieces])
    size = size or padded_size(len(starts), PIECES)
    return _pad(starts, size, np.inf), _pad(rows, size)


def vehicle_arrays(trainset: Trainset, dtype: type = np.float64, pieces: int | None = None) -> Vehicle:
    """The trainset with its load as the plant's numbers.

    Args:
        trainset: Trainset.
        dtype: ``numpy.float64`` for planning and evaluation, ``numpy.float32`` for learning.
        pieces: Padded number of effort pieces; None picks the smallest of ``PIECES``.
    """
    count = max(len(trainset.traction.pieces), len(trainset.electric_brake.pieces))
    size = pieces or padded_size(count, PIECES)
    traction_from, traction = _effort(trainset.traction, size)
    brake_from, brake = _effort(trainset.electric_brake, size)
    motoring, braking = trainset.efficiency_traction, trainset.efficiency_braking
    speeds = np.unique(np.concatenate([motoring.speed_mps, braking.speed_mps]))
    shares = np.unique(np.concatenate([motoring.effort_share, braking.effort_share]))
    effective = trainset.effective_mass_kg
    safe = trainset.safe_braking
    values = {
        "mass_kg": trainset.mass_kg,
        "effective_mass_kg": effective,
        "length_m": trainset.length_m,
        "davis_n": trainset.davis.newtons(trainset.mass_kg),
        "gravity_mps2": trainset.gravity_mps2,
        "traction_from_mps": traction_from,
        "traction": traction,
        "brake_from_mps": brake_from,
        "brake": brake,
        "friction_n": trainset.friction_brake_n,
        "service_n": trainset.service_deceleration_mps2 * effective,
        "emergency_n": safe.emergency_deceleration_mps2 * effective,
        "adhesion_n": trainset.adhesion * trainset.mass_kg * trainset.gravity_mps2,
        "max_acceleration_mps2": trainset.max_acceleration_mps2,
        "max_deceleration_mps2": trainset.max_deceleration_mps2,
        "max_speed_mps": trainset.max_speed_mps,
        "delay_s": trainset.actuation.delay_s,
        "lag_s": trainset.actuation.lag_s,
        "jerk_mps3": trainset.actuation.jerk_limit_mps3,
        "emergency_jerk_mps3": emergency_jerk_mps3(safe),
        "emergency_delay_s": safe.reaction_s,
        "efficiency_speed_mps": speeds,
        "efficiency_share": shares,
        "efficiency_traction": _resample(motoring, speeds, shares),
        "efficiency_braking": _resample(braking, speeds, shares),
        "receptivity": trainset.receptivity,
        "auxiliary_w": trainset.auxiliary_w,
    }
    return Vehicle(**{k: np.asarray(v, dtype)[()] for k, v in values.items()})


def emergency_jerk_mps3(safe: SafeBraking) -> float:
    """Rate at which the emergency brake builds up: its jerk, or slower where the build-up time says so."""
    if safe.buildup_s <= 0:
        return safe.emergency_jerk_mps3
    return min(safe.emergency_jerk_mps3, safe.emergency_deceleration_mps2 / safe.buildup_s)


def _resample(efficiency: Efficiency, speeds: ndarray, shares: ndarray) -> ndarray:
    """A bilinear map on a finer grid that contains its own: no value changes."""
    rows = np.stack([np.interp(shares, efficiency.effort_share, row) for row in efficiency.value])
    return np.stack([np.interp(speeds, efficiency.speed_mps, column) for column in rows.T], axis=1)


def track_arrays(
    section: Section, trainset: Trainset, dtype: type = np.float64, size: int | None = None
) -> Track:
    """The section as this trainset feels it: potentials, and limits that hold until its tail has cleared.

    Args:
        section: Section.
        trainset: Only its length, curve formula and tunnel table matter.
        dtype: Number type.
        size: Padded number of nodes and of limit pieces; None picks the smallest of ``SIZES``.

    Raises:
        InputError: A tunnel cross section the trainset has no coefficient for, or a curve tighter than its
            formula allows.
    """
    nodes, slopes = _slopes(section, trainset)
    steps = np.diff(nodes)[:, None] * slopes[:-1]
    potential = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    limit_from, limit = restrictive_profile(section, trainset.length_m, trainset.max_speed_mps)
    size = size or padded_size(max(nodes.size, limit_from.size))
    return Track(
        length_m=dtype(section.length_m),
        node_m=_pad(nodes, size, np.inf).astype(dtype),
        potential=_pad(potential, size).astype(dtype),
        slope=_pad(slopes, size).astype(dtype),
        limit_from_m=_pad(limit_from, size, np.inf).astype(dtype),
        limit_mps=_pad(limit, size).astype(dtype),
    )


def _slopes(section: Section, trainset: Trainset) -> tuple[ndarray, ndarray]:
    """Every break between tail-before-origin and overshoot, and the three slopes after each."""
    low, high = -trainset.length_m - 1.0, section.length_m + 500.0
    gradient = section.gradient_permil.window(low, high)
    curve_at, curve_value = _curve_steps(section.curves, trainset)
    tunnel_at, tunnel_value = _tunnel_steps(section, trainset)
    nodes = np.unique(np.concatenate([gradient.from_m, curve_at, tunnel_at]))
    nodes = nodes[(nodes >= low) & (nodes < high)]
    slopes = np.stack(
        [
            gradient.at(nodes) / 1000.0,
            _hold_values(curve_at, curve_value, nodes),
            _hold_values(tunnel_at, tunnel_value, nodes),
        ],
        axis=1,
    )
    return nodes, slopes


def _hold_values(starts: ndarray, values: ndarray, at: ndarray) -> ndarray:
    if starts.size == 0:
        return np.zeros(at.shape)
    index = np.searchsorted(starts, at, side="right") - 1
    return np.where(index >= 0, values[np.maximum(index, 0)], 0.0)


def specific_curve_resistance(
    curvature_per_m: Float[ndarray, " pieces"], trainset: Trainset
) -> Float[ndarray, " pieces"]:
    """Curve resistance, N/kg: ``600/r`` N/kN (Chinese rule) or ``6.3/(r-55)`` N/kg (Huang25).

    Raises:
        InputError: A radius of 55 m or less with the second formula.
    """
    curvature = np.abs(curvature_per_m)
    if trainset.curve_formula == "none":
        return np.zeros_like(curvature)
    if trainset.curve_formula == "600/r":
        return 0.6 * curvature * trainset.gravity_mps2
    if (curvature >= 1 / 55.0).any():
        raise InputError(
            "curve too tight for the 6.3/(r-55) formula",
            value=float(1 / curvature.max()),
            unit="m",
            allowed="radius > 55 m",
        )
    return 6.3 * curvature / (1.0 - 55.0 * curvature)


def _curve_steps(curves: tuple[Curve, ...], trainset: Trainset) -> tuple[ndarray, ndarray]:
    """Curve resistance as steps; a clothoid is cut into pieces of at most ``CLOTHOID_STEP_M``."""
    if not curves or trainset.curve_formula == "none":
        return np.zeros(0), np.zeros(0)
    starts: list[float] = []
    curvatures: list[float] = []
    ends = [c.from_m for c in curves[1:]] + [np.inf]
    for curve, end in zip(curves, ends, strict=True):
        k0, k1 = curve.curvature_start_per_m, curve.curvature_end_per_m
        if k0 == k1 or not np.isfinite(end):
            starts.append(curve.from_m)
            curvatures.append(k0)
            continue
        count = int(np.ceil((end - curve.from_m) / CLOTHOID_STEP_M))
        middle = (np.arange(count) + 0.5) / count
        starts.extend(curve.from_m + (end - curve.from_m) * np.arange(count) / count)
        curvatures.extend(k0 + (k1 - k0) * middle)
    return np.array(starts), specific_curve_resistance(np.array(curvatures), trainset)


def _tunnel_steps(section: Section, trainset: Trainset) -> tuple[ndarray, ndarray]:
    if not section.tunnels or not trainset.tunnel_n_per_mps2:
        return np.zeros(0), np.zeros(0)
    areas, coefficients = np.array(sorted(trainset.tunnel_n_per_mps2)).T
    edges, values = [], []
    for tunnel in section.tunnels:
        edges += [tunnel.from_m, tunnel.from_m + tunnel.length_m]
        values += [float(np.interp(tunnel.cross_section_m2, areas, coefficients)), 0.0]
    order = np.argsort(edges, kind="stable")
    return np.array(edges)[order], np.array(values)[order]


def restrictive_profile(
    section: Section, length_m: float, max_speed_mps: float
) -> tuple[Float[ndarray, " pieces"], Float[ndarray, " pieces"]]:
    """Most restrictive speed profile of the head: a limit holds until the tail has cleared it.

    Returns:
        Where each piece begins and the speed that holds, m and m/s.
    """
    low, high = -length_m - 1.0, section.length_m + 500.0
    limit = section.limit_mps.window(low, high)
    breaks = np.unique(np.concatenate([limit.from_m, limit.from_m + length_m]))
    breaks = breaks[breaks < high]
    ends = np.append(breaks[1:], high)
    middle = 0.5 * (breaks + ends)
    index_head = np.searchsorted(limit.from_m, middle, side="right") - 1
    index_tail = np.maximum(np.searchsorted(limit.from_m, middle - length_m, side="right") - 1, 0)
    speeds = np.array(
        [limit.value[a : b + 1].min() for a, b in zip(index_tail, np.maximum(index_head, 0), strict=True)]
    )
    speeds = np.minimum(speeds, max_speed_mps)
    keep = np.append(True, np.diff(speeds) != 0)
    return breaks[keep], speeds[keep]
