"""Worth of a second at the moments of a drive, by the optimal plan from its state there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.errors import Infeasible
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import Objective, Plan, PlanOptions, plan_arrays
from metropilot.sim import Drive, Outcome

SECOND_S = 1.0
SPACING_M = 12.5
"""Spacing of the plans; the price at departure is within 0.3 % of that with 5 m."""
SEGMENTS = 160
"""Segments of a plan at most, so that a long section takes no longer."""
LEAST_S = 2.0
"""Time left from which a moment has a price."""


class TimePrice(NamedTuple):
    """Worth of a second at a moment of a drive.

    Attributes:
        time_s: Time since departure.
        position_m: Position.
        second_w: Marginal price of time: the dual of the plan's arrival time, J/s.
        later_j: Energy that arriving a second later saves from there.
        sooner_j: Energy that arriving a second sooner costs from there; None where it is not possible.
    """

    time_s: float
    position_m: float
    second_w: float
    later_j: float
    sooner_j: float | None


def time_prices(
    drive: Drive, times_s: Float[ndarray, " moments"], objective: Objective = "wheel"
) -> tuple[TimePrice, ...]:
    """Price of a second at moments of a drive.

    At each moment the optimal plan leads from the drive's position and speed to the stop, in the time that
    the drive took from there (or, where it did not arrive, was scheduled for it), a second more and a second
    less. Like :func:`metropilot.evaluate.optimum_of` it knows the true plant and every restriction, and no
    actuation. Least energy is convex in time: ``later_j <= second_w * 1 s <= sooner_j``.

    Args:
        drive: The drive.
        times_s: Moments, s since departure.
        objective: Energy minimised.

    Returns:
        One price a moment; moments from which no plan keeps the time are left out.
    """
    t = drive.trajectory
    end_s = drive.running_time_s if drive.outcome is Outcome.ARRIVED else drive.scheduled_time_s
    vehicle, track = vehicle_arrays(drive.trainset), track_arrays(drive.section, drive.trainset)
    prices = []
    for time_s in times_s.tolist():
        at_m, speed_mps = (float(np.interp(time_s, t.time_s, row)) for row in (t.position_m, t.speed_mps))
        left_m, left_s = drive.section.length_m - at_m, end_s - time_s
        if left_s < LEAST_S or left_m < SPACING_M:
            continue
        options = PlanOptions(
            objective=objective,
            spacing_m=max(SPACING_M, left_m / SEGMENTS),
            start_m=at_m,
            start_mps=speed_mps,
        )

        def plan(change_s: float, about: Plan | None, options: PlanOptions, left_s: float) -> Plan | None:
            try:
                return plan_arrays(vehicle, track, left_s + change_s, options, about)
            except Infeasible:
                return None

        kept = plan(0.0, None, options, left_s)
        later = kept and plan(SECOND_S, kept, options, left_s)
        if kept is None or later is None:
            continue
        sooner = plan(-SECOND_S, kept, options, left_s)
        prices.append(
            TimePrice(
                time_s,
                at_m,
                kept.second_w,
                max(kept.energy_j - later.energy_j, 0.0),
                None if sooner is None else max(sooner.energy_j - kept.energy_j, 0.0),
            )
        )
    return tuple(prices)
