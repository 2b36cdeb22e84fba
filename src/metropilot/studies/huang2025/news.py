"""What was still possible when the news came: earliest arrival, and least energy for the rest of the run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from metropilot.errors import Infeasible
from metropilot.planning import PlanOptions, optimal_plan
from metropilot.sim import Drive
from metropilot.studies.huang2025.drives import SPACING_M, EvaluatedRun
from metropilot.studies.huang2025.setting import comfortable
from metropilot.studies.report import ReportRow

HURRY_W = 1e5
"""A second costs so much that the plan is the fastest there is."""
EARLIEST = "earliest arrival possible from the news on"
LEFT = "above the least energy still possible from the news on"


def state_at(one: Drive, time_s: float) -> tuple[PlanOptions, float]:
    """Where a drive was at a time, as the beginning of a plan, and the wheel energy used by then, J."""
    t = one.trajectory
    place, speed, used = (
        float(np.interp(time_s, t.time_s, values)) for values in (t.position_m, t.speed_mps, t.energy_wheel_j)
    )
    return PlanOptions(spacing_m=SPACING_M, start_m=place, start_mps=speed), used


def earliest_s(one: Drive, driver: str, told_s: float) -> float:
    """Earliest arrival from where the drive was when told, under the driver's comfort limits, s."""
    options, _ = state_at(one, told_s)
    hurry = replace(options, late_w=HURRY_W)
    plan = optimal_plan(one.section, comfortable(driver, one.trainset), 1.0, hurry)
    return told_s + plan.running_time_s


def above_left_percent(one: Drive, driver: str, told_s: float) -> float:
    """Energy of the whole drive above what it had used when told and the least for the rest, %."""
    options, used = state_at(one, told_s)
    gentle, left = comfortable(driver, one.trainset), one.running_time_s - told_s
    try:
        rest = optimal_plan(one.section, gentle, left, options).energy_wheel_j
    except Infeasible:
        return float("nan")
    return 100.0 * (float(one.trajectory.energy_wheel_j[-1]) / (used + rest) - 1.0)


def news_rows(found: EvaluatedRun) -> Iterator[ReportRow]:
    """Rows of a case with news; none of one without."""
    case, driver, told = found.case, found.driver, found.case.told_s
    if told is None:
        return
    place = (case.table, case.name, driver)
    yield ReportRow(*place, EARLIEST, "s").measured([earliest_s(one, driver, told) for one in found.drives])
    above = [above_left_percent(one, driver, told) for one in found.drives]
    if np.isfinite(above).all():
        yield ReportRow(*place, LEFT, "%").measured(above)
