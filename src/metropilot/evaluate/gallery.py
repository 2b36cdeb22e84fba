"""Figures of comparisons, of plans, and of the time-energy front."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from metropilot.evaluate.comparison import Entry
from metropilot.evaluate.picture import (
    draw_gradient,
    draw_limits,
    draw_plan,
    draw_stations,
    fine_profile,
    set_distance,
)
from metropilot.evaluate.style import (
    BLUE,
    GREY,
    ORANGE,
    VERMILION,
    add_headline,
    driver_styles,
    house_style,
    label_panel,
    new_panels,
)
from metropilot.planning import Call, Front, Plan
from metropilot.railway import Section, Trainset
from metropilot.units import J_PER_KWH, KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def comparison_figure(entries: Sequence[Entry]) -> Figure:
    """Speed, gradient and energy of every driver's first drive on one run.

    Args:
        entries: At least one; all on the same run.
    """
    with house_style():
        figure, (speed, gradient, energy) = new_panels(8.4, 6.6, (10.0, 2.2, 5.0))
        first = entries[0].drives[0]
        draw_limits(speed, first.section, first.trainset)
        if entries[0].optimum is not None:
            draw_plan(speed, entries[0].optimum.plan, f"optimum for the time of {entries[0].driver}")
        styles = driver_styles([entry.driver for entry in entries])
        for entry in entries:
            look = dict(zip(("color", "ls"), styles[entry.driver], strict=True))
            t = entry.drives[0].trajectory
            used = t.energy_wheel_j / J_PER_KWH
            total = f"{entry.driver}: {used[-1]:.1f} kWh in {entry.kpis[0].running_time_s:.1f} s"
            speed.plot(t.position_m, KMH_PER_MPS * t.speed_mps, label=entry.driver, **look)
            energy.plot(t.position_m, used, label=total, **look)
        top = max(float(KMH_PER_MPS * e.drives[0].trajectory.limit_mps.max()) for e in entries)
        speed.set_ylim(0, 1.09 * top)
        speed.set_ylabel("speed (km/h)")
        draw_stations(speed, first.section)
        draw_gradient(gradient, first.section)
        energy.set_ylabel("energy (kWh)")
        label_panel(energy, "traction energy at the wheel")
        energy.set_ylim(0, (1.1 + 0.1 * len(entries)) * energy.get_ylim()[1])
        energy.legend(loc="upper left", borderaxespad=0.2, labelspacing=0.3)
        furthest = max(float(e.drives[0].trajectory.position_m[-1]) for e in entries)
        set_distance(energy, first.section, furthest)
        section, trainset = first.section, first.run.trainset
        title = f"{section.origin.name} – {section.destination.name}, {section.length_m:.0f} m"
        add_headline(speed, title, f"{trainset.id} {trainset.load}, scheduled {first.scheduled_time_s:g} s")
        return figure


def front_figure(section: Section, front: Front, planned: Plan | None, words: str, objective: str) -> Figure:
    """Optimal energy over running time, with the planned time and the marginal energy of a second.

    Args:
        section: Section.
        front: Its time-energy front.
        planned: The plan for the line's planned time, if there is one.
        words: Trainset, for the headline.
        objective: ``wheel`` or ``line``.
    """
    with house_style():
        figure, (axes,) = new_panels(6.4, 4.6, (1.0,))
        energy = front.energy_j / J_PER_KWH
        axes.plot(front.time_s, energy, color=BLUE, marker="o", ms=4, label="optimal plan")
        axes.axvline(front.minimum_s, color=VERMILION, lw=1.1, ls=(0, (4, 2)))
        axes.annotate(
            f"minimum {front.minimum_s:.1f} s",
            (front.minimum_s, 0.0),
            xycoords=("data", "axes fraction"),
            xytext=(5, 5),
            textcoords="offset points",
            color=VERMILION,
        )
        if planned is not None:
            at = planned.energy_j / J_PER_KWH
            axes.plot(
                [planned.running_time_s],
                [at],
                marker="D",
                ms=6,
                color=ORANGE,
                mec="#202020",
                mew=0.7,
                ls="none",
            )
            _price(
                axes,
                f"planned {planned.running_time_s:g} s: {at:.2f} kWh, {_saves(planned)}",
                planned,
                "#202020",
            )
        for k in range(0, len(front.plans), 2):
            if planned is None or abs(front.time_s[k] - planned.running_time_s) > 0.06 * front.minimum_s:
                _price(axes, _saves(front.plans[k]), front.plans[k], GREY)
        axes.set_ylim(0, 1.05 * float(energy.max()))
        axes.set_xlabel("running time (s)")
        axes.set_ylabel(
            "traction energy at the wheel (kWh)" if objective == "wheel" else "net energy at the line (kWh)"
        )
        title = f"{section.origin.name} – {section.destination.name}, {section.length_m:.0f} m"
        add_headline(axes, title, f"{words}: what a running time costs, and what one more second saves")
        return figure


def _saves(plan: Plan) -> str:
    return f"{plan.second_w / 1000:.0f} kJ/s"


def _price(axes: Axes, text: str, plan: Plan, colour: str) -> None:
    """Annotate a point of the front above and to its right, where a falling curve leaves room."""
    at = (plan.running_time_s, plan.energy_j / J_PER_KWH)
    axes.annotate(text, at, xytext=(5, 4), textcoords="offset points", fontsize=8, color=colour)


def plan_figure(section: Section, trainset: Trainset, plan: Plan, calls: Sequence[Call] = ()) -> Figure:
    """A plan without a drive: speed with the limit, gradient, and energy over distance.

    Args:
        section: The section, or all of a journey.
        trainset: Trainset with its load.
        plan: Its plan.
        calls: Stops on the way of a journey.
    """
    with house_style():
        figure, (speed, gradient, energy) = new_panels(13.0 if calls else 8.4, 5.6, (10.0, 2.2, 4.0))
        draw_limits(speed, section, trainset)
        at, profile = fine_profile(plan.position_m, KMH_PER_MPS * plan.speed_mps)
        speed.plot(at, profile, color=BLUE, label="optimal plan")
        speed.set_ylim(0, 1.12 * KMH_PER_MPS * trainset.max_speed_mps)
        speed.set_ylabel("speed (km/h)")
        draw_stations(speed, section)
        for call in calls[1:-1]:
            speed.axvline(call.position_m, color=GREY, lw=0.8, ls=(0, (1, 1.5)), zorder=0.7)
            where = {"xycoords": ("data", "axes fraction"), "xytext": (0, -3), "textcoords": "offset points"}
            speed.annotate(
                call.name, (call.position_m, 1.0), ha="center", va="top", fontsize=8, weight="bold", **where
            )
        draw_gradient(gradient, section)
        used = np.concatenate([[0.0], np.cumsum(plan.traction_n * np.diff(plan.position_m))]) / J_PER_KWH
        energy.plot(plan.position_m, used, color=BLUE)
        energy.set_ylim(0, None)
        energy.set_ylabel("energy (kWh)")
        label_panel(energy, "traction energy at the wheel")
        set_distance(energy, section, section.length_m)
        title = f"{section.origin.name} – {section.destination.name}, {section.length_m:.0f} m"
        energy_kwh = plan.energy_j / J_PER_KWH
        below = (
            f"{trainset.id} {trainset.load}, {energy_kwh:.2f} kWh in {plan.running_time_s:.1f} s of running"
        )
        add_headline(speed, title, below)
        return figure
