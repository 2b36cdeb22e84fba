"""Figures of a drive, a comparison, a plan, and the time-energy front, over distance or running time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.evaluate.comparison import Entry
from metropilot.evaluate.explanation import traction_work_j
from metropilot.evaluate.kpis import JERK_CHECK, Kpis
from metropilot.evaluate.optimum import Optimum
from metropilot.evaluate.style import (
    BLACK,
    BLUE,
    FAINT,
    GREY,
    ORANGE,
    PALE,
    SKY,
    VERMILION,
    add_headline,
    driver_styles,
    house_style,
    label_panel,
    new_panels,
)
from metropilot.physics import restrictive_profile
from metropilot.planning import Call, Front, Plan
from metropilot.railway import Section, Trainset
from metropilot.sim import Drive
from metropilot.units import J_PER_KWH, KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 8.4, 7.2
HEIGHTS = (10.0, 2.2, 2.6, 4.2)
KEY_ROWS, KEY_COLUMNS, DRIVER_IN = 4, 3, 0.12
"""Drivers in one column of the key of their energies, columns at most; height of each driver beyond them."""


def profile_figure(drive: Drive, kpis: Kpis, optimum: Optimum | None) -> Figure:
    """Draw a drive.

    Args:
        drive: The drive.
        kpis: Its KPIs, for the line under the title.
        optimum: The optimal plan, if there is one.
    """
    with house_style():
        figure, (speed, gradient, command, energy) = new_panels(WIDTH_IN, HEIGHT_IN, HEIGHTS)
        draw_speed(speed, drive, optimum)
        draw_gradient(gradient, drive.section)
        draw_command(command, drive)
        draw_energy(energy, drive, optimum)
        set_distance(energy, drive.section, float(drive.trajectory.position_m[-1]))
        trainset = drive.run.trainset
        title = f"{name_section(drive.section)}, {trainset.id} {trainset.load}, driver {drive.driver}"
        add_headline(speed, title, subtitle(kpis))
        return figure


def set_distance(axes: Axes, section: Section, furthest_m: float) -> None:
    """Set the common distance axis: from the origin to the stop, or to the furthest position if beyond."""
    margin = 0.012 * section.length_m
    axes.set_xlim(-margin, max(section.length_m, furthest_m) + margin)
    axes.set_xlabel(f"distance from {section.origin.name} (m)")


def name_section(section: Section) -> str:
    """Stations and length of a section, for the headline."""
    return f"{section.origin.name} – {section.destination.name}, {section.length_m:.0f} m"


def subtitle(kpis: Kpis) -> str:
    """Main KPIs in one line."""
    side = "beyond" if kpis.stopping_error_m > 0 else "short of"
    ended = kpis.outcome.replace("_", " ")
    words = [
        f"{ended} after {kpis.running_time_s:.1f} s (scheduled {kpis.scheduled_time_s:g} s)",
        f"{100 * abs(kpis.stopping_error_m):.0f} cm {side} the stop",
        f"wheel {kpis.energy_wheel_kwh:.2f}, line {kpis.energy_line_kwh:.2f} kWh",
    ]
    if kpis.optimality_gap_percent is not None:
        words.append(f"optimum {kpis.optimality_gap_percent:+.1f} %".replace("-", "−"))
    if kpis.interventions:
        words.append(f"{kpis.interventions} intervention{'s' if kpis.interventions > 1 else ''}")
    if JERK_CHECK in kpis.failed:
        words.append(f"jerk {kpis.max_jerk_mps3:.1f} m/s³")
    return " · ".join(words)


def draw_speed(axes: Axes, drive: Drive, optimum: Optimum | None) -> None:
    """Speed over distance with limit, permitted speed, plan and stations."""
    t = drive.trajectory
    draw_limits(axes, drive.section, drive.trainset)
    axes.plot(
        t.position_m,
        KMH_PER_MPS * t.permitted_mps,
        color=ORANGE,
        lw=1.0,
        ls=(0, (2, 1.5)),
        label="permitted speed",
    )
    if optimum is not None:
        draw_plan(axes, optimum.plan, "optimal plan")
    axes.plot(t.position_m, KMH_PER_MPS * t.speed_mps, color=BLUE, lw=1.5, label="driven")
    began = np.flatnonzero(np.diff(drive.overruled.astype(int), prepend=0) > 0)
    if began.size:
        at = t.position_m[began], KMH_PER_MPS * t.speed_mps[began]
        axes.plot(*at, ls="none", marker="v", ms=6, color=VERMILION, mec=BLACK, mew=0.5, label="protection")
    top = max(float(KMH_PER_MPS * t.limit_mps.max()), float(KMH_PER_MPS * t.speed_mps.max()))
    axes.set_ylim(0, 1.09 * top)
    draw_stations(axes, drive.section)
    axes.set_ylabel("speed (km/h)")


def draw_plan(axes: Axes, plan: Plan, name: str) -> None:
    """Draw the speed of a plan as a broad pale band behind a drive."""
    at, speed = fine_profile(plan.position_m, KMH_PER_MPS * plan.speed_mps)
    axes.plot(at, speed, color=SKY, lw=4.5, alpha=0.75, solid_capstyle="round", label=name)


def fine_profile(
    position_m: Float[ndarray, " nodes"], speed: Float[ndarray, " nodes"]
) -> tuple[Float[ndarray, " fine"], Float[ndarray, " fine"]]:
    """Refine a speed profile between its nodes, where the square of the speed is linear in distance."""
    at = np.unique(np.concatenate([np.linspace(position_m[0], position_m[-1], 800), position_m]))
    return at, np.sqrt(np.interp(at, position_m, speed**2))


def draw_limits(axes: Axes, section: Section, trainset: Trainset) -> None:
    """The limit for the trainset's head, shaded above, and restrictions hatched."""
    starts, limits = restrictive_profile(section, trainset.length_m, trainset.max_speed_mps)
    edges = np.append(starts, section.length_m + 500.0)
    values = KMH_PER_MPS * np.append(limits, limits[-1])
    axes.fill_between(edges, values, 1e3, step="post", color=FAINT, lw=0, zorder=0.5)
    axes.step(edges, values, where="post", color=BLACK, lw=1.1, label="speed limit")
    for index, restriction in enumerate(section.restrictions):
        axes.fill_between(
            [restriction.from_m, restriction.to_m],
            KMH_PER_MPS * restriction.limit_mps,
            1e3,
            facecolor="none",
            edgecolor=VERMILION,
            hatch="////",
            lw=0.6,
            zorder=0.6,
            label="temporary restriction" if index == 0 else None,
        )


def draw_stations(axes: Axes, section: Section) -> None:
    """Draw the two stations as lines with their codes."""
    for station, at, side in (
        (section.origin, 0.0, "left"),
        (section.destination, section.length_m, "right"),
    ):
        axes.axvline(at, color=GREY, lw=0.8, ls=(0, (1, 1.5)), zorder=0.7)
        nudge = 5 if side == "left" else -5
        axes.annotate(
            station.code,
            (at, 0),
            xycoords=("data", "axes fraction"),
            xytext=(nudge, 5),
            textcoords="offset points",
            ha=side,
            fontsize=8.5,
            fontweight="bold",
            color="#404040",
        )


def draw_gradient(axes: Axes, section: Section) -> None:
    """The gradient strip: height of each step is the gradient, its number written where there is room."""
    window = section.gradient_permil.window(-1.0, section.length_m + 1.0)
    edges = np.append(window.from_m, section.length_m + 1.0)
    worst = max(float(np.abs(window.value).max()), 1.0)
    axes.stairs(window.value, edges, fill=True, color=PALE, lw=0)
    axes.stairs(window.value, edges, color=GREY, lw=0.7, baseline=None)
    axes.axhline(0, color="#404040", lw=0.6)
    axes.set_ylim(-2.1 * worst, 2.1 * worst)
    axes.set_yticks([])
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(bottom=False)
    axes.grid(visible=False)
    for left, right, value in zip(edges[:-1], edges[1:], window.value, strict=True):
        if right - left > 0.05 * section.length_m:
            axes.annotate(
                f"{value:+.1f}".replace("-", "−") if value else "0",
                (0.5 * (max(left, 0.0) + right), value),
                xytext=(0, 2 if value >= 0 else -2),
                textcoords="offset points",
                ha="center",
                va="bottom" if value >= 0 else "top",
                fontsize=7,
                color="#404040",
            )
    label_panel(axes, "gradient (‰), uphill above the line")


def draw_command(axes: Axes, drive: Drive) -> None:
    """Draw the command after protection: traction above zero, braking below, coasting at zero."""
    t = drive.trajectory
    share = t.command
    axes.fill_between(t.position_m, np.maximum(share, 0), step="post", color=BLUE, alpha=0.35, lw=0)
    axes.fill_between(t.position_m, np.minimum(share, 0), step="post", color=VERMILION, alpha=0.45, lw=0)
    axes.step(t.position_m, share, where="post", color="#202020", lw=0.8)
    axes.axhline(0, color="#404040", lw=0.6)
    axes.set_ylim(-1.12, 1.12)
    axes.set_yticks([-1, 0, 1], ["brake", "coast", "power"])
    label_panel(axes, "command, share of the effort available")


def draw_energy(axes: Axes, drive: Drive, optimum: Optimum | None) -> None:
    """Draw the cumulative energy at the wheel and at the line, with that of the plan."""
    t = drive.trajectory
    if optimum is not None:
        plan = optimum.plan
        used = traction_work_j(plan) / J_PER_KWH
        axes.plot(plan.position_m, used, color=SKY, lw=4.5, alpha=0.75, label="optimal plan, at the wheel")
    axes.plot(t.position_m, t.energy_wheel_j / J_PER_KWH, color=BLUE, label="driven, at the wheel")
    axes.plot(
        t.position_m,
        t.energy_line_j / J_PER_KWH,
        color=GREY,
        lw=1.1,
        ls=(0, (5, 2)),
        label="driven, net at the line",
    )
    axes.set_ylim(0, 1.35 * axes.get_ylim()[1])
    axes.set_ylabel("energy (kWh)")
    axes.legend(loc="upper left", borderaxespad=0.2, labelspacing=0.3)


def comparison_figure(entries: Sequence[Entry]) -> Figure:
    """Speed, gradient and energy of every driver's first drive on one run.

    Args:
        entries: At least one; all on the same run.
    """
    with house_style():
        height_in = 6.6 + DRIVER_IN * max(len(entries) - KEY_ROWS, 0)
        figure, (speed, gradient, energy) = new_panels(8.4, height_in, (10.0, 2.2, 5.0))
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
        columns = min(1 + (len(entries) - 1) // KEY_ROWS, KEY_COLUMNS)
        key = energy.legend(loc="upper left", borderaxespad=0.2, labelspacing=0.3, ncols=columns)
        furthest = max(float(e.drives[0].trajectory.position_m[-1]) for e in entries)
        set_distance(energy, first.section, furthest)
        below = f"{first.run.trainset.id} {first.run.trainset.load}, scheduled {first.scheduled_time_s:g} s"
        add_headline(speed, name_section(first.section), below)
        # the curves stay below their key
        free = (key.get_window_extent().y0 - energy.bbox.y0) / energy.bbox.height
        energy.set_ylim(0, energy.get_ylim()[1] / free)
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
            look = {"marker": "D", "ms": 6, "color": ORANGE, "mec": "#202020", "mew": 0.7, "ls": "none"}
            axes.plot([planned.running_time_s], [at], **look)
            words_of_plan = f"planned {planned.running_time_s:g} s: {at:.2f} kWh, {_saves(planned)}"
            _price(axes, words_of_plan, planned, "#202020")
        for k in range(0, len(front.plans), 2):
            if planned is None or abs(front.time_s[k] - planned.running_time_s) > 0.06 * front.minimum_s:
                _price(axes, _saves(front.plans[k]), front.plans[k], GREY)
        axes.set_ylim(0, 1.05 * float(energy.max()))
        axes.set_xlabel("running time (s)")
        axes.set_ylabel(
            "traction energy at the wheel (kWh)" if objective == "wheel" else "net energy at the line (kWh)"
        )
        below = f"{words}: what a running time costs, and what one more second saves"
        add_headline(axes, name_section(section), below)
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
        used = traction_work_j(plan) / J_PER_KWH
        energy.plot(plan.position_m, used, color=BLUE)
        energy.set_ylim(0, None)
        energy.set_ylabel("energy (kWh)")
        label_panel(energy, "traction energy at the wheel")
        set_distance(energy, section, section.length_m)
        energy_kwh = plan.energy_j / J_PER_KWH
        below = (
            f"{trainset.id} {trainset.load}, {energy_kwh:.2f} kWh in {plan.running_time_s:.1f} s of running"
        )
        add_headline(speed, name_section(section), below)
        return figure
