"""A trainset as it has shown itself: what a driver plans with once it answers differently than told."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from metropilot.physics import Vehicle
from metropilot.railway import Davis, Trainset


class Adapted(NamedTuple):
    """How a trainset answers over how it was said to: factors on effort, brake and resistance."""

    traction: float = 1.0
    brake: float = 1.0
    resistance: float = 1.0


def adapted_vehicle(vehicle: Vehicle, adapted: Adapted) -> Vehicle:
    """The trainset as it has shown itself: effort and resistance per mass scaled."""
    up, down, drag = adapted
    return vehicle._replace(
        traction=vehicle.traction * up,
        brake=vehicle.brake * down,
        friction_n=vehicle.friction_n * down,
        service_n=vehicle.service_n * down,
        davis_n=vehicle.davis_n * drag,
    )


def adapted_trainset(trainset: Trainset, adapted: Adapted) -> Trainset:
    """The same for what is built from a trainset's data."""
    up, down, drag = adapted
    a, b, c = trainset.davis.newtons(trainset.mass_kg)
    return replace(
        trainset,
        traction=trainset.traction.scale(up),
        electric_brake=trainset.electric_brake.scale(down),
        friction_brake_n=trainset.friction_brake_n * down,
        service_deceleration_mps2=trainset.service_deceleration_mps2 * down,
        davis=Davis(drag * a, drag * b, drag * c),
    )
