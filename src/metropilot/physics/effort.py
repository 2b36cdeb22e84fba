"""Traction and braking effort available at a speed, and how a command is split over the brakes."""

from __future__ import annotations

from typing import Any, NamedTuple, no_type_check

from metropilot.physics.arrays import Scalar, locate, namespace, scalars
from metropilot.physics.types import Array, Vehicle

FEW = 4
"""Up to so many pieces of a curve are chosen from rather than fetched."""


def curve_n(breaks_mps: Array, pieces: Array, speed_mps: Scalar) -> Scalar:
    """Force of a piecewise effort curve, N: ``min(cap, h/v + c0 + c1 v + c2 v^2 + c3 v^3)``, not below 0.

    Args:
        breaks_mps: Where each piece begins. Shape (P,).
        pieces: ``h, c0, c1, c2, c3, cap`` of each piece. Shape (P, 6).
        speed_mps: Speed.
    """
    k = locate(breaks_mps, speed_mps)
    xp = namespace(speed_mps) if type(k) is int else namespace(pieces, speed_mps)
    row = pieces[k] if xp is scalars else (_row(xp, pieces, k, j) for j in range(6))
    power, c0, c1, c2, c3, cap = row
    v = speed_mps
    return xp.clip(power / xp.maximum(v, 1e-3) + c0 + v * (c1 + v * (c2 + v * c3)), 0.0, cap)


@no_type_check
def _row(xp: Any, pieces: Array, k: Scalar, j: int) -> Scalar:
    """``pieces[k, j]``; in a compiled batch by choosing among the few pieces, sooner than by fetching."""
    if not hasattr(xp, "ndarray") or xp.ndim(k) or type(k) is int or pieces.shape[0] > FEW:
        return pieces[k, j]
    value = pieces[0, j]
    for piece in range(1, pieces.shape[0]):
        value = xp.where(k >= piece, pieces[piece, j], value)
    return value


class Effort(NamedTuple):
    """What a trainset can do at one speed, N.

    Attributes:
        traction_n: Largest traction force.
        electric_n: Largest electric braking force.
        brake_n: Braking force that command -1 asks for.
    """

    traction_n: Scalar
    electric_n: Scalar
    brake_n: Scalar

    def force_n(self, command: Scalar) -> Scalar:
        """Signed wheel force of a command in [-1, 1], traction positive, N (Chen23a eqs. 13 and 14)."""
        xp = namespace(self.traction_n, command)
        return xp.maximum(command, 0.0) * self.traction_n + xp.minimum(command, 0.0) * self.brake_n


def effort_at(vehicle: Vehicle, speed_mps: Scalar) -> Effort:
    """The three forces available at a speed, each curve looked up once."""
    xp = namespace(vehicle.adhesion_n, speed_mps)
    traction = curve_n(vehicle.traction_from_mps, vehicle.traction, speed_mps)
    electric = curve_n(vehicle.brake_from_mps, vehicle.brake, speed_mps)
    brake = xp.minimum(electric + vehicle.friction_n, vehicle.service_n)
    return Effort(*(xp.minimum(force, vehicle.adhesion_n) for force in (traction, electric, brake)))


def traction_available_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Largest traction force at a speed, adhesion included, N."""
    return effort_at(vehicle, speed_mps).traction_n


def electric_available_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Largest electric braking force at a speed, adhesion included, N."""
    return effort_at(vehicle, speed_mps).electric_n


def brake_available_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Braking force that command -1 asks for: electric and friction, up to service rate and adhesion, N."""
    return effort_at(vehicle, speed_mps).brake_n


def command_force_n(vehicle: Vehicle, speed_mps: Scalar, command: Scalar) -> Scalar:
    """Signed wheel force of a command in [-1, 1], traction positive, N (Chen23a eqs. 13 and 14)."""
    return effort_at(vehicle, speed_mps).force_n(command)


def command_for_effort(effort: Scalar, traction: Scalar, brake: Scalar) -> Scalar:
    """The command in [-1, 1] whose effort is nearest the wanted one.

    Args:
        effort: Wanted effort, traction positive: a force, or an acceleration per mass.
        traction: Largest traction, above 0, in the same unit.
        brake: Largest service brake, above 0, in the same unit.
    """
    xp = namespace(effort, traction)
    return xp.clip(effort / xp.where(effort >= 0, traction, brake), -1.0, 1.0)


def command_for_force(vehicle: Vehicle, speed_mps: Scalar, force_n: Scalar) -> Scalar:
    """The command whose force is nearest the wanted one; inverse of :func:`command_force_n`."""
    xp = namespace(vehicle.adhesion_n, speed_mps, force_n)
    effort = effort_at(vehicle, speed_mps)
    return command_for_effort(force_n, xp.maximum(effort.traction_n, 1.0), xp.maximum(effort.brake_n, 1.0))
