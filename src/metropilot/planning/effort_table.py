"""The trainset's effort and resistance per kilogram of effective mass, as fast float64 tables."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.physics import Vehicle, effort_at

STEP_MPS = 0.02


class Specific(NamedTuple):
    """Efforts of a trainset as planners use them, all per kg of effective mass (m/s^2).

    Attributes:
        speed_mps: Uniform grid from 0. Shape (G,).
        traction: Largest traction. Shape (G,).
        braking: Largest braking, electric and friction. Shape (G,).
        electric: Largest electric braking. Shape (G,).
        davis: Constant, linear and quadratic running resistance. Shape (3,).
        acceleration: Largest acceleration in service.
        deceleration: Largest deceleration in service.
        mass_kg: Effective mass.
    """

    speed_mps: Float[ndarray, " grid"]
    traction: Float[ndarray, " grid"]
    braking: Float[ndarray, " grid"]
    electric: Float[ndarray, " grid"]
    davis: Float[ndarray, "3"]
    acceleration: float
    deceleration: float
    mass_kg: float


def same_efforts(table: Specific, other: Specific) -> bool:
    """True if two tables have the same efforts and resistance per kg; limits in service may differ."""
    if table is other:
        return True
    pairs = zip(table[1:5], other[1:5], strict=True)
    return table.mass_kg == other.mass_kg and all(np.array_equal(a, b) for a, b in pairs)


def specific(vehicle: Vehicle) -> Specific:
    """Tabulate a trainset on a grid of ``STEP_MPS`` up to 20 % above its design speed."""
    mass = float(vehicle.effective_mass_kg)
    speed = np.arange(0.0, 1.2 * float(vehicle.max_speed_mps) + 2.0, STEP_MPS)
    effort = effort_at(vehicle, speed)
    return Specific(
        speed_mps=speed,
        traction=effort.traction_n / mass,
        braking=effort.brake_n / mass,
        electric=np.minimum(effort.electric_n, effort.brake_n) / mass,
        davis=np.asarray(vehicle.davis_n, np.float64) / mass,
        acceleration=float(vehicle.max_acceleration_mps2),
        deceleration=float(vehicle.max_deceleration_mps2),
        mass_kg=mass,
    )
