"""A drive of the host loop beside the optimum for the running time it achieved, and tables of such drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from metropilot.drivers import DRIVERS
from metropilot.planning import PlanOptions, optimal_plan
from metropilot.sim import Run, drive

SPACING_M = 5.0


@dataclass(frozen=True)
class Result:
    """Result of a drive; gaps in per cent, ``floor`` is the optimum that knows the jerk limit."""

    case: Any
    outcome: str
    scheduled_s: float
    time_error_s: float
    stop_error_m: float
    gap: float
    floor: float
    overspeed_mps: float
    interventions: int
    decision_us: float


def beside_optimum(case: object, run: Run, driver: str, *, floor: bool = False) -> Result:
    """Drive a run and compare it with the optimum for the running time it achieved.

    Args:
        case: What the result is kept under.
        run: The run.
        driver: Id of the driver.
        floor: Also find what the jerk limit alone costs.
    """
    section = run.section
    done = drive(run, DRIVERS.make(driver))
    rows = done.trajectory
    best = optimal_plan(section, done.trainset, done.running_time_s, PlanOptions(spacing_m=SPACING_M))
    least = 0.0
    if floor:
        jerk = run.trainset.actuation.jerk_limit_mps3
        options = PlanOptions(jerk_mps3=jerk, late_w=500.0, spacing_m=SPACING_M)
        limited = optimal_plan(section, done.trainset, done.running_time_s, options)
        least = 100.0 * (limited.energy_wheel_j / best.bound_j - 1.0)
    return Result(
        case=case,
        outcome=done.outcome.value,
        scheduled_s=run.scheduled_time_s,
        time_error_s=done.running_time_s - run.scheduled_time_s,
        stop_error_m=float(rows.position_m[-1]) - section.length_m,
        gap=100.0 * (float(rows.energy_wheel_j[-1]) / best.bound_j - 1.0),
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
