"""Drives of the cases, and their numbers beside the paper's and the optimum's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from metropilot import evaluate
from metropilot.errors import Infeasible
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.sim import AbstractDriver, Drive, drive
from metropilot.studies.huang2025 import setting
from metropilot.studies.report import ReportRow, make_row
from metropilot.units import J_PER_KWH

SPACING_M = 5.0
SEARCHES, SAME_S = 6, 0.2
"""Tries of the search for a scheduled time, and the difference of arrival that counts as none: one period."""
ABOVE, ABOVE_ATTAINABLE = "above the optimum", "above the attainable: actuation and protection known"


@dataclass(frozen=True, eq=False)
class EvaluatedRun:
    """Drives of one case by one driver, one per seed.

    Attributes:
        case: The case.
        driver: Driver id.
        drives: Drives, one per seed.
    """

    case: setting.PublishedCase
    driver: str
    drives: Sequence[Drive]

    @property
    def indices(self) -> list[evaluate.Indices]:
        """The five indices of each drive."""
        return [evaluate.indices_of(one) for one in self.drives]

    @property
    def kpis(self) -> list[evaluate.Kpis]:
        """KPIs of each drive, without an optimum."""
        return [evaluate.kpis_of(one, None) for one in self.drives]


def make_drivers(driver: str, policies: Mapping[str, Sequence[Path]], seeds: range) -> list[AbstractDriver]:
    """Make one driver per seed: manual drives differ by seed, learned ones by policy, an expert has one."""
    if driver in policies:
        return [evaluate.make_driver(driver, {"policy": str(path)}) for path in policies[driver]]
    if driver == setting.BRISK_EITOE:
        return [evaluate.make_driver(setting.EITOE, {"start_mps2": setting.GENTLE_MPS2[setting.EITOP]})]
    return [evaluate.make_driver(driver) for _ in (seeds if driver == setting.MANUAL else range(1))]


def drive_case(
    case: setting.PublishedCase, driver: str, policies: Mapping[str, Sequence[Path]], seeds: range
) -> EvaluatedRun:
    """Drive a case with every seed or policy."""
    who = make_drivers(driver, policies, seeds)
    return EvaluatedRun(
        case, driver, [drive(setting.run_of(case, seed), one) for seed, one in enumerate(who)]
    )


def drive_at_arrival(
    case: setting.PublishedCase,
    arrival_s: float,
    start_mps2: float = setting.GENTLE_MPS2[setting.EITOP],
    name: str = setting.EQUAL_EITOE,
) -> EvaluatedRun:
    """Drive a case by the expert so that it arrives when EITOP does (secant search).

    Args:
        case: A case without a timetable update.
        arrival_s: Running time of EITOP.
        start_mps2: Acceleration limit of the expert; EITOP's if not given.
        name: Driver id of the run.
    """
    expert = evaluate.make_driver(setting.EITOE, {"start_mps2": start_mps2})

    def drive_for(scheduled_s: float) -> Drive:
        return drive(setting.run_of(replace(case, scheduled_s=scheduled_s)), expert)

    found, scheduled = drive_for(case.scheduled_s), case.scheduled_s
    for _ in range(SEARCHES):
        missing = arrival_s - found.running_time_s
        if abs(missing) < SAME_S:
            break
        scheduled += missing
        found = drive_for(scheduled)
    return EvaluatedRun(case, name, [found])


class LeastIndex:
    """Least wheel energy over running time under a driver's comfort limits: the parabola of three plans.

    Args:
        drives: Drives to compare; the section, with restrictions, is theirs.
        driver: Id of the driver with the limits.
    """

    def __init__(self, drives: Sequence[Drive], driver: str) -> None:
        gentle = setting.comfortable(driver, setting.trainset())
        section = drives[0].section
        fastest = minimum_running_time(section, gentle) * 1.0005
        times = [one.running_time_s for one in drives]
        low = max(min(times), fastest)
        self.times_s = np.linspace(low, max(*times, low + 1.0), 3)
        options = PlanOptions(spacing_m=SPACING_M)
        plans = [optimal_plan(section, gentle, float(t), options) for t in self.times_s]
        self.parabola = self._fit([plan.energy_wheel_j for plan in plans])
        limits = evaluate.driving_limits(drives[0].run, section)
        known = [
            evaluate.attainable_of(section, gentle, float(t), limits, plan)
            for t, plan in zip(self.times_s, plans, strict=True)
        ]
        found = [plan.energy_j for plan in known if plan is not None]
        self.attainable = self._fit(found) if len(found) == len(plans) else None

    def _fit(self, energies_j: Sequence[float]) -> np.polynomial.Polynomial:
        return np.polynomial.Polynomial.fit(self.times_s, energies_j, 2)

    def at(self, running_time_s: float) -> float:
        """Least energy, J."""
        return float(self.parabola(max(running_time_s, float(self.times_s[0]))))

    def above_percent(self, one: Drive) -> float:
        """Wheel energy of a drive above the optimum for the same running time, %."""
        return _above_percent(one, self.at(one.running_time_s))

    def above_attainable_percent(self, one: Drive) -> float:
        """The same above the attainable optimum, which knows dead time, lag and protection; NaN: none."""
        if self.attainable is None:
            return float("nan")
        return _above_percent(one, float(self.attainable(max(one.running_time_s, float(self.times_s[0])))))


def _above_percent(one: Drive, least_j: float) -> float:
    return 100.0 * (float(one.trajectory.energy_wheel_j[-1]) / least_j - 1.0)


def rows_of(found: EvaluatedRun, manual: EvaluatedRun | None) -> Iterator[ReportRow]:
    """Rows of a case and driver."""
    case, driver = found.case, found.driver
    indices, kpis = found.indices, found.kpis

    def row(kpi: str, unit: str, values: Sequence[float], optimum: float | None = None) -> ReportRow:
        said = case.published_value(driver, kpi)
        return make_row(case.table, case.name, driver, kpi, unit, values, said, optimum)

    yield row("Is, safe", "", [float(i.safe) for i in indices])
    yield row("It, on time", "", [float(i.on_time) for i in indices])
    yield row("Ip, parked", "", [float(i.parked) for i in indices])
    yield row(setting.IE, "J/kg", [i.energy_jpkg for i in indices])
    if manual is not None and driver != setting.MANUAL:
        usual = float(np.median([i.energy_jpkg for i in manual.indices]))
        yield row(setting.RELATIVE, "%", [100.0 * (i.energy_jpkg / usual - 1.0) for i in indices])
    yield row(setting.IC, "m/s²", [i.comfort_mps2 for i in indices])
    least = LeastIndex(found.drives, driver)
    best = least.at(float(np.median([k.running_time_s for k in kpis]))) / J_PER_KWH
    yield row("wheel traction energy", "kWh", [k.energy_wheel_kwh for k in kpis], best)
    yield row(ABOVE, "%", [least.above_percent(one) for one in found.drives])
    attainable = [least.above_attainable_percent(one) for one in found.drives]
    if np.isfinite(attainable).all():
        yield row(ABOVE_ATTAINABLE, "%", attainable)
    yield row(setting.TOOK, "s", [k.running_time_s for k in kpis])
    yield row("stopping error", "m", [abs(k.stopping_error_m) for k in kpis])
    yield row(setting.COAST, "m", [k.coasting_distance_m for k in kpis])
    yield row(setting.TOP, "m/s", [k.max_speed_mps for k in kpis])
    yield row("interventions of protection", "", [float(k.interventions) for k in kpis])


def decision_row(table: str, driver: str, found: Sequence[EvaluatedRun]) -> ReportRow:
    """Row of the median decision time over all drives, expert system included."""
    times = np.concatenate([one.decision_us for many in found for one in many.drives])
    said = setting.DECISION_US if driver == "eitop" else None
    middle, high = float(np.median(times)), float(np.percentile(times, 95))
    kpi = "time of a decision (range: median and 95 % point)"
    return ReportRow(table, "all cases", driver, kpi, "µs", said, middle, middle, high)


HURRY_W = 1e5
"""Price of time, high enough that the plan is the fastest one."""
EARLIEST = "earliest arrival possible from the update on"
LEFT = "above the least energy still possible from the update on"


def state_at(one: Drive, time_s: float) -> tuple[PlanOptions, float]:
    """State of a drive at a time as the start of a plan under protection, and the wheel energy used, J."""
    t, limits = one.trajectory, evaluate.driving_limits(one.run, one.section)
    place, speed, used = (
        float(np.interp(time_s, t.time_s, values)) for values in (t.position_m, t.speed_mps, t.energy_wheel_j)
    )
    start = PlanOptions(spacing_m=SPACING_M, start_m=place, start_mps=speed)
    return replace(start, cap_m=limits.position_m, cap_mps=limits.permitted_mps), used


def earliest_s(one: Drive, driver: str, told_s: float) -> float:
    """Earliest arrival from the state at a time, under the driver's comfort limits, s."""
    options, _ = state_at(one, told_s)
    hurry = replace(options, late_w=HURRY_W)
    plan = optimal_plan(one.section, setting.comfortable(driver, one.trainset), 1.0, hurry)
    return told_s + plan.running_time_s


def above_left_percent(one: Drive, driver: str, told_s: float) -> float:
    """Energy of the drive above the sum of that used at a time and the least for the rest, %."""
    options, used = state_at(one, told_s)
    gentle, left = setting.comfortable(driver, one.trainset), one.running_time_s - told_s
    try:
        rest = optimal_plan(one.section, gentle, left, options).energy_wheel_j
    except Infeasible:
        return float("nan")
    return 100.0 * (float(one.trajectory.energy_wheel_j[-1]) / (used + rest) - 1.0)


def news_rows(found: EvaluatedRun) -> Iterator[ReportRow]:
    """Rows of a case with a timetable update; empty for one without.

    They count from where a command given at the update begins to act: what is on its way then cannot be
    taken back.
    """
    case, driver = found.case, found.driver
    if case.told_s is None:
        return
    told = case.told_s + setting.DELAY_S
    row = partial(make_row, case.table, case.name, driver)
    yield row(EARLIEST, "s", [earliest_s(one, driver, told) for one in found.drives])
    above = [above_left_percent(one, driver, told) for one in found.drives]
    if np.isfinite(above).all():
        yield row(LEFT, "%", above)
