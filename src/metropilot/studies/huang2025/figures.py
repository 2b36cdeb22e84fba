"""Figures 5 to 13: learning curves, and speed over distance of the cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from metropilot.studies.huang2025.drives import EvaluatedRun
from metropilot.studies.huang2025.setting import EITOP, EXPERTS, LEARNED_IE
from metropilot.studies.report import Figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

    from metropilot.studies.learning import SeedResult


def draw_learning(results: Sequence[SeedResult], column: str, label: str, lines: Sequence[float]) -> Drawing:
    """Draw one measure of case 1 over the training episodes: median and range of the seeds."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
    episodes = [np.cumsum(np.nan_to_num(np.asarray(r.history["episodes"], float))) for r in results]
    at = np.linspace(max(e[0] for e in episodes), min(e[-1] for e in episodes), 120)
    rows = [
        np.interp(at, e, np.asarray(r.history[f"evaluation.{column}"], float))
        for e, r in zip(episodes, results, strict=True)
    ]
    (line,) = axes.plot(at, np.median(rows, axis=0), label=f"EITOP, {len(results)} seeds")
    axes.fill_between(at, np.min(rows, axis=0), np.max(rows, axis=0), color=line.get_color(), alpha=0.15)
    for value in lines:
        axes.axhline(value, color="0.5", linewidth=0.8, linestyle="--")
    axes.set(xlabel="episodes, all environments", ylabel=label, xscale="log")
    axes.legend()
    return figure


def draw_speeds(found: Sequence[EvaluatedRun]) -> Drawing:
    """Draw speed over distance with the limit, one line per driver (its first drive)."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 3.8), layout="constrained")
    for number, one in enumerate(found):
        t = one.drives[0].trajectory
        if number == 0:
            axes.plot(t.position_m, t.limit_mps, color="0.5", linewidth=0.8, drawstyle="steps-post")
        axes.plot(t.position_m, t.speed_mps, label=_label(one, found))
    axes.set(xlabel="position in m", ylabel="speed in m/s")
    axes.legend(fontsize=8)
    return figure


def _label(one: EvaluatedRun, found: Sequence[EvaluatedRun]) -> str:
    same = len({other.driver for other in found}) == 1
    return f"{one.case.name}" if same else one.driver


def draw_tracks(found: Sequence[EvaluatedRun]) -> Drawing:
    """Draw speed limit and gradient of sections, as averaged over the trainset (Figs. 4 and 12)."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, len(found), figsize=(9, 3.6), squeeze=False, layout="constrained")
    for k, one in enumerate(found):
        t = one.drives[0].trajectory
        axes[0, k].plot(t.position_m, t.limit_mps, drawstyle="steps-post", color="0.3")
        axes[0, k].set_title(one.case.name, fontsize=8.5)
        axes[1, k].plot(t.position_m, t.gradient_permil)
        axes[1, k].set(xlabel="position in m")
    axes[0, 0].set(ylabel="limit in m/s")
    axes[1, 0].set(ylabel="gradient in ‰")
    return figure


def draw_stops(stops: Sequence) -> Drawing:
    """Draw stopping error and gain over repeated stops."""
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.0), layout="constrained")
    for one in stops:
        number = np.arange(1, len(one.error_m) + 1)
        left.plot(number, 100.0 * np.asarray(one.error_m), "o-", markersize=3, label=f"gain {one.gain:g}")
        right.plot(number, one.learned, "o-", markersize=3)
    left.set(xlabel="stop", ylabel="stopping error in cm")
    right.set(xlabel="stop", ylabel="gain learned")
    left.legend()
    return figure


def figures(
    found: Mapping[tuple[str, str], EvaluatedRun], learned: Sequence[SeedResult], stops: Sequence
) -> list[Figure]:
    """Figures for which there are results.

    Args:
        found: Drives by case and driver.
        learned: EITOP's learning runs.
        stops: Repeated stops.
    """
    drawn: list[Figure] = []
    if learned:
        for name, column, label, lines, number in (
            ("learning_energy", "case1_ie_jpkg", "Ie of case 1 in J/kg", LEARNED_IE, 5),
            ("learning_time", "case1_time_s", "running time of case 1 in s", (98.0, 104.0), 6),
        ):
            caption = f"{label} while EITOP learns (its Fig. {number}): median and range"
            drawn.append(Figure(name, caption, partial(draw_learning, learned, column, label, lines)))

    def of(cases: Sequence[str], drivers: Sequence[str]) -> list[EvaluatedRun]:
        return [found[c, d] for c in cases for d in drivers if (c, d) in found]

    def every(case: str) -> list[EvaluatedRun]:
        return [one for (c, _), one in found.items() if c == case]

    rows = (
        ("case1_expert", "Case 1, EITOE and EITOP (its Fig. 7)", of(["101"], EXPERTS)),
        ("case1", "Case 1, every driver (its Fig. 8)", every("101")),
        ("case2_95", "95 s, every driver (its Fig. 9)", every("95")),
        ("case2_115", "115 s, every driver (its Fig. 10)", every("115")),
        (
            "late_news",
            "EITOP with a new arrival time (its Fig. 11)",
            of(["101", "later", "earlier"], [EITOP]),
        ),
        ("restriction", "A temporary restriction sent at 30 s", of(["restricted"], EXPERTS)),
        ("case3_sjz_xc", "Case 3, SJZ to XC (its Fig. 13)", of(["sjz"], EXPERTS)),
        ("case3_xc_xhm", "Case 3, XC to XHM (its Fig. 13)", of(["xc"], EXPERTS)),
    )
    drawn += [Figure(name, caption, partial(draw_speeds, many)) for name, caption, many in rows if many]
    tracks = of(["101", "sjz", "xc"], ["eitoe"])
    drawn.append(Figure("tracks", "Limits and gradients (its Figs. 4 and 12)", partial(draw_tracks, tracks)))
    drawn.append(Figure("stops", "Stops with a brake off by 30 %", partial(draw_stops, stops)))
    return drawn
