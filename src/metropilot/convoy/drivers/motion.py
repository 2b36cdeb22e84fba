"""From a wanted acceleration to a command, within limits: what followers share."""

from __future__ import annotations

from typing import Any, no_type_check

from metropilot.convoy.step import FollowerObservation
from metropilot.physics import effort_at, namespace, resistance_and_gradient

Scalar = Any
LIMIT_S = 1.0
"""How long before the permitted speed a follower begins to ease off."""
UNDER_MPS = 0.05
"""How far a follower stays under it."""
STILL_MPS = 0.02
STILL_M = 0.1


@no_type_check
def command_for(sight: FollowerObservation, wanted_mps2: Scalar) -> Scalar:
    """The command that gives an acceleration, as the driver knows the trainset; held where all stand."""
    xp = namespace(sight.position_m, wanted_mps2)
    vehicle = sight.vehicle
    allowed = (sight.permitted_mps - UNDER_MPS - sight.speed_mps) / LIMIT_S
    wanted = xp.minimum(wanted_mps2, allowed)
    resistance, gradient = resistance_and_gradient(vehicle, sight.track, sight.position_m, sight.speed_mps)
    force = vehicle.effective_mass_kg * wanted + resistance + gradient
    effort = effort_at(vehicle, sight.speed_mps)
    available = xp.where(force >= 0.0, effort.traction_n, effort.brake_n)
    share = xp.clip(force / xp.maximum(available, 1.0), -1.0, 1.0)
    return xp.where(waits(sight), -0.3, share)


@no_type_check
def waits(sight: FollowerObservation) -> Scalar:
    """Whether there is nothing to do but stand."""
    near = sight.gap_m <= sight.wanted_gap_m + STILL_M
    return (sight.speed_mps <= STILL_MPS) & (sight.ahead_mps <= STILL_MPS) & near


@no_type_check
def reachable(sight: FollowerObservation) -> tuple[Scalar, Scalar]:
    """Hardest braking and strongest acceleration that commands -1 and 1 give here, m/s^2."""
    vehicle = sight.vehicle
    resistance, gradient = resistance_and_gradient(vehicle, sight.track, sight.position_m, sight.speed_mps)
    effort = effort_at(vehicle, sight.speed_mps)
    low = (-effort.brake_n - resistance - gradient) / vehicle.effective_mass_kg
    return low, (effort.traction_n - resistance - gradient) / vehicle.effective_mass_kg
