"""Speed of a trainset over a run for many sets of parameters at once, by the force balance of the plant.

Efforts, jerk limit, resistance and standstill are the functions of :mod:`metropilot.physics`. Dead time and
lag are estimated numbers here, and the track is what the log tells of it, read off beforehand; a test
compares the result with :func:`metropilot.physics.step`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.fit.runs import Runs
from metropilot.physics import (
    Effort,
    Vehicle,
    curve_n,
    davis_n,
    limit_effort,
    stays_at_rest,
    wheel_force,
)

TABLE_STEP_MPS = 0.01
"""Step of the tables of the effort curves."""


class PlantParameters(NamedTuple):
    """Parameters of the plant that are estimated, one set a row. All of shape (sets,).

    Attributes:
        mass_factor: True over nominal mass; brakes are load-compensated.
        brake_factor: True over nominal service braking force.
        davis_a_n: Constant term of the running resistance, N.
        davis_b_n_per_mps: Linear term, N/(m/s).
        davis_c_n_per_mps2: Quadratic term, N/(m/s)^2.
        delay_s: Dead time.
        keep: Share of the old effort that remains after a step of lag.
    """

    mass_factor: Float[ndarray, " sets"]
    brake_factor: Float[ndarray, " sets"]
    davis_a_n: Float[ndarray, " sets"]
    davis_b_n_per_mps: Float[ndarray, " sets"]
    davis_c_n_per_mps2: Float[ndarray, " sets"]
    delay_s: Float[ndarray, " sets"]
    keep: Float[ndarray, " sets"]


def simulate_speeds(
    vehicle: Vehicle,
    runs: Runs,
    parameters: PlantParameters,
    start_mps: Float[ndarray, "sets runs"],
    *,
    effort: bool = False,
) -> Float[ndarray, "sets samples"]:
    """Simulate the speed at every sample.

    Args:
        vehicle: Nominal trainset.
        runs: The runs.
        parameters: Sets of parameters.
        start_mps: Speed at the start of each run.
        effort: The input is the wheel force, not a command: dead time, lag and brakes have no part.
    """
    steps, count = runs.gradient.shape
    sets = parameters.delay_s.size
    delays, which = np.unique(parameters.delay_s, return_inverse=True)
    given = np.stack([runs.input_over(0.0 if effort else float(delay)) for delay in delays])[which]
    plants, effort_of = _true_plants(vehicle, parameters), _EffortTable(vehicle, parameters)
    rolls_off = np.isin(np.arange(steps), runs.starts[runs.rolling])
    keep = parameters.keep[:, None]
    outside = vehicle.gravity_mps2 * runs.gradient + runs.curve_n_per_kg
    speeds = np.empty((steps + 1, sets, count))
    speed = np.array(np.broadcast_to(start_mps, (sets, count)), dtype=float)
    share, accel = given[:, 0].copy(), np.zeros((sets, count))
    for k in range(steps):
        speeds[k] = speed
        acting = given[:, k]
        share = acting if effort else acting + (share - acting) * keep
        before = k < runs.starts
        if before.all():
            continue
        resisting = davis_n(plants, speed) + runs.tunnel_n_per_mps2[k] * speed * speed
        resisting = resisting + plants.mass_kg * outside[k]
        force = share
        if not effort:
            plant = plants
            if rolls_off[k]:
                # A run that begins at speed has no acceleration yet: its first step is free.
                first = (k == runs.starts) & runs.rolling
                plant = plants._replace(jerk_mps3=np.where(first, np.inf, vehicle.jerk_mps3))
            force = wheel_force(plant, accel, effort_of(plant, speed), share, False, resisting, runs.step_s)
        wanted = (force - resisting) / plants.effective_mass_kg
        moving = ~(stays_at_rest(speed, wanted, share) | before)
        after = np.maximum(speed + wanted * runs.step_s, 0.0)
        accel = np.where(moving, wanted, 0.0)
        speed = np.where(moving, after, np.where(before, speed, 0.0))
    speeds[steps] = speed
    at = runs.row_step, slice(None), runs.row_run
    first, second = speeds[at], speeds[(runs.row_step + 1, *at[1:])]
    return (first + (second - first) * runs.row_part[:, None]).T


def _true_plants(vehicle: Vehicle, parameters: PlantParameters) -> Vehicle:
    """The plant of every set of parameters; its numbers have the shape (sets, 1)."""
    mass, brake = (np.asarray(x)[:, None] for x in parameters[:2])
    weighed = bool(np.isfinite(vehicle.service_n))
    return vehicle._replace(
        mass_kg=vehicle.mass_kg * mass,
        effective_mass_kg=vehicle.effective_mass_kg * mass,
        adhesion_n=vehicle.adhesion_n * mass,
        service_n=vehicle.service_n * mass * brake if weighed else vehicle.service_n,
        friction_n=vehicle.friction_n * (1.0 if weighed else brake),
        davis_n=np.stack([np.asarray(x)[:, None] for x in parameters[2:5]]),
    )


class _EffortTable:
    """Forces available at each speed, the curves tabulated every centimetre per second.

    They are looked up tens of thousands of times, and would otherwise take most of the time of a fit.
    """

    def __init__(self, vehicle: Vehicle, parameters: PlantParameters) -> None:
        weighed = bool(np.isfinite(vehicle.service_n))
        self.brake_gain = 1.0 if weighed else np.asarray(parameters.brake_factor)[:, None]
        speeds = np.arange(0.0, 1.5 * float(vehicle.max_speed_mps), TABLE_STEP_MPS)
        traction = curve_n(vehicle.traction_from_mps, vehicle.traction, speeds)
        electric = curve_n(vehicle.brake_from_mps, vehicle.brake, speeds)
        self.table = np.stack([traction[:-1], electric[:-1]])
        self.slope = np.stack([np.diff(traction), np.diff(electric)])

    def __call__(self, plants: Vehicle, speed: Float[ndarray, "sets runs"]) -> Effort:
        place = speed * (1.0 / TABLE_STEP_MPS)
        index = np.minimum(place.astype(np.intp), self.table.shape[1] - 1)
        part = np.minimum(place - index, 1.0)
        traction, electric = (
            values.take(index) + slopes.take(index) * part
            for values, slopes in zip(self.table, self.slope, strict=True)
        )
        return limit_effort(plants, traction, electric * self.brake_gain)
