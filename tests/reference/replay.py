"""Integrate the recorded forces of a trajectory again, with nothing but Newton's second law."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

FORCES = ("traction_n", "electric_brake_n", "friction_brake_n", "resistance_n", "gradient_n")


@dataclass(frozen=True)
class Replayed:
    """A trajectory integrated again from its recorded times and forces, one entry a row."""

    time_s: list[float]
    position_m: list[float]
    speed_mps: list[float]
    energy_wheel_j: list[float]
    energy_electric_j: list[float]


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a ``trajectory.csv``."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def replay(rows: Iterable[Mapping[str, str | float]], effective_mass_kg: float) -> Replayed:
    """Integrate ``effective_mass * acceleration = traction - brakes - resistance - gradient`` over the rows.

    Forces are held from each row to the next; position and speed start as in the first row.
    """
    table = [{k: float(row[k]) for k in ("time_s", "position_m", "speed_mps", *FORCES)} for row in rows]
    x, v, wheel, electric = table[0]["position_m"], table[0]["speed_mps"], 0.0, 0.0
    done = Replayed([table[0]["time_s"]], [x], [v], [wheel], [electric])
    for row, after in pairwise(table):
        dt = after["time_s"] - row["time_s"]
        traction, *holding = (row[name] for name in FORCES)
        acceleration = (traction - sum(holding)) / effective_mass_kg
        moved = v * dt + 0.5 * acceleration * dt**2
        x, v = x + moved, v + acceleration * dt
        wheel, electric = wheel + traction * moved, electric + row["electric_brake_n"] * moved
        for column, value in zip(
            (done.time_s, done.position_m, done.speed_mps, done.energy_wheel_j, done.energy_electric_j),
            (after["time_s"], x, v, wheel, electric),
            strict=True,
        ):
            column.append(value)
    return done
