"""The cases driven, and each drive's numbers beside the paper's and the optimum's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from metropilot.drivers import DRIVERS, AbstractDriver
from metropilot.errors import Infeasible
from metropilot.evaluate import Drive, Kpis, drive, kpis_of, make_driver
from metropilot.evaluate.indices import Indices, indices_of
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import Section
from metropilot.studies.huang2025.published import (
    COAST,
    DECISION_US,
    IC,
    IE,
    LEARNED,
    MANUAL,
    RELATIVE,
    TOOK,
    TOP,
    Case,
)
from metropilot.studies.huang2025.setting import DELAY_S, LAG_S, comfortable, run_of
from metropilot.studies.report import Row

J_PER_KWH = 3.6e6
SPACING_M = 5.0


@dataclass(frozen=True, eq=False)
class Driven:
    """One case as one driver drove it, once a seed.

    Attributes:
        case: Which.
        driver: Driver id.
        drives: The drives.
    """

    case: Case
    driver: str
    drives: Sequence[Drive]

    @property
    def indices(self) -> list[Indices]:
        """The five indices of each."""
        return [indices_of(one) for one in self.drives]

    @property
    def kpis(self) -> list[Kpis]:
        """The KPIs of each, without an optimum."""
        return [kpis_of(one, None) for one in self.drives]


def drivers_of(driver: str, policies: dict[str, Sequence[Path]], seeds: range) -> list[AbstractDriver]:
    """One driver a seed: manual drives differ by the seed, learned ones by their policy, an expert's not at all."""
    if driver in policies:
        kind = _learned(driver)
        return [kind(str(path)) for path in policies[driver]]
    return [make_driver(driver) for _ in (seeds if driver == MANUAL else range(1))]


def available(driver: str, policies: dict[str, Sequence[Path]]) -> bool:
    """Whether there is somebody to drive: a learned driver needs a policy."""
    return driver in policies or driver in DRIVERS.ids()


def _learned(driver: str):  # noqa: ANN202 (a function from a path to a driver)
    from metropilot.drivers.expert_learned import EXPERT_POLICIES
    from metropilot.drivers.shipped import PolicyOptions

    return lambda path: EXPERT_POLICIES[driver](PolicyOptions(path))


def driven(case: Case, driver: str, policies: dict[str, Sequence[Path]], seeds: range) -> Driven:
    """Drive a case."""
    who = drivers_of(driver, policies, seeds)
    return Driven(case, driver, [drive(run_of(case, seed), one) for seed, one in enumerate(who)])


@cache
def _least_j(section: Section, driver: str, running_time_s: float) -> float:
    """Least wheel energy for a running time under a driver's comfort limits; NaN where there is no plan."""
    from metropilot.studies.huang2025.setting import trainset

    gentle = comfortable(driver, trainset())
    try:
        least = minimum_running_time(section, gentle)
        wanted = max(running_time_s, least * 1.0001)
        return float(optimal_plan(section, gentle, wanted, PlanOptions(spacing_m=SPACING_M)).energy_wheel_j)
    except Infeasible:
        return float("nan")


def above_percent(one: Drive, driver: str, dead_s: float = 0.0) -> float:
    """Wheel energy above the optimum for the same running time under the driver's own comfort limits, %.

    Args:
        one: The drive.
        driver: Whose limits.
        dead_s: Taken off the running time: nothing moves before the dead time of the actuation is over.
    """
    least = _least_j(one.section, driver, round(one.running_time_s - dead_s, 3))
    return 100.0 * (float(one.trajectory.energy_wheel_j[-1]) / least - 1.0)


def rows_of(found: Driven, manual: Driven | None) -> Iterator[Row]:
    """Every number of a driven case."""
    case, driver = found.case, found.driver
    place = (case.table, case.name, driver)
    indices, kpis = found.indices, found.kpis

    def row(kpi: str, unit: str, values: Sequence[float], optimum: float | None = None) -> Row:
        return Row(*place, kpi, unit, published=case.said(driver, kpi), optimum=optimum).measured(values)

    yield row("Is, safe", "", [float(i.safe) for i in indices])
    yield row("It, on time", "", [float(i.on_time) for i in indices])
    yield row("Ip, parked", "", [float(i.parked) for i in indices])
    yield row(IE, "J/kg", [i.energy_jpkg for i in indices])
    if manual is not None and driver != MANUAL:
        usual = float(np.median([i.energy_jpkg for i in manual.indices]))
        yield row(RELATIVE, "%", [100.0 * (i.energy_jpkg / usual - 1.0) for i in indices])
    yield row(IC, "m/s²", [i.comfort_mps2 for i in indices])
    least = _least_j(found.drives[0].section, driver, round(found.drives[0].running_time_s, 3))
    yield row("wheel traction energy", "kWh", [k.energy_wheel_kwh for k in kpis], least / J_PER_KWH)
    yield row("above the optimum", "%", [above_percent(one, driver) for one in found.drives])
    dead = [above_percent(one, driver, DELAY_S + LAG_S) for one in found.drives]
    yield row("above the optimum, dead time of the actuation apart", "%", dead)
    yield row(TOOK, "s", [k.running_time_s for k in kpis])
    yield row("stopping error", "m", [abs(k.stopping_error_m) for k in kpis])
    yield row(COAST, "m", [k.coasting_distance_m for k in kpis])
    yield row(TOP, "m/s", [k.max_speed_mps for k in kpis])
    yield row("interventions of protection", "", [float(k.interventions) for k in kpis])


def decision_row(table: str, driver: str, found: Sequence[Driven]) -> Row:
    """Median time of a decision over all drives, expert system included."""
    times = np.concatenate([one.decision_us for many in found for one in many.drives])
    said = DECISION_US if driver == "eitop" else None
    place = Row(table, "all cases", driver, "time of a decision (range: median and 95 % point)", "µs", said)
    middle, high = float(np.median(times)), float(np.percentile(times, 95))
    return Row(**{**place.__dict__, "ours": middle, "low": middle, "high": high})


def least_time_s(case: Case, driver: str) -> float:
    """Flat-out running time of a case as it stands after the news, under the driver's comfort limits, s."""
    run = run_of(case)
    where = run.section
    for news in run.scenario.news:
        where = where.restricted(news.restriction) if news.restriction else where
    return minimum_running_time(where, comfortable(driver, run.trainset))


def kept(policies: dict[str, Sequence[Path]]) -> dict[str, Sequence[Path]]:
    """Learned drivers with a policy to drive by."""
    return {driver: paths for driver, paths in policies.items() if driver in LEARNED and paths}
