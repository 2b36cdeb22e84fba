"""A drive of the host loop beside the optimum for the running time it achieved, and tables of such drives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from metropilot.drivers import DRIVERS, PolicyOptions
from metropilot.evaluate import optimum_of
from metropilot.planning import PlanOptions, optimal_plan
from metropilot.sim import Run, drive

SPACING_M = 5.0


@dataclass(frozen=True)
class Result:
    """Result of a drive; gaps in per cent, not a number where there is nothing to compare with.

    Attributes:
        case: What it is kept under.
        outcome: Outcome of the run.
        scheduled_s: Scheduled running time.
        time_error_s: Running time beyond it.
        stop_error_m: Position beyond the stop.
        gap: Energy above the bound of the optimum.
        excess: Energy above the attainable optimum, which knows jerk limit, dead time, lag and protection.
        floor: The optimum that knows the jerk limit alone, above the bound of the optimum.
        overspeed_mps: Largest speed above a limit.
        interventions: Of protection.
        decision_us: Median time of a decision.
    """

    case: Any
    outcome: str
    scheduled_s: float
    time_error_s: float
    stop_error_m: float
    gap: float
    excess: float
    floor: float
    overspeed_mps: float
    interventions: int
    decision_us: float


def beside_optimum(case: object, run: Run, driver: str, *, floor: bool = False, policy: str = "") -> Result:
    """Drive a run and compare it with the optimum for the running time it achieved.

    Args:
        case: What the result is kept under.
        run: The run.
        driver: Id of the driver.
        floor: Also find what the jerk limit alone costs.
        policy: File or run of the policy of a learned driver instead of the shipped one.
    """
    section = run.section
    made = DRIVERS.make(driver, options=PolicyOptions(policy)) if policy else DRIVERS.make(driver)
    done = drive(run, made)
    rows, used_j = done.trajectory, float(done.trajectory.energy_wheel_j[-1])
    optimum = optimum_of(done)
    gap = excess = least = math.nan
    if optimum is not None:
        gap = 100.0 * (used_j / optimum.plan.bound_j - 1.0)
        if optimum.attainable is not None:
            excess = 100.0 * (used_j / optimum.attainable.energy_j - 1.0)
    if floor and optimum is not None:
        jerk = run.trainset.actuation.jerk_limit_mps3
        options = PlanOptions(jerk_mps3=jerk, late_w=500.0, spacing_m=SPACING_M)
        limited = optimal_plan(section, done.trainset, done.running_time_s, options)
        least = 100.0 * (limited.energy_wheel_j / optimum.plan.bound_j - 1.0)
    return Result(
        case=case,
        outcome=done.outcome.value,
        scheduled_s=run.scheduled_time_s,
        time_error_s=done.running_time_s - run.scheduled_time_s,
        stop_error_m=float(rows.position_m[-1]) - section.length_m,
        gap=gap,
        excess=excess,
        floor=least,
        overspeed_mps=done.max_overspeed_mps,
        interventions=done.interventions,
        decision_us=float(np.median(done.decision_us)),
    )


def table(heads: tuple[str, ...], lines: list[list[str]], words: int = 1) -> str:
    """A table in Markdown, its first columns words."""
    rule = "|" + "---|" * words + "---:|" * (len(heads) - words)
    first, *rest = ["| " + " | ".join(line) + " |" for line in (list(heads), *lines)]
    return "\n".join([first, rule, *rest])


def worst(values: list[float]) -> float:
    """The value farthest from zero."""
    return max(values, key=abs)
