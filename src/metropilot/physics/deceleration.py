"""Brakes under deceleration control: no harder than a rate, whatever gradient and load."""

from __future__ import annotations

from metropilot.physics.arrays import Scalar, namespace
from metropilot.physics.resistance import resistance_and_gradient
from metropilot.physics.types import State, Track, Vehicle


def controlled(vehicle: Vehicle, track: Track, state: State, most_mps2: Scalar) -> Vehicle:
    """The trainset with its brakes controlled to a total deceleration, for the coming period.

    The emergency brake asks for what gradient and resistance leave of the rate, as far as its own force and
    the adhesion reach; the service brake for no more than that. Trainsets that run close behind each other
    need it: with the same brake force, a few permille of difference between their gradients part their
    stopping points by many metres.

    Args:
        vehicle: The trainset.
        track: The section.
        state: State at the start of the period.
        most_mps2: Total deceleration, gradient and resistance included; infinite leaves the brakes alone.
    """
    xp = namespace(state.position_m, most_mps2)
    resistance, gradient = resistance_and_gradient(vehicle, track, state.position_m, state.speed_mps)
    wanted = xp.maximum(most_mps2 * vehicle.effective_mass_kg - (resistance + gradient), 0.0)
    reach = xp.minimum(vehicle.emergency_n, vehicle.adhesion_n)
    return vehicle._replace(
        emergency_n=xp.minimum(wanted, reach), service_n=xp.minimum(wanted, vehicle.service_n)
    )
