"""Traction and braking effort available at a speed, and how a command is split over the brakes."""

from __future__ import annotations

from metropilot.physics.arrays import Scalar, locate, namespace
from metropilot.physics.types import Array, Vehicle


def curve_n(breaks_mps: Array, pieces: Array, speed_mps: Scalar) -> Scalar:
    """Force of a piecewise effort curve, N: ``min(cap, h/v + c0 + c1 v + c2 v^2 + c3 v^3)``, not below 0.

    Args:
        breaks_mps: Where each piece begins. Shape (P,).
        pieces: ``h, c0, c1, c2, c3, cap`` of each piece. Shape (P, 6).
        speed_mps: Speed.
    """
    k = locate(breaks_mps, speed_mps)
    power, c0, c1, c2, c3, cap = (pieces[k, j] for j in range(6))
    xp = namespace(power, speed_mps)
    v = speed_mps
    return xp.clip(power / xp.maximum(v, 1e-3) + c0 + v * (c1 + v * (c2 + v * c3)), 0.0, cap)


def traction_available_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Largest traction force at a speed, adhesion included, N."""
    xp = namespace(vehicle.adhesion_n, speed_mps)
    return xp.minimum(curve_n(vehicle.traction_from_mps, vehicle.traction, speed_mps), vehicle.adhesion_n)


def electric_available_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Largest electric braking force at a speed, adhesion included, N."""
    xp = namespace(vehicle.adhesion_n, speed_mps)
    return xp.minimum(curve_n(vehicle.brake_from_mps, vehicle.brake, speed_mps), vehicle.adhesion_n)


def brake_available_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Braking force that command -1 asks for: electric and friction, up to the service rate and adhesion, N."""
    xp = namespace(vehicle.adhesion_n, speed_mps)
    total = curve_n(vehicle.brake_from_mps, vehicle.brake, speed_mps) + vehicle.friction_n
    return xp.minimum(xp.minimum(total, vehicle.service_n), vehicle.adhesion_n)


def command_force_n(vehicle: Vehicle, speed_mps: Scalar, command: Scalar) -> Scalar:
    """Signed wheel force of a command in [-1, 1], traction positive, N (Chen23a eqs. 13 and 14)."""
    xp = namespace(vehicle.adhesion_n, speed_mps, command)
    positive = xp.maximum(command, 0.0) * traction_available_n(vehicle, speed_mps)
    negative = xp.minimum(command, 0.0) * brake_available_n(vehicle, speed_mps)
    return positive + negative


def command_for_force(vehicle: Vehicle, speed_mps: Scalar, force_n: Scalar) -> Scalar:
    """The command whose force is nearest the wanted one; inverse of :func:`command_force_n`."""
    xp = namespace(vehicle.adhesion_n, speed_mps, force_n)
    traction = xp.maximum(traction_available_n(vehicle, speed_mps), 1.0)
    braking = xp.maximum(brake_available_n(vehicle, speed_mps), 1.0)
    return xp.clip(xp.where(force_n >= 0, force_n / traction, force_n / braking), -1.0, 1.0)
