"""Energy at the wheel and at the line."""

from __future__ import annotations

from metropilot.physics.arrays import Scalar, locate, namespace
from metropilot.physics.effort import effort_at
from metropilot.physics.types import Array, Forces, Vehicle


def map_value(vehicle: Vehicle, values: Array, speed_mps: Scalar, share: Scalar) -> Scalar:
    """Bilinear value of an efficiency map, held outside its corners. ``values`` has shape (S, E)."""
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
    traction_j = forces.traction_n * distance_m
    braking_j = forces.electric_brake_n * distance_m
    motoring, braking = efficiencies(vehicle, forces, mean_speed_mps)
    recovered_j = braking_j * braking * vehicle.receptivity
    line_j = traction_j / motoring + vehicle.auxiliary_w * duration_s - recovered_j
    return traction_j, braking_j, line_j, recovered_j


def efficiencies(vehicle: Vehicle, forces: Forces, speed_mps: Scalar) -> tuple[Scalar, Scalar]:
    """Efficiency of traction and of electric braking, at these forces as shares of what there is."""
    if vehicle.efficiency_traction.shape == vehicle.efficiency_braking.shape == (1, 1):
        return vehicle.efficiency_traction[0, 0], vehicle.efficiency_braking[0, 0]
    xp = namespace(forces.traction_n, speed_mps)
    effort = effort_at(vehicle, speed_mps)
    up = forces.traction_n / xp.maximum(effort.traction_n, 1.0)
    down = forces.electric_brake_n / xp.maximum(effort.electric_n, 1.0)
    return (
        map_value(vehicle, vehicle.efficiency_traction, speed_mps, up),
        map_value(vehicle, vehicle.efficiency_braking, speed_mps, down),
    )
