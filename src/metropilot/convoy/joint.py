"""The joint optimum of a convoy: the least energy that its trainsets need together for a running time."""

from __future__ import annotations

from dataclasses import replace

from metropilot.convoy.model import Convoy
from metropilot.errors import Infeasible
from metropilot.evaluate import OPTIMUM_SPACING_M, OPTIMUM_TOLERANCE
from metropilot.planning import Objective, Plan, PlanOptions, joint_minimum_running_time, joint_plan


def joint_optimum(convoy: Convoy, running_time_s: float, objective: Objective = "wheel") -> Plan | None:
    """The plan of least energy, summed over all trainsets, that keeps the desired gaps throughout.

    It is made in hindsight, like the optimum of one trainset: for the true plants (mass and resistance of the
    disturbances), on the section with every restriction, without delay, lag and jerk limit. Brakes are no
    stronger than the rates they are controlled to. No convoy that keeps its gaps needs less energy for
    the running time than its ``bound_j``; ``trainset_energy_j`` has the part of each trainset.

    Args:
        convoy: The convoy; for a run, ``ConvoyDrive.convoy`` with the restrictions announced on the way.
        running_time_s: Running time of the run, until the last standstill.
        objective: Energy minimised.

    Returns:
        None where there is no such plan: the convoy couples or uncouples on the move, or it stalls.
    """
    if convoy.first_gap_m != convoy.gap_m or convoy.uncouple_at_m < convoy.section.length_m:
        return None
    plants = (convoy.disturbance(k).true_plant(each) for k, each in enumerate(convoy.trainsets))
    trainsets = tuple(
        replace(plant, max_deceleration_mps2=min(plant.max_deceleration_mps2, rate))
        for plant, rate in zip(plants, convoy.rates_mps2, strict=True)
    )
    at = tuple(-start for start in convoy.starts_m)
    options = PlanOptions(objective=objective, spacing_m=OPTIMUM_SPACING_M)
    fastest = joint_minimum_running_time(convoy.section, trainsets, at)
    try:
        wanted = max(running_time_s, fastest * (1.0 + OPTIMUM_TOLERANCE))
        return joint_plan(convoy.section, trainsets, at, wanted, options)
    except Infeasible:
        return None
