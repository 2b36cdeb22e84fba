"""DDPG-PID learned with the paper's own state, rewards and end of the run."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from metropilot.studies.cheng2023.drives import policy_control, table_1, values
from metropilot.studies.cheng2023.env import TrackingConfig, TrackingRewards, TrackingTask
from metropilot.studies.cheng2023.law import gains_law
from metropilot.studies.cheng2023.learning import REWARDS, config
from metropilot.studies.cheng2023.setting import NAMES, course
from metropilot.studies.cheng2023.tracking import SCALE, ObservationScale, track_course, tracking_kpis
from metropilot.studies.learning import LearnJob
from metropilot.studies.report import PrintedSetting, ReportRow, make_row
from metropilot.studies.study import AsPrinted, LiteralRun, Order
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot.learn import DDPGConfig

STATE = ObservationScale(1.0, 1.0, 1.0, math.inf)
"""Cheng23 eq. 7 as it stands, in m/s and m."""
ENERGY_J = {"ddpg_pid": J_PER_KWH, "ddpg_pid, energy in kJ": 1e3}
"""Energy that costs 1 in eq. 22, by driver: the unit of the paper's tables, and that of its eqs. 22 to 24."""
STEPS = {"quick": 16_000, "paper": 300_000}
SEEDS = 3
PERIODS = 450
"""Control periods of an episode, about."""


def literal_rewards(energy_j: float) -> TrackingRewards:
    """Cheng23 eqs. 17 to 22: every weight 0.2, every error in its own unit."""
    return TrackingRewards(energy_j=energy_j, centred=False)


def literal_task(energy_j: float) -> TrackingTask:
    """The paper's task: from standstill to the planned end of the run."""
    rewards = literal_rewards(energy_j)
    return TrackingTask(
        TrackingConfig((course(),), gains_law(scale=STATE), rewards=rewards, on_the_way=0.0, grace=False)
    )


def literal_config(budget: str) -> DDPGConfig:
    """DDPG without what the paper's eqs. 11 to 14 do not have; the last policy is kept."""
    steps = STEPS[budget]
    return replace(
        config(),
        steps=steps,
        evaluations=10,
        warmup=min(config().warmup, steps // 4),
        saturation_cost=0.0,
        keep="last",
    )


def jobs(seeds: Iterable[int], budget: str) -> list[LearnJob]:
    """Learning runs of the printed settings, readings of the energy varying slowest."""
    return [
        LearnJob(
            f"as-printed-{budget}-{'kwh' if energy_j == J_PER_KWH else 'kj'}",
            literal_config(budget),
            partial(literal_task, energy_j),
            seed,
            about={"rewards": repr(literal_rewards(energy_j))},
        )
        for energy_j in ENERGY_J.values()
        for seed in seeds
    ]


def measure(order: Order) -> LiteralRun:
    """Learn with the printed settings, and track the base scenario."""
    seeds = order.choose_seeds(quick=1, paper=SEEDS)[:SEEDS]
    results = order.learn(jobs(seeds, order.budget))
    rows: list[ReportRow] = []
    what = course()
    for k, driver in enumerate(ENERGY_J):
        policies = [result.policy for result in results[k * len(seeds) : (k + 1) * len(seeds)]]
        tracks = [track_course(what, *policy_control(gains_law(scale=STATE), policy)) for policy in policies]
        kpis = [tracking_kpis(what, track) for track in tracks]
        rows += table_1({(driver, 1): kpis}, {driver: "ddpg_pid"})
        kpi, left = "speed left 3 s after the planned end", values(kpis, "end_mps")
        rows.append(make_row("Table 1", NAMES[1], driver, kpi, "m/s", left))
    episodes = STEPS[order.budget] // PERIODS
    length = f"{len(seeds)} seeds of about {episodes} episodes each; the paper does not print its number."
    told = "; ".join(f"{row.driver}: {row.ours:.2f} m/s" for row in rows if row.kpi == "total speed error")
    finding = f"Total speed error of policies learned with the printed rewards: {told}."
    return LiteralRun(rows, [length, finding])


SETTINGS = (
    PrintedSetting(
        "state (eq. 7)",
        "speed, command, speed and position error, in m/s and m",
        f"the same over {SCALE.speed_mps:g} m/s, {SCALE.error_mps:g} m/s and {SCALE.distance_m:g} m, within "
        f"{SCALE.most:g}",
        "no scaling of the state is printed, so there is none.",
    ),
    PrintedSetting(
        "weights (eq. 17)",
        "0.2 each",
        ", ".join(f"{weight:g}" for weight in REWARDS.weights),
    ),
    PrintedSetting(
        "error that halves the reward (eqs. 19 to 21)",
        "1 m/s, 1 m, 1 m/s³, 1 m at the stop",
        f"{REWARDS.speed_scale_mps:g} m/s, {REWARDS.distance_scale_m:g} m, {REWARDS.jerk_scale_mps3:g} m/s³, "
        f"{REWARDS.parking_scale_m:g} m at the stop",
        "the equations name no units; SI is taken.",
    ),
    PrintedSetting(
        "energy (eq. 22)",
        "traction work of the period, no unit",
        "kWh",
        "kWh, the unit of the paper's tables, and in a second run kJ, which force in kN (eqs. 23 and 24) "
        "times speed in m/s gives.",
    ),
    PrintedSetting(
        "tracking and comfort",
        "as they are: at best 2 and 1 in a period",
        "less their best value",
    ),
    PrintedSetting(
        "start of an episode", "standstill at the station", "half of them on the way, near the reference"
    ),
    PrintedSetting(
        "end of an episode",
        "planned end of the run; a trainset that still moves has failed",
        "standstill, at most 3 s after the planned end",
        "a failure costs nothing further: the paper prints no price for it. The KPIs of the drive are "
        "counted to standstill, as in the other tables.",
    ),
    PrintedSetting("price of saturated gains", "none", "0.003 of the squared output before tanh"),
    PrintedSetting(
        "policy kept",
        "not printed",
        "best of the evaluations on the base scenario",
        "the last one.",
    ),
    PrintedSetting(
        "episodes, sizes of the networks, rates, noise, memory",
        "not printed",
        "300,800 steps, 64 x 64, see hyper-parameters",
        "those of this study, as far as they are not listed here.",
    ),
)

AS_PRINTED = AsPrinted(SETTINGS, measure)
