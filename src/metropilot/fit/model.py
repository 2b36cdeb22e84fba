"""Speed of a trainset over a run for many sets of parameters at once: the plant's own force balance.

The same equations as :func:`metropilot.physics.step` (acceleration held over a step, dead time, lag, jerk
limit, standstill), with what the log tells about the track read off beforehand. A test compares the two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.fit.runs import Runs
from metropilot.physics import Vehicle, curve_n

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
    mass = (vehicle.mass_kg * parameters.mass_factor)[:, None]
    inertia = (vehicle.effective_mass_kg * parameters.mass_factor)[:, None]
    a, b, c = (np.asarray(x)[:, None] for x in parameters[2:5])
    keep = parameters.keep[:, None]
    force_of = _WheelForce(vehicle, parameters)
    outside = vehicle.gravity_mps2 * runs.gradient + runs.curve_n_per_kg
    speeds = np.empty((steps + 1, sets, count))
    speed = np.array(np.broadcast_to(start_mps, (sets, count)), dtype=float)
    share, accel = given[:, 0].copy(), np.zeros((sets, count))
    room = float(vehicle.jerk_mps3) * runs.step_s
    for k in range(steps):
        speeds[k] = speed
        acting = given[:, k]
        share = acting if effort else acting + (share - acting) * keep
        before = k < runs.starts
        if before.all():
            continue
        resisting = a + speed * (b + speed * (c + runs.tunnel_n_per_mps2[k])) + mass * outside[k]
        if effort:
            wanted = (share - resisting) / inertia
        else:
            traction, brake = force_of(speed)
            wanted = (np.where(share > 0.0, share * traction, share * brake) - resisting) / inertia
            if np.isfinite(room):
                # A run that begins at speed has no acceleration yet: the first step is free.
                reach = np.where((k == runs.starts) & runs.rolling, np.inf, room)
                wanted = np.clip(wanted, accel - reach, accel + reach)
                wanted = np.clip(wanted, (-brake - resisting) / inertia, (traction - resisting) / inertia)
        held = (speed <= 0.0) & ((wanted <= 0.0) | (share <= 0.0))
        after = np.maximum(speed + wanted * runs.step_s, 0.0)
        moving = ~(held | before)
        accel = np.where(moving, wanted, 0.0)
        speed = np.where(moving, after, np.where(before, speed, 0.0))
    speeds[steps] = speed
    at = runs.row_step, slice(None), runs.row_run
    first, second = speeds[at], speeds[(runs.row_step + 1, *at[1:])]
    return (first + (second - first) * runs.row_part[:, None]).T


class _WheelForce:
    """Largest traction and service braking force at each speed, for every set of parameters.

    The curves are tabulated every centimetre per second: fetched tens of thousands of times, they would
    otherwise take most of the time of a fit.
    """

    def __init__(self, vehicle: Vehicle, parameters: PlantParameters) -> None:
        mass, brake = (np.asarray(x)[:, None] for x in parameters[:2])
        self.adhesion = vehicle.adhesion_n * mass
        weighed = bool(np.isfinite(vehicle.service_n))
        self.service = vehicle.service_n * mass * brake if weighed else np.inf
        self.brake_gain = 1.0 if weighed else brake
        speeds = np.arange(0.0, 1.5 * float(vehicle.max_speed_mps), TABLE_STEP_MPS)
        traction = curve_n(vehicle.traction_from_mps, vehicle.traction, speeds)
        brakes = curve_n(vehicle.brake_from_mps, vehicle.brake, speeds) + vehicle.friction_n
        self.table = np.stack([traction[:-1], brakes[:-1]])
        self.slope = np.stack([np.diff(traction), np.diff(brakes)])

    def __call__(self, speed: Float[ndarray, "sets runs"]) -> tuple[ndarray, ndarray]:
        place = speed * (1.0 / TABLE_STEP_MPS)
        index = np.minimum(place.astype(np.intp), self.table.shape[1] - 1)
        part = np.minimum(place - index, 1.0)
        traction, full = (
            values.take(index) + slopes.take(index) * part
            for values, slopes in zip(self.table, self.slope, strict=True)
        )
        brake = np.minimum(np.minimum(full * self.brake_gain, self.service), self.adhesion)
        return np.minimum(traction, self.adhesion), brake
