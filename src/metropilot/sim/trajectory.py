"""Trajectory of a run, one row a control period, and its CSV file."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Shaped
from metropilot.errors import InputError
from metropilot.physics import Forces, State, Track, Vehicle
from metropilot.sim.step import PeriodRecord

POWER, CRUISE, COASTING, BRAKE, STANDSTILL = "power", "cruise", "coast", "brake", "stand"
PHASES = (POWER, CRUISE, COASTING, BRAKE, STANDSTILL)
COAST_MPS2 = 0.01
"""Wheel force per effective mass below which a row counts as coasting."""
CRUISE_MPS2 = 0.03
"""Acceleration below which a row with effort counts as cruising."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Trajectory of a run, one row a control period; the last row is the exact end.

    Forces and acceleration hold over the step that starts at the row, and in every row
    ``effective_mass * acceleration = traction - electric_brake - friction_brake - resistance - gradient``.
    No step follows a run that ends at standstill: in its last row the friction brake balances the gradient.

    Attributes:
        time_s: Time since departure.
        position_m: Head of the trainset from the section's origin.
        speed_mps: Speed.
        acceleration_mps2: Acceleration held over the step.
        jerk_mps3: Change of acceleration from the step before over the control period (at the last row: over
            the stop itself).
        command: Command that reached the trainset, after protection.
        traction_n: Traction at the wheel.
        electric_brake_n: Electric braking force.
        friction_brake_n: Friction braking force; at standstill the force that holds the trainset.
        resistance_n: Davis, curve and tunnel resistance.
        gradient_n: Gradient force, positive uphill.
        gradient_permil: Gradient, the mean over the trainset's length.
        limit_mps: Speed limit in force for the head, held until the tail has cleared it.
        permitted_mps: Permitted speed of protection.
        energy_wheel_j: Traction energy at the wheel so far.
        energy_line_j: Net energy at the line so far.
        phase: ``power``, ``cruise``, ``coast``, ``brake`` or ``stand``.
    """

    time_s: Float[ndarray, " rows"]
    position_m: Float[ndarray, " rows"]
    speed_mps: Float[ndarray, " rows"]
    acceleration_mps2: Float[ndarray, " rows"]
    jerk_mps3: Float[ndarray, " rows"]
    command: Float[ndarray, " rows"]
    traction_n: Float[ndarray, " rows"]
    electric_brake_n: Float[ndarray, " rows"]
    friction_brake_n: Float[ndarray, " rows"]
    resistance_n: Float[ndarray, " rows"]
    gradient_n: Float[ndarray, " rows"]
    gradient_permil: Float[ndarray, " rows"]
    limit_mps: Float[ndarray, " rows"]
    permitted_mps: Float[ndarray, " rows"]
    energy_wheel_j: Float[ndarray, " rows"]
    energy_line_j: Float[ndarray, " rows"]
    phase: Shaped[ndarray, " rows"]

    def __len__(self) -> int:
        return self.time_s.size

    @property
    def duration_s(self) -> Float[ndarray, " rows"]:
        """Duration of each row's step, s; 0 for the last row."""
        return np.append(np.diff(self.time_s), 0.0)

    def balance_n(self, effective_mass_kg: float) -> Float[ndarray, " rows"]:
        """Residual of the balance of forces in each row, N; zero up to rounding."""
        forces = (
            self.traction_n
            - self.electric_brake_n
            - self.friction_brake_n
            - self.resistance_n
            - self.gradient_n
        )
        return forces - effective_mass_kg * self.acceleration_mps2

    def write(self, path: Path) -> None:
        """Write the CSV file; every number reads back to the same bits."""
        columns = [getattr(self, name).tolist() for name in COLUMNS]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows(zip(*columns, strict=True))

    @classmethod
    def read(cls, path: Path) -> Trajectory:
        """Read a CSV file written by :meth:`write`.

        Raises:
            InputError: A column is missing or a number is not one.
        """
        try:
            with path.open(newline="", encoding="utf-8") as file:
                header, *rows = list(csv.reader(file))
        except (OSError, csv.Error, ValueError) as error:
            raise InputError("cannot read the trajectory", file=path, value=str(error)) from None
        values: dict[str, Any] = dict(zip(header, zip(*rows, strict=False), strict=False))
        if missing := [name for name in COLUMNS if name not in values]:
            raise InputError("column missing", file=path, field=missing[0], allowed=", ".join(COLUMNS))
        try:
            numbers = {name: np.array(values[name], dtype=np.float64) for name in COLUMNS if name != "phase"}
        except ValueError as error:
            raise InputError("not a number", file=path, value=str(error)) from None
        return cls(**numbers, phase=np.array(values["phase"]))


COLUMNS = tuple(f.name for f in fields(Trajectory))


def phase_names(
    speed_mps: Float[ndarray, " rows"],
    acceleration_mps2: Float[ndarray, " rows"],
    wheel_n: Float[ndarray, " rows"],
    effective_mass_kg: float,
) -> Shaped[ndarray, " rows"]:
    """Name of the driving regime of each row.

    ``stand``: at standstill without acceleration. ``coast``: wheel force below 0.01 N per kg of effective
    mass. ``cruise``: effort of either sign that keeps the acceleration below 0.03 m/s² (holding a speed,
    uphill or downhill). Otherwise ``power`` or ``brake`` by the sign of the wheel force.

    Args:
        speed_mps: Speed at the row.
        acceleration_mps2: Acceleration held over the step.
        wheel_n: Traction minus brakes.
        effective_mass_kg: Mass with the rotating share.
    """
    effort = wheel_n / effective_mass_kg
    words = np.where(effort > 0, POWER, BRAKE)
    words = np.where(np.abs(acceleration_mps2) < CRUISE_MPS2, CRUISE, words)
    words = np.where(np.abs(effort) < COAST_MPS2, COASTING, words)
    return np.where((speed_mps <= 0) & (acceleration_mps2 <= 0), STANDSTILL, words)


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
    rows: Mapping[str, Float[ndarray, " rows"]],
    acceleration_mps2: Float[ndarray, " steps"],
    held: Forces,
    commands: Float[ndarray, " steps"],
    *,
    limit_mps: Float[ndarray, " rows"],
    permitted_mps: Float[ndarray, " rows"],
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


def train_limits_at(track: Track, position_m: Float[ndarray, " positions"]) -> Float[ndarray, " positions"]:
    """:func:`train_limit_at` for many positions."""
    index = np.searchsorted(track.limit_from_m, position_m, side="right") - 1
    return track.limit_mps[np.maximum(index, 0)]
