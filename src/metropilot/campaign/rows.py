"""Runs of a campaign: drive the rows of a shard, with their optima."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from time import perf_counter, process_time
from typing import Any

from metropilot.campaign.declared import (
    DRAWN,
    OWN,
    PLANNED,
    Campaign,
    CampaignCase,
    case_request,
)
from metropilot.campaign.matrix import CellRow, capture_errors, peak_memory_mb
from metropilot.errors import Infeasible, InputError
from metropilot.evaluate import Kpis, Optimum, RunSpec, kpis_of, optimum_of
from metropilot.planning import minimum_running_time
from metropilot.railway import Section, load_line, load_trainset, parse_trainset
from metropilot.sim import Drive, Run, drive

WORDS = ("driver", "line", "origin", "destination", "trainset", "load", "time", "disturbance")
PLANT = ("period_s", "trainset_delay_s", "trainset_lag_s")
"""Control period, and dead time and lag that the trainset declares."""
NUMBERS = (
    "minimum_running_time_s",
    "running_time_s",
    "time_error_s",
    "stopping_error_m",
    "energy_wheel_kwh",
    "energy_line_kwh",
    "optimal_energy_kwh",
    "optimality_gap_percent",
    "attainable_energy_kwh",
    "attainable_bound_kwh",
    "trainset_gap_percent",
    "driver_gap_percent",
    "max_overspeed_mps",
    "max_acceleration_mps2",
    "max_jerk_mps3",
    "jerk_limit_mps3",
    "comfort_huang2025",
    "mass_kg",
)
COUNTS = ("interventions", "regime_switches")
TRUTHS = ("safe", "punctual")
RESULTS: Mapping[str, str] = {
    "cell": "BIGINT",
    **dict.fromkeys(WORDS, "VARCHAR"),
    "actuation": "VARCHAR",
    **dict.fromkeys(PLANT, "DOUBLE"),
    "number": "INTEGER",
    "seed": "BIGINT",
    "length_m": "DOUBLE",
    "scheduled_time_s": "DOUBLE",
    **dict.fromkeys(DRAWN, "DOUBLE"),
    "engine": "VARCHAR",
    "outcome": "VARCHAR",
    "success": "BOOLEAN",
    **dict.fromkeys(TRUTHS, "BOOLEAN"),
    **dict.fromkeys(NUMBERS, "DOUBLE"),
    **dict.fromkeys(COUNTS, "INTEGER"),
    "error": "VARCHAR",
}
"""Columns of the results: the same bits on every machine and in every order of the rows."""
TIMINGS: Mapping[str, str] = {
    "cell": "BIGINT",
    "driver": "VARCHAR",
    "processor_s": "DOUBLE",
    "wall_s": "DOUBLE",
    "decision_us_median": "DOUBLE",
    "decision_us_max": "DOUBLE",
    "worker_mb": "DOUBLE",
}
"""Columns of measured times, in a file of their own because they are not reproducible."""


def drive_rows(campaign: Campaign, rows: range) -> list[CellRow]:
    """Drive rows: those of learned policies as a batch where they can be, all others one by one."""
    cases = [campaign.case(row) for row in rows]
    batch = [
        case
        for case in cases
        if campaign.is_compiled(case.driver, case.disturbance, (case.trainset, case.load))
    ]
    found: dict[int, CellRow] = {}
    if batch:
        from metropilot.campaign.compiled import drive_batch

        found = dict(zip((case.row for case in batch), drive_batch(campaign, batch), strict=True))
    return [found[case.row] if case.row in found else drive_row(campaign, case) for case in cases]


def drive_row(campaign: Campaign, case: CampaignCase) -> CellRow:
    """Drive one row; returns its result and its timing. An error of the driver is recorded as a result."""
    began, spent = perf_counter(), process_time()
    result, timing = new_result(campaign, case)
    with capture_errors(result):
        request, run = prepare_run(campaign, case, result)
        driven = drive(run, request.make_driver())
        kpis = add_kpis(campaign, driven, optimum_of(driven, campaign.objective), result)
        timing["decision_us_median"] = kpis.decision_time_us_median
        timing["decision_us_max"] = float(driven.decision_us.max())
    timing |= {
        "wall_s": perf_counter() - began,
        "processor_s": process_time() - spent,
        "worker_mb": peak_memory_mb(),
    }
    return result, timing


def new_result(campaign: Campaign, case: CampaignCase) -> CellRow:
    """Result and timing of a row before its run: the cell only."""
    cell = case.row % campaign.cells
    result: dict[str, Any] = {name: str(getattr(case, name)) for name in WORDS[:-1]}
    key = parse_trainset(case.trainset)
    late = OWN if key.actuation is None else "{:g} s, {:g} s".format(*key.actuation)
    result |= {"cell": cell, "disturbance": case.disturbance.name, "number": case.number}
    result |= {"trainset": str(key._replace(actuation=None)), "actuation": late, "period_s": case.period_s}
    return result | {"success": False, "engine": "host"}, {"cell": cell, "driver": case.driver}


def prepare_run(campaign: Campaign, case: CampaignCase, result: dict[str, Any]) -> tuple[RunSpec, Run]:
    """Request and run of a row; enters seed, section length and disturbance into its result."""
    section = section_of(case.line, case.origin, case.destination)
    scheduled = scheduled_time(case, section)
    request = case_request(campaign, case, scheduled, section.length_m)
    result |= {"seed": request.seed, "length_m": section.length_m, "scheduled_time_s": scheduled}
    result |= {name: value for name in DRAWN if (value := getattr(request.disturbance, name)) != float("inf")}
    run = request.run(fastest_s(*case[2:7]))
    declared = run.disturbance.nominal(run.trainset).actuation
    result |= {"trainset_delay_s": declared.delay_s, "trainset_lag_s": declared.lag_s}
    return request, run


def add_kpis(campaign: Campaign, driven: Drive, optimum: Optimum | None, result: dict[str, Any]) -> Kpis:
    """Measure the run of a row and enter its KPIs into its result."""
    kpis = kpis_of(driven, optimum, campaign.objective)
    found = kpis.as_dict()
    result |= {name: found[name] for name in (*TRUTHS, *NUMBERS, *COUNTS, "outcome", "scheduled_time_s")}
    result["success"] = kpis.on_time
    return kpis


@lru_cache(maxsize=64)
def section_of(line: str, origin: str, destination: str) -> Section:
    """A section, read once per worker."""
    return load_line(line).section(origin, destination)


@lru_cache(maxsize=512)
def fastest_s(line: str, origin: str, destination: str, trainset: str, load: str) -> float:
    """Minimum running time of a section, computed once per worker."""
    return minimum_running_time(section_of(line, origin, destination), load_trainset(trainset, load))


def scheduled_time(case: CampaignCase, section: Section) -> float:
    """The scheduled time of a row.

    Raises:
        Infeasible: The line has no planned running time for the section.
    """
    if case.time != PLANNED:
        return round(float(case.time) * fastest_s(*case[2:7]), 3)
    if section.planned_time_s is None:
        raise Infeasible(f"the line plans no running time for {section.name}", field="time", value=PLANNED)
    return float(section.planned_time_s)


def request_of_row(campaign: Campaign, row: Mapping[str, Any]) -> RunSpec:
    """The run of a row of the results.

    Args:
        campaign: The campaign.
        row: Row of its results.

    Raises:
        InputError: It has no scheduled time.
    """
    case, scheduled_s = campaign.case(row["row"]), row["scheduled_time_s"]
    if scheduled_s is None:
        raise InputError("has no scheduled time: nothing was driven", field="row", value=row["row"])
    if case.disturbance.arrival is not None:
        scheduled_s /= case.disturbance.arrival[0]
    length_m = section_of(case.line, case.origin, case.destination).length_m
    return case_request(campaign, case, scheduled_s, length_m)
