"""Optimal plan of a run in hindsight."""

from __future__ import annotations

from typing import NamedTuple

from metropilot.errors import Infeasible
from metropilot.planning import Objective, Plan, PlanOptions, minimum_running_time, optimal_plan
from metropilot.sim import Drive, Outcome

OPTIMUM_TOLERANCE = 1e-4
OPTIMUM_SPACING_M = 5.0


class Optimum(NamedTuple):
    """The plan a drive is compared with.

    Attributes:
        plan: The optimal plan.
        minimum_time_s: Running time of the flat-out run under the same limits.
    """

    plan: Plan
    minimum_time_s: float


def optimum_of(drive: Drive, objective: Objective = "wheel") -> Optimum | None:
    """The optimal plan for the running time the drive achieved, under the same limits.

    It is computed in hindsight, for the true plant (mass and resistance of the disturbance) on the section
    with every restriction that was announced. Acceleration and deceleration limits hold;
    delay, lag and jerk limit do not, so the plan bounds every drive from below. A drive that did not arrive
    is compared with the plan for its scheduled time.

    Returns:
        None where no plan exists, not even at the minimum running time.
    """
    options = PlanOptions(objective=objective, spacing_m=OPTIMUM_SPACING_M)
    try:
        fastest = minimum_running_time(drive.section, drive.trainset)
        wanted = drive.running_time_s if drive.outcome is Outcome.ARRIVED else drive.scheduled_time_s
        wanted = max(wanted, fastest * (1.0 + OPTIMUM_TOLERANCE))
        return Optimum(optimal_plan(drive.section, drive.trainset, wanted, options), fastest)
    except Infeasible:
        return None
