"""Energy at the wheel and at the line."""

from __future__ import annotations

from metropilot.physics.arrays import Scalar, locate, namespace
from metropilot.physics.effort import electric_available_n, traction_available_n
from metropilot.physics.types import Array, Forces, Vehicle


def map_value(vehicle: Vehicle, values: Array, speed_mps: Scalar, share: Scalar) -> Scalar:
    """Bilinear value of an efficiency map, held outside its corners. ``values`` has shape (S, E)."""
    if values.shape[-1] == 1 and values.shape[-2] == 1:
        return values[0, 0]
    i, a = _bracket(vehicle.efficiency_speed_mps, speed_mps)
    j, b = _bracket(vehicle.efficiency_share, share)
    i1 = min(values.shape[0] - 1, 1) + i
    j1 = min(values.shape[1] - 1, 1) + j
    low = values[i, j] * (1 - b) + values[i, j1] * b
    high = values[i1, j] * (1 - b) + values[i1, j1] * b
    return low * (1 - a) + high * a


def _bracket(points: Array, x: Scalar) -> tuple[Scalar, Scalar]:
    xp = namespace(points, x)
    if points.shape[0] == 1:
        return 0, 0.0 * x
    k = xp.clip(locate(points, x), 0, points.shape[0] - 2)
    return k, xp.clip((x - points[k]) / (points[k + 1] - points[k]), 0.0, 1.0)


def step_energy(
    vehicle: Vehicle, forces: Forces, mean_speed_mps: Scalar, distance_m: Scalar, duration_s: Scalar
) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Energy of one step with its forces held (Chen23a eq. 2).

    Returns:
        Wheel traction, electric braking at the wheel, net at the line, recovered at the line; all J.
    """
    xp = namespace(forces.traction_n, distance_m)
    traction_j = forces.traction_n * distance_m
    braking_j = forces.electric_brake_n * distance_m
    up = forces.traction_n / xp.maximum(traction_available_n(vehicle, mean_speed_mps), 1.0)
    down = forces.electric_brake_n / xp.maximum(electric_available_n(vehicle, mean_speed_mps), 1.0)
    motoring = map_value(vehicle, vehicle.efficiency_traction, mean_speed_mps, up)
    braking = map_value(vehicle, vehicle.efficiency_braking, mean_speed_mps, down)
    recovered_j = braking_j * braking * vehicle.receptivity
    return traction_j, braking_j, traction_j / motoring + vehicle.auxiliary_w * duration_s - recovered_j, recovered_j
