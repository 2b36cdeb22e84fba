"""What holds a trainset back: Davis, gradient, curve and tunnel."""

from __future__ import annotations

from typing import no_type_check

from metropilot.physics.arrays import Scalar, locate, namespace
from metropilot.physics.types import Track, Vehicle


def felt_slopes(vehicle: Vehicle, track: Track, position_m: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Mean slope of each potential between tail and head; the slope at the head for a point mass.

    Returns:
        Gradient (1), specific curve resistance (N/kg) and tunnel coefficient (N/(m/s)^2).
    """
    xp = namespace(vehicle.length_m, position_m)
    tail_m = position_m - vehicle.length_m
    head, tail = locate(track.node_m, position_m), locate(track.node_m, tail_m)
    past_head, past_tail = position_m - track.node_m[head], tail_m - track.node_m[tail]
    per_length = 1.0 / xp.maximum(vehicle.length_m, 1e-6)
    is_point = vehicle.length_m <= 0

    @no_type_check
    def felt(j: int) -> Scalar:
        at_head = track.slope[head, j]
        rise = track.potential[head, j] - track.potential[tail, j]
        rise = rise + at_head * past_head - track.slope[tail, j] * past_tail
        return xp.where(is_point, at_head, rise * per_length)

    return felt(0), felt(1), felt(2)


def davis_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Running resistance ``a + b v + c v^2`` on straight open track, N (Davis)."""
    return vehicle.davis_n[0] + speed_mps * (vehicle.davis_n[1] + speed_mps * vehicle.davis_n[2])


def resistance_and_gradient(
    vehicle: Vehicle, track: Track, position_m: Scalar, speed_mps: Scalar
) -> tuple[Scalar, Scalar]:
    """Resistance (Davis, curve, tunnel) and gradient force, N.

    Sources: Huang25 eq. 3 (force balance), Chen23a eqs. 5 and 7. A gradient acts as the difference in
    altitude between head and tail over the length.
    """
    gradient, curve_n_per_kg, tunnel = felt_slopes(vehicle, track, position_m)
    track_n = vehicle.mass_kg * curve_n_per_kg + tunnel * speed_mps * speed_mps
    return davis_n(vehicle, speed_mps) + track_n, vehicle.mass_kg * vehicle.gravity_mps2 * gradient
