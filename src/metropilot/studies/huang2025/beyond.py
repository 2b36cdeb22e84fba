"""What the paper promises or leaves open: disturbances, other plants, Algorithm 1 as it is printed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from metropilot.drivers.eitoe import Eitoe, EitoeOptions
from metropilot.evaluate import kpis_of
from metropilot.evaluate.indices import indices_of
from metropilot.railway import Actuation
from metropilot.sim import Disturbance, Drive, Run, drive
from metropilot.studies.huang2025.drives import ABOVE, LeastIndex, drivers_of
from metropilot.studies.huang2025.published import BEYOND, BY_ID, EXPERTS
from metropilot.studies.huang2025.setting import DELAY_S, LAG_S, run_of
from metropilot.studies.huang2025.vehicles import vehicle_rows
from metropilot.studies.report import ReportRow

SEEDS = 3
SCENARIOS: Mapping[str, Disturbance] = {
    "mass +10 %": Disturbance(mass_factor=1.1),
    "mass -10 %": Disturbance(mass_factor=0.9),
    "resistance +30 %": Disturbance(resistance_factor=1.3),
    "headwind 10 m/s": Disturbance(headwind_mps=10.0),
    "speed measured with 0.05 m/s noise": Disturbance(speed_noise_mps=0.05),
    "0.2 s more delay than known": Disturbance(extra_delay_s=0.2),
}
ROBUST = f"{BEYOND}: disturbances in case 1, 101 s"
PLANTS = f"{BEYOND}: other plants and steps, 101 s"
LITERAL = f"{BEYOND}: Algorithm 1 as printed, a time for each speed-limit interval"


def beyond_rows(policies: Mapping[str, Sequence[Path]]) -> Iterator[ReportRow]:
    """Every row of this file."""
    case = BY_ID["101"]
    plain = run_of(case)
    for driver in EXPERTS:
        if driver not in policies and driver != "eitoe":
            continue
        for name, scenario in SCENARIOS.items():
            run = replace(plain, scenario=scenario)
            yield from _rows(ROBUST, name, driver, _drives(run, driver, policies))
        for name, run in _plants(plain).items():
            yield from _rows(PLANTS, name, driver, _drives(run, driver, policies), gap=True)
    for case_id in ("101", "sjz"):
        case = BY_ID[case_id]
        for name, intervals in (("each interval", True), ("the destination (as everywhere above)", False)):
            found = drive(run_of(case), Eitoe(EitoeOptions(intervals=intervals)))
            yield from _rows(LITERAL, f"{case.name}, window of {name}", "eitoe", [found], gap=True)
        yield from vehicle_rows(drive(run_of(case), Eitoe()), case.name)


def _plants(run: Run) -> dict[str, Run]:
    """The same run on another plant, or decided in another step."""
    known = run.trainset
    limited = replace(known, actuation=Actuation(DELAY_S, LAG_S, 1.0))
    return {
        "jerk limit 1 m/s³ besides": replace(run, trainset=limited),
        "no delay, no lag": replace(run, trainset=known.ideal()),
        "step 0.02 s, as the paper's": replace(run, dt=0.02),
    }


def _drives(run: Run, driver: str, policies: Mapping[str, Sequence[Path]]) -> list[Drive]:
    """One drive a policy, of at most a few, each with a seed of its own."""
    few = {name: list(paths)[:SEEDS] for name, paths in policies.items()}
    return [drive(replace(run, seed=k), one) for k, one in enumerate(drivers_of(driver, few, range(1)))]


def _rows(
    table: str, case: str, driver: str, drives: Sequence[Drive], *, gap: bool = False
) -> Iterator[ReportRow]:
    place = (table, case, driver)
    yield ReportRow(*place, "Is, It and Ip met", "").measured([float(indices_of(one).met) for one in drives])
    yield ReportRow(*place, "time error", "s").measured(
        [one.running_time_s - one.scheduled_time_s for one in drives]
    )
    yield ReportRow(*place, "stopping error", "m").measured(
        [abs(kpis_of(one, None).stopping_error_m) for one in drives]
    )
    if gap:
        least = LeastIndex(drives, driver)
        yield ReportRow(*place, ABOVE, "%").measured([least.above_percent(one) for one in drives])
    yield ReportRow(*place, "interventions of protection", "").measured(
        [float(one.interventions) for one in drives]
    )
