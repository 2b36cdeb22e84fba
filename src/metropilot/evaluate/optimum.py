"""Optimal plan of a run in hindsight, and what the actuation of its trainset leaves of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.errors import Infeasible
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import (
    Attainable,
    Objective,
    Plan,
    PlanOptions,
    attainable_plan,
    fastest_time,
    minimum_running_time,
    optimal_plan,
)
from metropilot.protection import permitted_speed, protect, usable_deceleration
from metropilot.railway import Section, Trainset
from metropilot.sim import Drive, Outcome, Run, declared_bounds

OPTIMUM_TOLERANCE = 1e-4
OPTIMUM_SPACING_M = 5.0
CAP_SPACING_M = 1.0


class Optimum(NamedTuple):
    """The plans a drive is compared with.

    Attributes:
        plan: The optimal plan of an ideal trainset.
        minimum_time_s: Running time of the flat-out run under the same limits.
        attainable: The plan that knows jerk limit, dead time, lag and permitted speed; None if the run did
            not arrive, or the actuation does not allow its running time.
        protected_time_s: Least running time under protection (:func:`protected_running_time`); None where
            there is none, or it was not asked for.
    """

    plan: Plan
    minimum_time_s: float
    attainable: Attainable | None = None
    protected_time_s: float | None = None


class DrivingLimits(NamedTuple):
    """Limits of a drive beyond those of line and trainset.

    Attributes:
        position_m: Positions. Shape (N,).
        permitted_mps: Permitted speed of protection there. Shape (N,).
        error_mps: Largest error of the measured speed.
        deceleration_mps2: Largest deceleration that protection leaves before the stop.
        dt: Control period, s.
    """

    position_m: Float[ndarray, " grid"]
    permitted_mps: Float[ndarray, " grid"]
    error_mps: float
    deceleration_mps2: float
    dt: float


def driving_limits(run: Run, section: Section) -> DrivingLimits:
    """Permitted speed and deceleration under a run's protection, and its control period.

    Args:
        run: The run.
        section: The section with every restriction announced.
    """
    trainset, bounds = run.disturbance.nominal(run.trainset), declared_bounds(run)
    guard = protect(section, trainset, bounds)
    at = np.arange(0.0, section.length_m + CAP_SPACING_M, CAP_SPACING_M)
    usable = usable_deceleration(section, trainset, bounds)
    return DrivingLimits(at, permitted_speed(guard, at), float(guard.rates.speed_error_mps), usable, run.dt)


def protected_running_time(section: Section, trainset: Trainset, limits: DrivingLimits) -> float | None:
    """Least running time under the permitted speed, with the deceleration that protection leaves, s.

    No drive that keeps the permitted speed takes less; dead time, lag and jerk limit are not in it.

    Args:
        section: The section with every restriction announced.
        trainset: True plant.
        limits: Permitted speed and deceleration.

    Returns:
        None where the trainset cannot cover the section so.
    """
    vehicle = vehicle_arrays(trainset)
    most = min(float(vehicle.max_deceleration_mps2), limits.deceleration_mps2)
    options = PlanOptions(cap_m=limits.position_m, cap_mps=limits.permitted_mps)
    vehicle = vehicle._replace(max_deceleration_mps2=np.float64(most))
    try:
        return fastest_time(vehicle, track_arrays(section, trainset), options)
    except Infeasible:
        return None


def optimum_of(drive: Drive, objective: Objective = "wheel") -> Optimum | None:
    """The optimal plan for the running time the drive achieved, under the same limits.

    It is computed in hindsight, for the true plant (mass and resistance of the disturbance) on the section
    with every restriction that was announced. Acceleration and deceleration limits hold;
    delay, lag and jerk limit do not, so the plan bounds every drive from below. A drive that did not arrive
    is compared with the plan for its scheduled time. ``attainable`` is the second figure, which knows delay,
    lag, jerk limit and permitted speed: see :func:`attainable_of`.

    Returns:
        None where no plan exists, not even at the minimum running time.
    """
    options = PlanOptions(objective=objective, spacing_m=OPTIMUM_SPACING_M)
    arrived = drive.outcome is Outcome.ARRIVED
    try:
        fastest = minimum_running_time(drive.section, drive.trainset)
        wanted = drive.running_time_s if arrived else drive.scheduled_time_s
        wanted = max(wanted, fastest * (1.0 + OPTIMUM_TOLERANCE))
        plan = optimal_plan(drive.section, drive.trainset, wanted, options)
    except Infeasible:
        return None
    limits = driving_limits(drive.run, drive.section)
    least = protected_running_time(drive.section, drive.trainset, limits)
    if not arrived:
        return Optimum(plan, fastest, protected_time_s=least)
    found = attainable_of(drive.section, drive.trainset, wanted, limits, plan, objective)
    return Optimum(plan, fastest, found, least)


def attainable_of(
    section: Section,
    trainset: Trainset,
    time_s: float,
    limits: DrivingLimits,
    ideal: Plan,
    objective: Objective = "wheel",
) -> Attainable | None:
    """Energy that the trainset needs for a running time with its actuation and under protection.

    Args:
        section: The section with every restriction announced.
        trainset: True plant.
        time_s: Running time, s.
        limits: Permitted speed and control period.
        ideal: The optimal plan for the same time.
        objective: Energy minimised.

    Returns:
        None where the actuation does not allow the running time.
    """
    options = PlanOptions(
        objective=objective,
        spacing_m=OPTIMUM_SPACING_M,
        cap_m=limits.position_m,
        cap_mps=limits.permitted_mps,
    )
    return attainable_plan(
        vehicle_arrays(trainset),
        track_arrays(section, trainset),
        time_s,
        options,
        limits.dt,
        ideal,
        limits.error_mps,
        limits.deceleration_mps2,
    )
