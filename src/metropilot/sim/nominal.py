"""What another driver would drive: one run played through ahead of departure, on the trainset as believed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.errors import InputError
from metropilot.physics import Command, at_rest, delay_steps, step, track_arrays, vehicle_arrays
from metropilot.protection import at_start, permitted_speed, protect, supervise
from metropilot.sim.bounds import declared_bounds
from metropilot.sim.driver import AbstractDriver
from metropilot.sim.run import Observation, Run

LATE = 1.5
MOST_STANDING = 3
STANDING_S = 2.0


class NominalDrive(NamedTuple):
    """A drive as nodes of distance.

    Attributes:
        position_m: Increasing, from the origin to the stop. Shape (N,).
        speed_mps: Speed there, above zero but at both ends. Shape (N,).
        running_time_s: How long it took.
    """

    position_m: Float[ndarray, " nodes"]
    speed_mps: Float[ndarray, " nodes"]
    running_time_s: float


def simulate_nominal(run: Run, driver: AbstractDriver) -> NominalDrive:
    """Play a run through with another driver, under protection, without anything the run's scenario hides.

    Args:
        run: The run.
        driver: Who is to drive it.

    Raises:
        InputError: It never moves.
    """
    trainset = run.scenario.nominal(run.trainset)
    vehicle, track = vehicle_arrays(trainset), track_arrays(run.section, trainset)
    guard = protect(run.section, trainset, declared_bounds(run))
    watched, memory = at_start(guard), driver.init(run)
    state = at_rest(vehicle, delay_steps=delay_steps(float(vehicle.delay_s), run.dt))
    nodes, stood_s, time_s = [(0.0, 0.0)], 0.0, 0.0
    while float(state.time_s) < LATE * run.scheduled_time_s and stood_s < STANDING_S:
        position, speed = float(state.position_m), float(state.speed_mps)
        seen = Observation(
            time_s=float(state.time_s),
            position_m=position,
            speed_mps=speed,
            acceleration_mps2=float(state.acceleration_mps2),
            scheduled_time_s=run.scheduled_time_s,
            permitted_mps=float(permitted_speed(guard, position)),
            section=run.section,
        )
        share, memory = driver.act(memory, seen)
        command, watched, _ = supervise(guard, watched, position, speed, Command(float(share), False))
        state = step(vehicle, track, state, command, run.dt)
        moved = float(state.position_m) > nodes[-1][0]
        stood_s = 0.0 if moved else stood_s + run.dt
        if moved:
            nodes.append((float(state.position_m), float(state.speed_mps)))
            time_s = float(state.time_s)
    if len(nodes) < MOST_STANDING:
        raise InputError("the driver to be tracked does not move", field="driver", value=driver.id)
    position_m, speed_mps = np.array(nodes).T
    # the plan ends at the stop itself, a few centimetres from where the trainset stood
    position_m = position_m * float(track.length_m) / position_m[-1]
    speed_mps[1:-1] = np.maximum(speed_mps[1:-1], 0.05)
    speed_mps[-1] = 0.0
    return NominalDrive(position_m, speed_mps, time_s)
