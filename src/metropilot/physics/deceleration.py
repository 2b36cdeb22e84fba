"""Brakes under deceleration control: no harder than a rate, whatever gradient and load."""

from __future__ import annotations

from metropilot.physics.arrays import Scalar, namespace
from metropilot.physics.effort import effort_at
from metropilot.physics.plant import Command
from metropilot.physics.resistance import resistance_and_gradient
from metropilot.physics.types import State, Track, Vehicle


def controlled(
    vehicle: Vehicle, track: Track, state: State, command: Command, most_mps2: Scalar
) -> tuple[Vehicle, Command]:
    """Trainset and command for the coming period, its brakes controlled to a total deceleration.

    The emergency brake asks for what gradient and resistance leave of the rate, as far as its own force and
    the adhesion reach. The service brake gives what was asked for, and no more than that. Trainsets that run
    close behind each other need it: with the same brake force, a few permille of difference between their
    gradients part their stopping points by many metres.

    Args:
        vehicle: The trainset.
        track: The section.
        state: State at the start of the period.
        command: Command, a share of the braking force without control.
        most_mps2: Total deceleration, gradient and resistance included; infinite leaves the brakes alone.
    """
    xp = namespace(state.position_m, most_mps2)
    resistance, gradient = resistance_and_gradient(vehicle, track, state.position_m, state.speed_mps)
    wanted = xp.maximum(most_mps2 * vehicle.effective_mass_kg - (resistance + gradient), 0.0)
    free = effort_at(vehicle, state.speed_mps).brake_n
    held = xp.minimum(free, wanted)
    share = xp.where(command.share < 0.0, command.share * free / xp.maximum(held, 1.0), command.share)
    reach = xp.minimum(vehicle.emergency_n, vehicle.adhesion_n)
    vehicle = vehicle._replace(
        emergency_n=xp.minimum(wanted, reach), service_n=xp.minimum(wanted, vehicle.service_n)
    )
    return vehicle, Command(xp.clip(share, -1.0, 1.0), command.emergency)
