"""Trajectory of a run, one row a control period, and its CSV file."""

from __future__ import annotations

import csv
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from metropilot.errors import InputError

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
