"""The joint optimum of a convoy: the least energy that its trainsets need together for a running time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metropilot.convoy.model import Convoy
from metropilot.errors import Infeasible, SolverError
from metropilot.evaluate import OPTIMUM_SPACING_M, OPTIMUM_TOLERANCE
from metropilot.planning import Plan, PlanOptions, joint_minimum_running_time, joint_plan

SERVICE_SPACING_M = 25.0
LATE_S, LATE_W = 0.5, 500.0
"""A plan later than this is none for the running time; price of a second until then, W/kg."""


def joint_optimum(convoy: Convoy, running_time_s: float) -> Plan | None:
    """The plan of least energy, summed over all trainsets, that keeps the desired gaps throughout.

    It is made in hindsight, like the optimum of one trainset: for the true plants (mass and resistance of the
    disturbances), on the section with every restriction, without delay, lag and jerk limit. Brakes are no
    stronger than the rates they are controlled to. No convoy that keeps its gaps needs less energy for
    the running time than its ``bound_j``; ``trainset_energy_j`` has the part of each trainset.

    Args:
        convoy: The convoy; for a run, ``ConvoyDrive.convoy`` with the restrictions announced on the way.
        running_time_s: Running time of the run, until the last standstill.

    Returns:
        None where there is no such plan: the convoy couples or uncouples on the move, or it stalls.
    """
    return _plan(convoy, running_time_s, PlanOptions(spacing_m=OPTIMUM_SPACING_M))


def joint_attainable(convoy: Convoy, running_time_s: float) -> Plan | None:
    """The plan of least energy within the service limits of the convoy: what its drivers can attain.

    Beside the limits of :func:`joint_optimum` it keeps the acceleration and the deceleration that the head of
    a coupled convoy uses in service, and the lowest jerk limit. It is no bound; its distance from the optimum
    is what the rules of the convoy cost.

    Args:
        convoy: As for :func:`joint_optimum`.
        running_time_s: Likewise.

    Returns:
        None where the service limits do not allow the running time, or there is no joint optimum.
    """
    head = convoy.leader()[1]
    jerk = min(each.actuation.jerk_limit_mps3 for each in convoy.trainsets)
    service = PlanOptions(
        spacing_m=SERVICE_SPACING_M,
        acceleration_mps2=head.max_acceleration_mps2,
        deceleration_mps2=head.max_deceleration_mps2,
        jerk_mps3=jerk if np.isfinite(jerk) else None,
        late_w=LATE_W,
    )
    plan = _plan(convoy, running_time_s, service)
    return None if plan is None or plan.running_time_s > running_time_s + LATE_S else plan


def _plan(convoy: Convoy, running_time_s: float, options: PlanOptions) -> Plan | None:
    """The joint plan of the true plants that keep the desired gaps."""
    if convoy.first_gap_m != convoy.gap_m or convoy.uncouple_at_m < convoy.section.length_m:
        return None
    plants = (convoy.disturbance(k).true_plant(each) for k, each in enumerate(convoy.trainsets))
    trainsets = tuple(
        replace(plant, max_deceleration_mps2=min(plant.max_deceleration_mps2, rate))
        for plant, rate in zip(plants, convoy.rates_mps2, strict=True)
    )
    at = tuple(-start for start in convoy.starts_m)
    fastest = joint_minimum_running_time(convoy.section, trainsets, at)
    try:
        wanted = max(running_time_s, fastest * (1.0 + OPTIMUM_TOLERANCE))
        return joint_plan(convoy.section, trainsets, at, wanted, options)
    except (Infeasible, SolverError):
        return None
