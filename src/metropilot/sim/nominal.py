"""Simulation of a driver on the nominal plant before departure, as a reference for a tracking driver."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.errors import InputError
from metropilot.physics import Command, at_rest, delay_steps, track_arrays, vehicle_arrays
from metropilot.protection import at_start, permitted_speed, protect
from metropilot.sim.bounds import declared_bounds
from metropilot.sim.driver import AbstractDriver
from metropilot.sim.outcome import OutcomeRule
from metropilot.sim.rollout import observation_of
from metropilot.sim.run import Run
from metropilot.sim.step import RunParams, RunState, control_period, first_state

RULE = OutcomeRule()
LATE_RATIO = 1.5
"""The simulation ends after this many times the scheduled running time."""
LEAST_NODES = 3
"""With fewer positions on the way the trainset has not moved."""
STANDING_S = 2.0
"""The simulation ends once the trainset has stood this long."""
LEAST_SPEED_MPS = 0.05
"""Speed between the two ends is at least this, so that the time between two nodes is finite."""


class NominalDrive(NamedTuple):
    """Simulated drive at nodes of distance.

    Attributes:
        position_m: Positions, increasing, from the origin to the stop. Shape (N,).
        speed_mps: Speed there, zero at both ends and positive between. Shape (N,).
        running_time_s: Running time, s.
    """

    position_m: Float[ndarray, " nodes"]
    speed_mps: Float[ndarray, " nodes"]
    running_time_s: float


def simulate_nominal(run: Run, driver: AbstractDriver) -> NominalDrive:
    """Simulate a run with a driver on the nominal plant, under protection.

    Args:
        run: The run.
        driver: The driver to simulate.

    Raises:
        InputError: The trainset never moves.
    """
    trainset = run.scenario.nominal(run.trainset)
    vehicle = vehicle_arrays(trainset)
    guard = protect(run.section, trainset, declared_bounds(run))
    params = RunParams(
        vehicle=vehicle,
        track=track_arrays(run.section, trainset),
        protection=guard,
        length_m=run.section.length_m,
        scheduled_s=run.scheduled_time_s,
        speed_noise_mps=0.0,
        dt=run.dt,
    )

    def decide(memory: Any, state: RunState) -> tuple[Command, Any]:  # noqa: ANN401 (a driver's memory)
        permitted = float(permitted_speed(guard, float(state.plant.position_m)))
        share, memory = driver.act(memory, observation_of(params, state, run.section, permitted))
        return Command(float(share), False), memory

    plant = at_rest(vehicle, delay_steps=delay_steps(float(vehicle.delay_s), run.dt))
    state, memory = first_state(plant, at_start(guard)), driver.init(run)
    nodes, still_s, time_s = [(0.0, 0.0)], 0.0, 0.0
    while float(state.plant.time_s) < LATE_RATIO * run.scheduled_time_s and still_s < STANDING_S:
        state, memory, _ = control_period(params, state, memory, decide, rule=RULE)
        moved = float(state.plant.position_m) > nodes[-1][0]
        still_s = 0.0 if moved else still_s + run.dt
        if moved:
            nodes.append((float(state.plant.position_m), float(state.plant.speed_mps)))
            time_s = float(state.plant.time_s)
    if len(nodes) < LEAST_NODES:
        raise InputError("the driver to be tracked does not move", field="driver", value=driver.id)
    position_m, speed_mps = np.array(nodes).T
    # the plan ends at the stop itself, a few centimetres from where the trainset stood
    position_m = position_m * float(params.track.length_m) / position_m[-1]
    speed_mps[1:-1] = np.maximum(speed_mps[1:-1], LEAST_SPEED_MPS)
    speed_mps[-1] = 0.0
    return NominalDrive(position_m, speed_mps, time_s)
