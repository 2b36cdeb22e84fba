"""Adaptation of the nominal plant to the effort and resistance that a driver has observed."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from metropilot.physics import Vehicle
from metropilot.railway import Davis, Trainset


class Adaptation(NamedTuple):
    """Observed over nominal values: factors on traction, service brake and running resistance per mass."""

    traction: float = 1.0
    brake: float = 1.0
    resistance: float = 1.0


LEARNED_BAND = Adaptation(0.02, 0.04, 0.03)
"""Departures from the plant that is reckoned with that call for reckoning anew."""


def departs_from(found: Adaptation, assumed: Adaptation, share: float = 1.0) -> bool:
    """Tell if an observed plant is another one than is reckoned with.

    Args:
        found: The plant as observed.
        assumed: The plant that is reckoned with.
        share: Of ``LEARNED_BAND``, beyond which it is another one.
    """
    pairs = zip(found, assumed, LEARNED_BAND, strict=True)
    return any(abs(now - before) > share * most for now, before, most in pairs)


def adapt_vehicle(vehicle: Vehicle, adapted: Adaptation) -> Vehicle:
    """Scale effort and resistance of a plant by the observed factors."""
    up, down, drag = adapted
    return vehicle._replace(
        traction=vehicle.traction * up,
        brake=vehicle.brake * down,
        friction_n=vehicle.friction_n * down,
        service_n=vehicle.service_n * down,
        davis_n=vehicle.davis_n * drag,
    )


def adapt_trainset(trainset: Trainset, adapted: Adaptation) -> Trainset:
    """Scale effort and resistance of a trainset, for plans that are computed from its data."""
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
