"""Figures 5 to 19 of the paper: five measures over episodes, a panel for each learner."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from metropilot.studies.chen2023a.drives import DriveCourse, Values, band
from metropilot.studies.chen2023a.learning import NAMES
from metropilot.studies.chen2023a.setting import THRESHOLD_S
from metropilot.studies.report import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

WIDTH_IN, HEIGHT_IN = 7.2, 2.5
POINTS = 160
ORDER = ("ddpg", "ppo", "ppo_scaled")


@dataclass(frozen=True)
class Panel:
    """One measure and its axis.

    Attributes:
        name: Key in a course, and name of the figure.
        label: Axis with unit.
        caption: Caption of the figure, with the paper's numbers.
        line: Height and label of a horizontal line.
        span: Lowest and highest displayed value.
    """

    name: str
    label: str
    caption: str
    line: tuple[float, str] | None = None
    span: tuple[float, float] = (0.0, 1.0)


def figures(courses: Mapping[str, Sequence[DriveCourse]], optimum_kwh: float) -> list[Figure]:
    """Figures of the learning courses of every learner.

    Args:
        courses: Courses of all seeds, by learner.
        optimum_kwh: Certified least energy at the threshold.
    """
    band_text = (
        "Blue: the policy's own run from standstill; orange: episodes with exploration. "
        "Lines: median over the seeds; areas: their range"
    )
    parts = [part for mine in courses.values() for one in mine for part in (one.learning, one.driving)]
    impacts = [part["impact_mps3"] for part in parts]
    panels = (
        Panel(
            "return", "return", f"Return over episodes (its figs. 5 to 7). {band_text}.", span=(-260.0, 110.0)
        ),
        Panel(
            "running_time_s",
            "running time in s",
            f"Running time over episodes with the threshold of 88 s (its figs. 11 to 13). {band_text}.",
            line=(THRESHOLD_S, "88 s"),
            span=(66.0, 132.0),
        ),
        Panel(
            "energy_kwh",
            "energy at wheel in kWh",
            f"Energy over episodes, with the certified optimum in 88 s (its figs. 14 to 16). {band_text}.",
            line=(optimum_kwh, "optimum in 88 s"),
            span=(0.0, 30.0),
        ),
        Panel(
            "impact_mps3",
            "mean impact rate in m/s³",
            f"Mean impact rate over episodes (its figs. 17 to 19). {band_text}.",
            # a little above nearly all values
            span=(0.0, 1.1 * float(np.nanquantile(np.concatenate(impacts), 0.995))),
        ),
    )
    loss = "Loss over episodes (its figs. 8 to 10), each learner's own: compare the course, not the size."
    made = [
        Figure(p.name.rpartition("_")[0] or "reward", p.caption, partial(_draw, courses, _measure(p)))
        for p in panels
    ]
    return [made[0], Figure("loss", loss, partial(_draw, courses, _loss)), *made[1:]]


Draw = Callable[["Axes", Sequence[DriveCourse], np.ndarray], None]


def _draw(courses: Mapping[str, Sequence[DriveCourse]], draw: Draw) -> Drawing:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as New

    figure = New(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    FigureCanvasAgg(figure)
    learners = [name for name in ORDER if name in courses]
    every = figure.subplots(1, len(learners), sharey=draw is not _loss, squeeze=False)[0]
    for axes, name in zip(every, learners, strict=True):
        mine = courses[name]
        last = max(float(one.episodes[-1]) for one in mine)
        first = max(float(one.episodes[0]) for one in mine)
        draw(axes, mine, np.linspace(first, last, POINTS))
        axes.set_title(NAMES[name], loc="left", fontsize=9)
        axes.set_xlabel("episodes")
        axes.set_xlim(0.0, last)
        axes.xaxis.set_major_formatter(lambda x, _: f"{x:,.0f}")
        axes.locator_params(axis="x", nbins=4)
    return figure


def _is_first(axes: Axes) -> bool:
    place = axes.get_subplotspec()
    return place is not None and place.is_first_col()


def _measure(panel: Panel) -> Draw:
    def draw(axes: Axes, mine: Sequence[DriveCourse], grid: np.ndarray) -> None:
        from metropilot.evaluate import BLUE, GREY, ORANGE

        for kind, colour, width in (("learning", ORANGE, 0.9), ("driving", BLUE, 1.3)):
            values = [getattr(one, kind)[panel.name] for one in mine]
            _band(axes, mine, values, grid, (colour, width, 0.22 if kind == "driving" else 0.3))
        if panel.line is not None:
            at, words = panel.line
            axes.axhline(at, color=GREY, linewidth=0.8, linestyle=(0, (4, 2)))
            if _is_first(axes):
                where = {"textcoords": "offset points", "xytext": (-2, 2), "ha": "right"}
                axes.annotate(
                    words, (1.0, at), xycoords=("axes fraction", "data"), fontsize=7, color=GREY, **where
                )
        axes.set_ylim(*panel.span)
        if _is_first(axes):
            axes.set_ylabel(panel.label)

    return draw


def _loss(axes: Axes, mine: Sequence[DriveCourse], grid: np.ndarray) -> None:
    """Draw the loss of one learner on a symmetric logarithmic axis."""
    from metropilot.evaluate import BLUE

    values = [one.loss for one in mine]
    _band(axes, mine, values, grid, (BLUE, 1.0, 0.25))
    sizes = np.abs(np.concatenate(values))
    low, high = (float(np.nanquantile(sizes, share)) for share in (0.02, 1.0))
    if high > 50.0 * max(low, 1.0):
        axes.set_yscale("symlog", linthresh=1.0)
    if _is_first(axes):
        axes.set_ylabel("loss")


def _band(
    axes: Axes,
    mine: Sequence[DriveCourse],
    values: Sequence[Values],
    grid: np.ndarray,
    look: tuple[str, float, float],
) -> None:
    colour, width, alpha = look
    low, middle, high = band(mine, values, grid)
    axes.fill_between(grid, low, high, color=colour, alpha=alpha, linewidth=0)
    axes.plot(grid, middle, color=colour, linewidth=width)
