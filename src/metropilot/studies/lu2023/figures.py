"""Figures 6 to 9: reward over episodes, speed and notch over distance, learned drive and PID."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from metropilot.studies.lu2023.drives import NotchRun
from metropilot.studies.lu2023.setting import plan_case
from metropilot.studies.report import Figure
from metropilot.units import KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

    from metropilot.studies.learning import SeedResult

KN = 1e-3
NAMES = {"dqn": "DQN", "improved_dqn": "improved DQN"}


def _episodes(result: SeedResult) -> np.ndarray:
    return np.cumsum(np.nan_to_num(np.asarray(result.history["episodes"], float)))


def draw_rewards(runs: Mapping[str, Sequence[SeedResult]], plan_id: str) -> Drawing:
    """Draw the return without exploration over the training episodes: median and range of the seeds."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
    for driver, results in runs.items():
        most = min(float(_episodes(r)[-1]) for r in results)
        at = np.linspace(min(float(_episodes(r)[0]) for r in results), most, 120)
        rows = [
            np.interp(at, _episodes(r), np.asarray(r.history[f"evaluation.{plan_id}.return"], float))
            for r in results
        ]
        (line,) = axes.plot(at, np.median(rows, axis=0), label=f"{NAMES[driver]}, {len(results)} seeds")
        axes.fill_between(at, np.min(rows, axis=0), np.max(rows, axis=0), color=line.get_color(), alpha=0.15)
    axes.set(xlabel="episodes", ylabel="return (eqs. 15 to 20)")
    axes.legend()
    return figure


def draw_drives(found: Sequence[NotchRun]) -> Drawing:
    """Draw speed over distance with the limit, and force below, one column per drive."""
    from matplotlib import pyplot as plt

    columns = min(len(found), 2)
    blocks = -(-len(found) // columns)
    figure, axes = plt.subplots(
        2 * blocks, columns, figsize=(9, 4.0 * blocks), squeeze=False, layout="constrained", sharex=True
    )
    for number, one in enumerate(found):
        speed = axes[2 * (number // columns), number % columns]
        force = axes[2 * (number // columns) + 1, number % columns]
        t = one.drive.trajectory
        speed.plot(
            t.position_m, KMH_PER_MPS * t.limit_mps, color="0.5", linewidth=0.8, drawstyle="steps-post"
        )
        speed.plot(t.position_m, KMH_PER_MPS * t.speed_mps)
        kwh, late = one.kpis.energy_wheel_kwh, one.kpis.time_error_s
        speed.set_title(f"{one.plan.name}, {one.driver}: {kwh:.2f} kWh, {late:+.1f} s", fontsize=8.5)
        speed.set(ylabel="speed in km/h")
        effort = KN * (t.traction_n - t.electric_brake_n - t.friction_brake_n)
        force.plot(t.position_m[:-1], effort[:-1], drawstyle="steps-post", linewidth=0.9)
        force.axhline(0.0, color="0.6", linewidth=0.5)
        force.set(ylabel="force in kN", xlabel="position in m")
    for spare in range(len(found), blocks * columns):
        for k in (0, 1):
            axes[2 * (spare // columns) + k, spare % columns].set_visible(False)
    return figure


def figures(
    drives: Sequence[NotchRun], runs: Mapping[str, Mapping[str, Sequence[SeedResult]]]
) -> list[Figure]:
    """Figures for which there are results.

    Args:
        drives: The drives of Table 5.
        runs: Learning runs by plan and driver.
    """
    drawn = []
    for number, plan_id in ((6, "120"), (7, "130")):
        if runs.get(plan_id):
            caption = f"Return over episodes, {plan_case(plan_id).name} (its Fig. {number}): median and range"
            drawn.append(Figure(f"reward_{plan_id}", caption, partial(draw_rewards, runs[plan_id], plan_id)))
    learned = [one for one in drives if one.driver == "improved_dqn"]
    caption = "Speed and notch over distance of the plans (its Fig. 8); grey is the limit"
    drawn.append(Figure("plans", caption, partial(draw_drives, learned)))
    pair = [one for one in drives if one.plan.id == "130"]
    caption = "130 s: the learned drive, and the PID that tracks its curve (its Fig. 9)"
    drawn.append(Figure("pid", caption, partial(draw_drives, pair)))
    return drawn
