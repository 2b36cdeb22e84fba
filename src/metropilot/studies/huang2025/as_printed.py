"""EITOE and EITOP with the paper's own acceleration limit, windows and learning; equal arrival times."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from metropilot.env import DisturbanceDistribution, DrivingTask
from metropilot.evaluate import make_driver
from metropilot.railway import load_line
from metropilot.sim import drive
from metropilot.studies.huang2025 import setting
from metropilot.studies.huang2025.drives import EvaluatedRun, drive_at_arrival
from metropilot.studies.huang2025.env import ExpertAction
from metropilot.studies.learning import LearnJob
from metropilot.studies.report import PrintedSetting, ReportRow, make_row
from metropilot.studies.study import AsPrinted, LiteralRun, Order

if TYPE_CHECKING:
    from pathlib import Path

EXPERT_LIMITS_MPS2, POLICY_LIMITS_MPS2 = (0.6, 0.8, 1.0), (0.6, 0.8)
AT_ARRIVAL_MPS2 = {0.6: (0.6,), 0.8: (0.8, 1.0)}
"""Limits of the expert that arrives when EITOP does, by EITOP's."""
STEP_S = 0.02
CASES = {"quick": ("101",), "paper": ("101", "95", "115")}
STEPS = {"quick": 400_000, "paper": 1_000_000}
SEEDS = {"quick": 1, "paper": 3}
ENERGY = "wheel traction energy"


def driver_at(driver: str, limit_mps2: float) -> str:
    """Driver id with its acceleration limit."""
    return f"{driver} at {limit_mps2:g} m/s²"


def expert_at_arrival(limit_mps2: float, policy_mps2: float) -> str:
    """Driver id of the expert that arrives when EITOP does."""
    return f"{driver_at(setting.EITOE, limit_mps2)}, arrival of {driver_at(setting.EITOP, policy_mps2)}"


def literal_task(limit_mps2: float) -> DrivingTask:
    """The paper's task of EITOP: case 1 alone, from standstill, without late news."""
    section = load_line(setting.LINE).section(*setting.LEARNED_ON[0])
    scheduled_s = setting.BY_ID["101"].scheduled_s
    times = DisturbanceDistribution(time_s=(scheduled_s, scheduled_s))
    action = ExpertAction(start_mps2=limit_mps2)
    return DrivingTask(replace(setting.task_config(), sections=(section,), scenarios=times, action=action))


def jobs(seeds: Iterable[int], budget: str) -> list[LearnJob]:
    """Learning runs of EITOP under each limit."""
    from metropilot.learn import RECIPES

    told = {"steps": STEPS[budget], "evaluations": 6}
    config, seeds = RECIPES.get(setting.EITOP).configuration("paper", **told), list(seeds)
    return [
        LearnJob(
            f"as-printed-{budget}-eitop-{limit_mps2:g}",
            config,
            partial(literal_task, limit_mps2),
            seed,
            about={"driver": setting.EITOP, "start_mps2": limit_mps2},
        )
        for limit_mps2 in POLICY_LIMITS_MPS2
        for seed in seeds
    ]


def measure(order: Order) -> LiteralRun:
    """Learn EITOP as printed, drive the cases, and repeat the expert's drives at EITOP's arrivals."""
    from metropilot.studies.huang2025.learning import write_result

    most = SEEDS[order.budget]
    seeds, folder = order.choose_seeds(quick=most, paper=most)[:most], order.folder / "huang2025"
    results = order.learn(jobs(seeds, order.budget), folder)
    policies: dict[float, list[Path]] = {limit: [] for limit in POLICY_LIMITS_MPS2}
    for result in results:
        policies[float(result.job.about["start_mps2"])].append(write_result(folder, result))
    rows: list[ReportRow] = []
    for case_id in CASES[order.budget]:
        rows += [row for one in _drive(setting.BY_ID[case_id], policies) for row in _rows(one)]
        order.say(f"{setting.BY_ID[case_id].name} driven as printed")
    length = f"EITOP: {len(seeds)} seeds of {STEPS[order.budget]:,} steps of half a second on case 1 alone."
    return LiteralRun(rows, [length, *_findings(rows)])


def _drive(case: setting.PublishedCase, policies: dict[float, list[Path]]) -> list[EvaluatedRun]:
    """Drives of a case: literal EITOE, the limits of each, the expert at the arrivals of EITOP."""
    literal = make_driver(setting.EITOE, {"start_mps2": setting.RULE2_MPS2, "intervals": True})
    found = [EvaluatedRun(case, setting.EITOE, [drive(replace(setting.run_of(case), dt=STEP_S), literal)])]
    for limit in EXPERT_LIMITS_MPS2:
        expert = make_driver(setting.EITOE, {"start_mps2": limit})
        found.append(
            EvaluatedRun(case, driver_at(setting.EITOE, limit), [drive(setting.run_of(case), expert)])
        )
    for limit, paths in policies.items():
        drivers = [make_driver(setting.EITOP, {"policy": str(path)}) for path in paths]
        mine = EvaluatedRun(
            case, driver_at(setting.EITOP, limit), [drive(setting.run_of(case), one) for one in drivers]
        )
        arrival = float(np.median([one.running_time_s for one in mine.drives]))
        experts = [(one, expert_at_arrival(one, limit)) for one in AT_ARRIVAL_MPS2[limit]]
        found += [mine, *(drive_at_arrival(case, arrival, one, name) for one, name in experts)]
    return found


def _rows(one: EvaluatedRun) -> list[ReportRow]:
    """Rows of one drive; the limits of EITOE and EITOP stand beside the driver's published numbers."""
    at_arrival = "arrival" in one.driver
    said = "" if at_arrival else setting.EITOP if one.driver.startswith(setting.EITOP) else setting.EITOE

    def row(kpi: str, unit: str, values: Iterable[float]) -> ReportRow:
        published = one.case.published_value(said, kpi)
        return make_row(one.case.table, one.case.name, one.driver, kpi, unit, values, published)

    indices, kpis = one.indices, one.kpis
    found = [
        row(setting.IE, "J/kg", [i.energy_jpkg for i in indices]),
        row(ENERGY, "kWh", [k.energy_wheel_kwh for k in kpis]),
        row(setting.IC, "m/s²", [i.comfort_mps2 for i in indices]),
        row(setting.TOOK, "s", [k.running_time_s for k in kpis]),
    ]
    if at_arrival:
        return found
    return [
        *found,
        row(setting.COAST, "m", [k.coasting_distance_m for k in kpis]),
        row(setting.TOP, "m/s", [k.max_speed_mps for k in kpis]),
        row("Ip, parked", "", [float(i.parked) for i in indices]),
    ]


def _findings(rows: Sequence[ReportRow]) -> list[str]:
    """Sentences on EITOP against the expert at the same limit and arrival, from the rows."""
    ie = {(row.case, row.driver): row.ours for row in rows if row.kpi == setting.IE}
    found = []
    for limit in POLICY_LIMITS_MPS2:
        told = []
        for (case, driver), mine in ie.items():
            other = ie.get((case, expert_at_arrival(limit, limit)))
            if driver == driver_at(setting.EITOP, limit) and mine is not None and other is not None:
                told.append(f"{case}: {100.0 * (mine / other - 1.0):+.1f} %")
        found.append(
            f"Ie of EITOP against EITOE at the same limit ({limit:g} m/s²) and arrival: {'; '.join(told)}."
        )
    return found


SETTINGS = (
    PrintedSetting(
        "largest acceleration (rule 2)",
        "below 0.6 m/s²",
        f"{setting.RULE2_MPS2:g} m/s², EITOP {setting.GENTLE_MPS2[setting.EITOP]:g} m/s²",
        f"0.6 m/s²; {', '.join(driver_at(setting.EITOE, one) for one in EXPERT_LIMITS_MPS2)} and "
        f"{', '.join(driver_at(setting.EITOP, one) for one in POLICY_LIMITS_MPS2)} as well: the published "
        "364 J/kg needs 0.8.",
    ),
    PrintedSetting(
        "window of eq. 14",
        "each speed-limit interval (Algorithm 1)",
        "destination",
        "each interval in the rows of `eitoe`, the destination in the others.",
    ),
    PrintedSetting(
        "control step",
        f"{STEP_S:g} s",
        "0.2 s",
        f"{STEP_S:g} s in the rows of `eitoe`; a policy is asked every half second.",
    ),
    PrintedSetting(
        "EITOP learns on",
        "case 1",
        "four sections, times from 1.08 to 1.45 of the minimum, late news",
    ),
    PrintedSetting(
        "episodes of learning",
        f"about {setting.EPISODES_TO_SETTLE} until the energy has fallen (figs. 5 and 6)",
        "1,000,000 steps",
        "as many steps as this study; sizes and rates of PPO are not printed.",
    ),
    PrintedSetting(
        "weights of eq. 26, eq. 4, braking rates",
        "not printed",
        "see the deviations above",
        "those of this study.",
    ),
)

AS_PRINTED = AsPrinted(SETTINGS, measure)
