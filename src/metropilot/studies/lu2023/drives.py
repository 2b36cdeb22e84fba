"""Drives of the plans, their optimum over the notches and over all forces, and their rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.drivers import LearnedDriver
from metropilot.evaluate import Kpis, comfort_band_shares, kpis_of
from metropilot.planning import PlanOptions, optimal_plan
from metropilot.policy import load_driving_policy, shipped_policy
from metropilot.railway import load_trainset
from metropilot.sim import AbstractDriver, Drive, Run, drive
from metropilot.studies.lu2023.drivers import PidLu2023, PidLu2023Options
from metropilot.studies.lu2023.notches import NotchOptions, notch_plan, notch_plans
from metropilot.studies.lu2023.setting import MOST_MPS2, NOTCHES, PID_130, TRAINSET, PlanCase, Published
from metropilot.studies.report import ReportRow, make_row
from metropilot.units import J_PER_KWH

AROUND_S = (-3.0, 0.0, 3.0)
MESH = NotchOptions(spacing_m=3.0, speeds=600)
ABOVE_GENTLE = f"wheel traction above the optimum over the notches within {MOST_MPS2:g} m/s²"
ABOVE_ANY = "wheel traction above the optimum over the notches, any acceleration"


@dataclass(frozen=True)
class NotchFront:
    """Least traction energy over running time, near one plan.

    Attributes:
        time_s: Running times of the drives found. Shape (3,).
        energy_j: Their energies. Shape (3,).
    """

    time_s: Float[ndarray, "3"]
    energy_j: Float[ndarray, "3"]

    def at(self, time_s: float | ndarray) -> float | ndarray:
        """Interpolate with a parabola, extrapolate with its tangents, J."""
        bend = np.polynomial.Polynomial.fit(self.time_s, self.energy_j, 2)
        inside = np.clip(time_s, self.time_s[0], self.time_s[-1])
        return bend(inside) + bend.deriv()(inside) * (np.asarray(time_s) - inside)


@cache
def notch_front(plan: PlanCase, *, gentle: bool = True) -> NotchFront:
    """Compute the optimum over the twelve notches about a plan's time (takes a few seconds).

    Args:
        plan: The plan.
        gentle: Within the largest acceleration of the paper, as the learned drivers are.
    """
    trainset = load_trainset(TRAINSET)
    times_s = [plan.scheduled_s + shift for shift in AROUND_S]
    options = replace(MESH, most_mps2=MOST_MPS2) if gentle else MESH
    found = notch_plans(plan.section, trainset, times_s, trainset.notches[NOTCHES], options)
    return NotchFront(
        np.array([p.running_time_s for p in found]), np.array([p.energy_wheel_j for p in found])
    )


def convex_j(plan: PlanCase, time_s: float) -> float:
    """Least traction energy over all forces up to the strongest notches, J."""
    trainset = load_trainset(TRAINSET)
    return optimal_plan(plan.section, trainset, time_s, PlanOptions(spacing_m=5.0)).energy_wheel_j


@cache
def effort_j(plan: PlanCase) -> float:
    """Least traction and braking work (the paper's energy) over the notches, J."""
    trainset = load_trainset(TRAINSET)
    options = NotchOptions(MESH.spacing_m, MESH.speeds, 1.0)
    return notch_plan(
        plan.section, trainset, plan.scheduled_s, trainset.notches[NOTCHES], options
    ).energy_effort_j


POLICIES = Path(__file__).parent / "policies"
SPAN_M = 500.0


@dataclass(frozen=True, eq=False)
class NotchRun:
    """Drive of one plan.

    Attributes:
        plan: The plan.
        driver: Driver id.
        drive: The drive.
        kpis: Its KPIs (their optimum is in ``optima``).
    """

    plan: PlanCase
    driver: str
    drive: Drive
    kpis: Kpis


def policy_file(name: str) -> Path:
    """Path of a policy shipped with the study."""
    return POLICIES / f"{name}.safetensors"


def load_driver(path: Path) -> LearnedDriver:
    """Load a policy file as a driver."""
    loaded = load_driving_policy(path)
    return LearnedDriver(loaded.policy, loaded.interface)


def drive_plan(plan: PlanCase, name: str, driver: AbstractDriver) -> NotchRun:
    """Drive a plan on the host."""
    run = Run(plan.section, load_trainset(TRAINSET), plan.scheduled_s)
    found = drive(run, driver)
    return NotchRun(plan, name, found, kpis_of(found, None))


def track_policy(plan: PlanCase, path: Path) -> NotchRun:
    """Track the curve of a policy with the paper's PID."""
    return drive_plan(plan, "pid_lu2023", PidLu2023(PidLu2023Options(policy=str(path))))


def shipped_policy_of(plan_id: str) -> Path:
    """Path of the shipped network of a plan; without one, and for ``all``, of the network for all plans."""
    own = policy_file(f"improved_dqn-{plan_id}")
    return own if own.is_file() else shipped_policy("improved_dqn")


def switches_over(found: Drive) -> float:
    """Largest number of changes between traction, coasting and braking within ``SPAN_M`` (Lu23 Fig. 9)."""
    t = found.trajectory
    sign = np.sign(np.round(t.traction_n - t.electric_brake_n - t.friction_brake_n, 0))[:-1]
    at = t.position_m[1:-1][sign[1:] != sign[:-1]]
    return float(max(((at >= x) & (at <= x + SPAN_M)).sum() for x in at)) if at.size else 0.0


def command_changes(found: Drive) -> float:
    """Number of changes of the command by more than 0.05 from one control period to the next."""
    command = found.trajectory.command[:-1]
    return float((np.abs(np.diff(command)) > 0.05).sum())


def largest_acceleration(found: Drive) -> float:
    """Largest acceleration or deceleration of a drive; the paper keeps 0.8 m/s^2."""
    return float(np.abs(found.trajectory.acceleration_mps2).max())


def arrival_rows(table: str, seeds: Sequence[NotchRun], *, published: bool = True) -> Iterator[ReportRow]:
    """Rows of one plan and driver: stop, time and energy with published and optimal values.

    Args:
        table: Name of the table.
        seeds: The drive of every seed.
        published: Whether the paper's numbers stand beside them.
    """
    plan, driver = seeds[0].plan, seeds[0].driver
    paper: Published | None = PID_130 if driver == "pid_lu2023" else plan.published
    said = (paper.stop_m, paper.late_s, paper.kwh) if paper and published else (None, None, None)
    kpis = [one.kpis for one in seeds]
    gentle, notch = (
        [float(notch_front(plan, gentle=gentle).at(k.running_time_s)) / J_PER_KWH for k in kpis]
        for gentle in (True, False)
    )
    convex = [convex_j(plan, k.running_time_s) / J_PER_KWH for k in kpis]

    row = partial(make_row, table, plan.name, driver)

    def above(optima: Sequence[float]) -> list[float]:
        return [100.0 * (k.energy_wheel_kwh / best - 1.0) for k, best in zip(kpis, optima, strict=True)]

    yield row("stopping error", "m", [abs(k.stopping_error_m) for k in kpis], said[0])
    yield row("time error", "s", [abs(k.time_error_s) for k in kpis], said[1])
    used = [k.energy_wheel_kwh for k in kpis]
    yield row("wheel traction energy", "kWh", used, said[2], float(np.median(gentle)))
    effort = [k.energy_effort_kwh for k in kpis]
    yield row("energy |f dx|, braking counted", "kWh", effort, said[2], effort_j(plan) / J_PER_KWH)
    yield row(ABOVE_GENTLE, "%", above(gentle))
    yield row(ABOVE_ANY, "%", above(notch))
    yield row("wheel traction above the convex optimum", "%", above(convex))
    yield row("largest overspeed", "m/s", [k.max_overspeed_mps for k in kpis])
    yield row("interventions of protection", "", [float(k.interventions) for k in kpis])
    switches = [switches_over(one.drive) for one in seeds]
    yield row(f"most switches of regime in {SPAN_M:.0f} m", "", switches)
    yield row("changes of command", "", [command_changes(one.drive) for one in seeds])
    yield row("r.m.s. acceleration", "m/s²", [k.rms_acceleration_mps2 for k in kpis])
    yield row("largest acceleration", "m/s²", [largest_acceleration(one.drive) for one in seeds])
    yield row("largest jerk", "m/s³", [k.max_jerk_mps3 for k in kpis])
    bands = [comfort_band_shares(one.drive.trajectory) for one in seeds]
    for words in dict.fromkeys(words for band in bands for words in band):
        shares = [100.0 * band.get(words, 0.0) for band in bands]
        if max(shares) > 0.0:
            yield row(f"time {words} (ISO 2631, its Table 1)", "%", shares)
