"""What holds a trainset back: Davis, gradient, curve and tunnel."""

from __future__ import annotations

from typing import Any

from metropilot.physics.arrays import Scalar, locate, namespace
from metropilot.physics.types import Track, Vehicle


def potentials(track: Track, position_m: Scalar) -> Any:
    """Altitude, curve and tunnel potential at one position. Shape (3,)."""
    k = locate(track.node_m, position_m)
    return track.potential[k] + track.slope[k] * (position_m - track.node_m[k])


def felt_slopes(vehicle: Vehicle, track: Track, position_m: Scalar) -> Any:
    """Mean slope of each potential between tail and head; the slope at the head for a point mass.

    Returns:
        Gradient (1), specific curve resistance (N/kg) and tunnel coefficient (N/(m/s)^2). Shape (3,).
    """
    xp = namespace(track.node_m, position_m)
    head = potentials(track, position_m)
    tail = potentials(track, position_m - vehicle.length_m)
    at_head = track.slope[locate(track.node_m, position_m)]
    return xp.where(vehicle.length_m > 0, (head - tail) / xp.maximum(vehicle.length_m, 1e-6), at_head)


def davis_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Running resistance ``a + b v + c v^2`` on straight open track, N (Davis)."""
    return vehicle.davis_n[0] + speed_mps * (vehicle.davis_n[1] + speed_mps * vehicle.davis_n[2])


def resistance_and_gradient(
    vehicle: Vehicle, track: Track, position_m: Scalar, speed_mps: Scalar
) -> tuple[Scalar, Scalar]:
    """Resistance (Davis, curve, tunnel) and gradient force, N.

    Sources: Huang25 eq. 3 (force balance), Chen23a eqs. 5 and 7. A gradient acts as the difference in altitude
    between head and tail over the length.
    """
    felt = felt_slopes(vehicle, track, position_m)
    curve_n = vehicle.mass_kg * felt[1]
    tunnel_n = felt[2] * speed_mps * speed_mps
    return davis_n(vehicle, speed_mps) + curve_n + tunnel_n, vehicle.mass_kg * vehicle.gravity_mps2 * felt[0]
