"""Recorder of a run, period by period, and its trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray

from metropilot.physics import Forces, State, Track, Vehicle
from metropilot.sim.step import PeriodRecord
from metropilot.sim.trajectory import Trajectory, phase_names


@dataclass
class Recorder:
    """Record of a run in progress.

    Attributes:
        vehicle: True plant.
        dt: Control period, s.
        first: State at departure.
        states: State after each step.
        commands: Command of each step, after protection.
        permitted: Permitted speed at the start of each step.
        limits: Speed limit at the start of each step.
        overspeed_mps: Largest excess over the limit so far.
    """

    vehicle: Vehicle
    dt: float
    first: State
    states: list[State] = field(default_factory=list)
    commands: list[float] = field(default_factory=list)
    permitted: list[float] = field(default_factory=list)
    limits: list[float] = field(default_factory=list)
    overspeed_mps: float = 0.0

    def add(self, track: Track, after: State, record: PeriodRecord, permitted_mps: float) -> None:
        """Record the control period from the last state to ``after``."""
        before = self.states[-1] if self.states else self.first
        self.states.append(after)
        self.commands.append(float(record.command.share))
        self.permitted.append(permitted_mps)
        self.limits.append(train_limit_at(track, float(before.position_m)))
        self.overspeed_mps = max(self.overspeed_mps, float(record.overspeed_mps))

    def trajectory(self, track: Track, permitted_mps: float) -> Trajectory:
        """Trajectory of everything recorded, with a last row for the exact end.

        Args:
            track: The section at the end, with every restriction announced.
            permitted_mps: Permitted speed at the end.
        """
        rows = [self.first, *self.states]
        names = ("time_s", "position_m", "speed_mps", "traction_j", "line_j")
        return build_trajectory(
            self.vehicle,
            self.dt,
            {name: np.array([getattr(state, name) for state in rows]) for name in names},
            np.array([state.acceleration_mps2 for state in self.states]),
            Forces(*(np.array([getattr(s.forces, name) for s in self.states]) for name in Forces._fields)),
            np.array(self.commands),
            limit_mps=np.append(self.limits, train_limit_at(track, float(rows[-1].position_m))),
            permitted_mps=np.append(self.permitted, permitted_mps),
        )


def build_trajectory(
    vehicle: Vehicle,
    dt: float,
    rows: Mapping[str, ndarray],
    acceleration_mps2: ndarray,
    held: Forces,
    commands: ndarray,
    *,
    limit_mps: ndarray,
    permitted_mps: ndarray,
) -> Trajectory:
    """Build the trajectory of ``n + 1`` rows of a run of ``n`` steps; the last row is the exact end.

    Args:
        vehicle: True plant.
        dt: Control period, s.
        rows: ``time_s, position_m, speed_mps, traction_j, line_j`` at departure and after each step.
        acceleration_mps2: Acceleration of each step. Shape (n,).
        held: Forces of each step, each of shape (n,).
        commands: Command of each step, after protection. Shape (n,).
        limit_mps: Speed limit at the start of each step, and at the end. Shape (n + 1,).
        permitted_mps: Permitted speed at the same times. Shape (n + 1,).
    """
    forces = held._asdict()
    speed = rows["speed_mps"]
    last = {name: values[-1] for name, values in forces.items()}
    end = float(acceleration_mps2[-1])
    if speed[-1] <= 0:
        # At standstill no force of motion acts; the friction brake holds the trainset against the gradient.
        end = 0.0
        last |= {"traction_n": 0.0, "electric_brake_n": 0.0, "resistance_n": 0.0}
        last["friction_brake_n"] = -last["gradient_n"]
    forces = {name: np.append(values, last[name]) for name, values in forces.items()}
    accel = np.append(acceleration_mps2, end)
    wheel = forces["traction_n"] - forces["electric_brake_n"] - forces["friction_brake_n"]
    weight_n = float(vehicle.mass_kg * vehicle.gravity_mps2)
    return Trajectory(
        time_s=rows["time_s"],
        position_m=rows["position_m"],
        speed_mps=speed,
        acceleration_mps2=accel,
        jerk_mps3=np.diff(accel, prepend=0.0) / dt,
        command=np.append(commands, commands[-1]),
        **forces,
        gradient_permil=1000.0 * forces["gradient_n"] / weight_n,
        limit_mps=limit_mps,
        permitted_mps=permitted_mps,
        energy_wheel_j=rows["traction_j"],
        energy_line_j=rows["line_j"],
        phase=phase_names(speed, accel, wheel, float(vehicle.effective_mass_kg)),
    )


def train_limit_at(track: Track, position_m: float) -> float:
    """Most restrictive speed limit for the trainset's head at one position, m/s."""
    index = np.searchsorted(track.limit_from_m, position_m, side="right") - 1
    return float(track.limit_mps[max(int(index), 0)])


def train_limits_at(track: Track, position_m: ndarray) -> ndarray:
    """:func:`train_limit_at` for many positions."""
    index = np.searchsorted(track.limit_from_m, position_m, side="right") - 1
    return track.limit_mps[np.maximum(index, 0)]
