"""Two drives of one section against each other, over distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.errors import InputError
from metropilot.sim import STOP_TOLERANCE_M, Trajectory

SPACING_M = 5.0
"""Distance between the positions that are compared."""
MOST_POINTS = 2000
"""Positions at most; a longer section is compared at a wider spacing."""


@dataclass(frozen=True, eq=False)
class RunDifference:
    """Two drives at the same positions, as far as both came.

    Attributes:
        position_m: Head of the trainset from the section's origin.
        speed_mps: Speed of the first and of the second drive.
        time_s: Time since departure of each.
        energy_wheel_j: Traction energy at the wheel so far of each.
        energy_line_j: Net energy at the line so far of each.
    """

    position_m: Float[ndarray, " points"]
    speed_mps: Float[ndarray, "2 points"]
    time_s: Float[ndarray, "2 points"]
    energy_wheel_j: Float[ndarray, "2 points"]
    energy_line_j: Float[ndarray, "2 points"]


def difference_of(first: Trajectory, second: Trajectory) -> RunDifference:
    """Compare two drives of one section over distance.

    The acceleration is constant within a control period: the square of the speed is linear in distance.

    Raises:
        InputError: One of them did not move.
    """
    end_m = min(float(each.position_m[-1]) for each in (first, second))
    if end_m < STOP_TOLERANCE_M:
        raise InputError(
            "one of the runs did not move", field="position_m", value=end_m, unit="m", allowed="> 0.3 m"
        )
    points = min(int(np.ceil(end_m / SPACING_M)) + 1, MOST_POINTS)
    at_m = np.linspace(0.0, end_m, points)

    def sample(name: str) -> Float[ndarray, "2 points"]:
        return np.stack([np.interp(at_m, t.position_m, getattr(t, name)) for t in (first, second)])

    squares = [np.interp(at_m, t.position_m, t.speed_mps**2) for t in (first, second)]
    return RunDifference(
        position_m=at_m,
        speed_mps=np.sqrt(np.stack(squares)),
        time_s=sample("time_s"),
        energy_wheel_j=sample("energy_wheel_j"),
        energy_line_j=sample("energy_line_j"),
    )
