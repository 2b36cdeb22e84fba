"""Beyond the paper: disturbances, other plants, Algorithm 1 as printed, learning the brake, vehicles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from metropilot.evaluate import indices_of, kpis_of
from metropilot.physics import bodies_at, consist, multibody_step, substeps, track_arrays
from metropilot.railway import Actuation
from metropilot.sim import Disturbance, Drive, Rollout, Run, drive
from metropilot.studies.huang2025.drivers import Eitoe, EitoeOptions
from metropilot.studies.huang2025.drives import ABOVE, LeastIndex, make_drivers
from metropilot.studies.huang2025.setting import BEYOND, BY_ID, DELAY_S, EXPERTS, LAG_S, run_of
from metropilot.studies.report import ReportRow, make_row

SEEDS = 3
SCENARIOS: Mapping[str, Disturbance] = {
    "mass +10 %": Disturbance(mass_factor=1.1),
    "mass -10 %": Disturbance(mass_factor=0.9),
    "resistance +30 %": Disturbance(resistance_factor=1.3),
    "headwind 10 m/s": Disturbance(headwind_mps=10.0),
    "speed measured with 0.05 m/s noise": Disturbance(speed_noise_mps=0.05),
    "0.2 s more delay than known": Disturbance(delay_s=0.2),
}
ROBUST = f"{BEYOND}: disturbances in case 1, 101 s"
PLANTS = f"{BEYOND}: other plants and steps, 101 s"
LITERAL = f"{BEYOND}: Algorithm 1 as printed, a time for each speed-limit interval"


def beyond_rows(policies: Mapping[str, Sequence[Path]]) -> Iterator[ReportRow]:
    """Rows of all comparisons beyond the paper."""
    case = BY_ID["101"]
    plain = run_of(case)
    for driver in EXPERTS:
        if driver not in policies and driver != "eitoe":
            continue
        for name, scenario in SCENARIOS.items():
            run = replace(plain, disturbance=scenario)
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
    known = run.trainset
    limited = replace(known, actuation=Actuation(DELAY_S, LAG_S, 1.0))
    return {
        "with a jerk limit of 1 m/s³": replace(run, trainset=limited),
        "no delay, no lag": replace(run, trainset=known.ideal()),
        "step 0.02 s, as the paper's": replace(run, dt=0.02),
    }


def _drives(run: Run, driver: str, policies: Mapping[str, Sequence[Path]]) -> list[Drive]:
    """Drive a run once per policy (at most ``SEEDS``), each with its own seed."""
    few = {name: list(paths)[:SEEDS] for name, paths in policies.items()}
    return [drive(replace(run, seed=k), one) for k, one in enumerate(make_drivers(driver, few, range(1)))]


def _rows(
    table: str, case: str, driver: str, drives: Sequence[Drive], *, gap: bool = False
) -> Iterator[ReportRow]:
    row = partial(make_row, table, case, driver)
    yield row("Is, It and Ip met", "", [float(indices_of(one).met) for one in drives])
    yield row("time error", "s", [one.running_time_s - one.scheduled_time_s for one in drives])
    yield row("stopping error", "m", [abs(kpis_of(one, None).stopping_error_m) for one in drives])
    if gap:
        least = LeastIndex(drives, driver)
        yield row(ABOVE, "%", [least.above_percent(one) for one in drives])
    yield row("interventions of protection", "", [float(one.interventions) for one in drives])


GAINS = (0.7, 1.0, 1.3)
STOPS = 11
NOISE_MPS = 0.02


class Stops(NamedTuple):
    """Consecutive station stops with the same brake.

    Attributes:
        gain: Ratio of true to nominal braking force.
        error_m: Position of the head minus the stop point, one per stop.
        learned: Estimated gain after each stop.
        time_s: Running time of each run.
        interventions: Interventions of protection in all runs.
    """

    gain: float
    error_m: list[float]
    learned: list[float]
    time_s: list[float]
    interventions: int


def repeat_stops(gain: float) -> Stops:
    """Drive case 1 repeatedly; the estimate of the brake is carried from stop to stop.

    Args:
        gain: Ratio of true to nominal braking force.
    """
    driver, hoa = Eitoe(EitoeOptions(brake_known=False)), None
    errors, learned, times, overruled = [], [], [], 0
    for seed in range(STOPS):
        run = run_of(BY_ID["101"], seed)
        disturbance = replace(run.disturbance, brake_factor=gain, speed_noise_mps=NOISE_MPS)
        rollout = Rollout(replace(run, disturbance=disturbance), driver)
        if hoa is not None:
            rollout.memory = rollout.memory._replace(hoa=hoa)
        while rollout.outcome is None:
            rollout.advance()
        found = rollout.drive()
        hoa = rollout.memory.hoa.next_stop()
        errors.append(float(found.trajectory.position_m[-1]) - found.section.length_m)
        learned.append(hoa.gain)
        times.append(found.running_time_s)
        overruled += found.interventions
    return Stops(gain, errors, learned, times, overruled)


def stop_rows(found: list[Stops]) -> Iterator[ReportRow]:
    """Rows of the first stop with an unknown brake, and of the last."""
    for one in found:
        brake = "as believed" if one.gain == 1.0 else f"{100 * (one.gain - 1):+.0f} %"
        row = partial(
            make_row, f"{BEYOND}: station stops that learn the brake", f"brake {brake}, 101 s", "eitoe"
        )
        yield row("first stop: stopping error", "m", [abs(one.error_m[0])])
        yield row(f"stop {len(one.error_m)}: stopping error", "m", [abs(one.error_m[-1])])
        yield row("all stops: stopping error", "m", np.abs(one.error_m))
        yield row("gain learned at the first stop", "", one.learned[:1], optimum=one.gain)
        yield row("running time", "s", one.time_s)
        yield row("interventions of protection", "", [float(one.interventions)])


class VehicleDeviation(NamedTuple):
    """Deviation of six coupled vehicles from one body under the same efforts.

    Attributes:
        speed_mps: Largest difference of the head's speed while it moves.
        place_m: Difference of the head's position at standstill of the one body.
        coupler_n: Largest force in a coupler while it moves.
    """

    speed_mps: float
    place_m: float
    coupler_n: float


def measure_deviation(found: Drive) -> VehicleDeviation:
    """Apply a drive's efforts to the vehicles in open loop."""
    t, trainset = found.trajectory, found.trainset
    cars, track = consist(trainset), track_arrays(found.section, trainset)
    effort = t.traction_n - t.electric_brake_n - t.friction_brake_n
    count, bodies = substeps(cars, found.run.dt), bodies_at(cars)
    speed, force = 0.0, 0.0
    for k, seconds in enumerate(t.duration_s[:-1]):
        if seconds <= 0.0 or (t.speed_mps[k] <= 0.0 and effort[k] <= 0.0):
            continue
        bodies = multibody_step(cars, track, bodies, effort[k], float(seconds), count)
        speed = max(speed, abs(float(bodies.speed_mps[0]) - float(t.speed_mps[k + 1])))
        if t.speed_mps[k + 1] > 0.0:
            force = max(force, float(np.abs(bodies.coupler_n).max()))
    return VehicleDeviation(speed, float(bodies.position_m) - float(t.position_m[-1]), force)


def vehicle_rows(found: Drive, case: str) -> Iterator[ReportRow]:
    """Rows of the vehicle deviations."""
    one, table = measure_deviation(found), f"{BEYOND}: the same efforts on six vehicles with couplers (eq. 3)"
    row = partial(make_row, table, case, found.driver)
    yield row("largest difference of speed", "m/s", [one.speed_mps])
    yield row("difference of the place at the stop", "m", [abs(one.place_m)])
    yield row("largest coupler force", "kN", [one.coupler_n / 1e3])
