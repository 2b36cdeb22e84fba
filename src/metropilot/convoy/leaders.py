"""Recorded runs of heads of convoys for tasks and campaigns: S-curves and random speed changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.physics import (
    Command,
    at_rest,
    command_for_force,
    delay_steps,
    resistance_and_gradient,
    track_arrays,
    vehicle_arrays,
)
from metropilot.planning import Reference, ReferenceShape, peak_speed, reference_for_time
from metropilot.railway import Section, Trainset
from metropilot.sim import NEVER_ENDS, RunParams, RunState, control_period, first_state

FASTEST_MPS = 20.0
"""Highest cruising speed of a recorded head."""


class Recording(NamedTuple):
    """A run of the head, row by row; at row k the command of period k and the state before it.

    Attributes:
        command: Shape (T,).
        position_m: Shape (T,).
        speed_mps: Shape (T,).
        acceleration_mps2: Over the period before. Shape (T,).
    """

    command: Float[ndarray, " rows"]
    position_m: Float[ndarray, " rows"]
    speed_mps: Float[ndarray, " rows"]
    acceleration_mps2: Float[ndarray, " rows"]

    def pad(self, rows: int) -> Recording:
        """Extend to a number of rows at standstill with full brake, or cut to it."""
        extra = rows - self.command.size
        if extra < 0:
            return Recording(*(values[:rows] for values in self))
        last = (-1.0, self.position_m[-1], 0.0, 0.0)
        return Recording(
            *(np.concatenate([v, np.full(extra, end)]) for v, end in zip(self, last, strict=True))
        )


def record_leader(section: Section, trainset: Trainset, speeds_mps: ndarray, dt: float) -> Recording:
    """Drive a trainset along a speed profile over time, within its efforts (NumPy).

    Args:
        section: Section.
        trainset: Trainset.
        speeds_mps: Desired speed at the end of each period. Shape (T,).
        dt: Control period.
    """
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    params = RunParams(vehicle, track, None, track.length_m, 0.0, 0.0, dt)
    state = first_state(at_rest(vehicle, delay_steps=delay_steps(float(vehicle.delay_s), dt)), None)
    rows = []

    def decide(wanted: float, state: RunState) -> tuple[Command, float]:
        plant = state.plant
        x, v = float(plant.position_m), float(plant.speed_mps)
        resistance, gradient = resistance_and_gradient(vehicle, track, plant.position_m, plant.speed_mps)
        force = vehicle.effective_mass_kg * (wanted - v) / dt + resistance + gradient
        share = float(command_for_force(vehicle, plant.speed_mps, force))
        share = -0.5 if wanted <= 0.0 and v <= 0.05 else share
        rows.append((share, x, v, float(plant.acceleration_mps2)))
        return Command(np.float64(share), False), wanted

    for wanted in speeds_mps:
        state, _, _ = control_period(params, state, wanted, decide, rule=NEVER_ENDS)
    return Recording(*np.array(rows).T)


def reference_speeds(reference: Reference, dt: float) -> ndarray:
    """Speeds of a reference at the end of each period, followed by five seconds of standstill."""
    count = int(np.ceil((reference.duration_s + 5.0) / dt))
    return reference.at(dt * np.arange(1, count + 1))[1]


@dataclass(frozen=True)
class Restless:
    """Head with random target speeds, approached at random rates under a jerk limit.

    Attributes:
        fastest_mps: Highest speed.
        rate_mps2: Largest acceleration and deceleration.
        jerk_mps3: Largest change of acceleration.
        seconds: Time until it brakes to a stop.
    """

    fastest_mps: float = 18.0
    rate_mps2: float = 0.65
    jerk_mps3: float = 0.7
    seconds: float = 80.0


def restless_speeds(habits: Restless, random: np.random.Generator, dt: float) -> ndarray:
    """Draw the speeds of a restless head at the end of each period, until standstill."""
    speed, rate, target, until = 0.0, 0.0, 0.6 * habits.fastest_mps, 15.0
    most, found, time = habits.rate_mps2, [], 0.0
    while time < habits.seconds or speed > 0.0:
        if time >= habits.seconds:
            target, most = 0.0, habits.rate_mps2
        elif time >= until:
            target, most = (
                random.uniform(2.0, habits.fastest_mps),
                random.uniform(0.2, 1.0) * habits.rate_mps2,
            )
            until = time + random.uniform(4.0, 15.0)
        room = target - speed
        soft = np.sign(room) * np.sqrt(1.2 * habits.jerk_mps3 * abs(room))
        wanted = np.clip(soft, -most, most)
        rate = float(np.clip(wanted, rate - habits.jerk_mps3 * dt, rate + habits.jerk_mps3 * dt))
        speed = max(speed + rate * dt, 0.0)
        if target == 0.0 and speed < 0.06:
            speed = 0.0
        found.append(speed)
        time += dt
    return np.array(found)


def recordings(
    section: Section, trainset: Trainset, dt: float, count: int, seed: int, rows: int = 1200
) -> list[Recording]:
    """Record heads: a third are S-curves of different running times, the rest restless heads.

    Args:
        section: Section.
        trainset: Trainset of the head, with its limits.
        dt: Control period.
        count: Number of heads.
        seed: Seed of all random draws.
        rows: Rows of each.
    """
    random, found = np.random.default_rng(seed), []
    for k in range(count):
        if k % 3 == 0:
            shape = ReferenceShape(
                random.uniform(0.6, 0.8), random.uniform(0.5, 0.68), random.uniform(0.3, 0.8)
            )
            length = section.length_m
            shortest_s = shape.time_s(length, min(FASTEST_MPS, peak_speed(length, shape)))
            time_s = max(length / random.uniform(9.5, 12.0), shortest_s)
            speeds = reference_speeds(reference_for_time(length, time_s, shape, FASTEST_MPS), dt)
        else:
            habits = Restless(random.uniform(8.0, 20.0), random.uniform(0.4, 0.68), random.uniform(0.4, 1.0))
            speeds = restless_speeds(habits, random, dt)
        found.append(record_leader(section, trainset, speeds, dt).pad(rows))
    return found
