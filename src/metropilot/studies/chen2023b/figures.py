"""Figures 3 to 9, and string stability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot.convoy import ConvoyDrive, gains_of
from metropilot.evaluate import BLACK, GREY, SERIES_STYLES
from metropilot.studies.chen2023b.learning import ETAS, NAMES
from metropilot.studies.chen2023b.setting import PUBLISHED
from metropilot.studies.report import Figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

    from metropilot.studies.learning import SeedResult

Histories = Mapping[str, Sequence[Mapping[str, np.ndarray]]]


def _panels(count: int, height: float, **options: Any) -> tuple[Drawing, Any]:  # noqa: ANN401 (matplotlib's)
    from matplotlib import pyplot as plt

    return plt.subplots(count, 1, figsize=(8, height), layout="constrained", **options)


def draw_learning(histories: Histories, columns: Mapping[str, str], label: str) -> Drawing:
    """Draw a column of the history over environment steps: one panel per algorithm, one line per seed."""
    figure, axes = _panels(len(histories), 5.0, sharex=True)
    for (name, runs), panel, (colour, _) in zip(histories.items(), axes, SERIES_STYLES, strict=False):
        for run in runs:
            panel.plot(run["steps"], run[columns[name]], color=colour, linewidth=0.9)
        panel.set_title(name, loc="left", fontsize=9)
        panel.set_ylabel(label)
    axes[-1].set_xlabel("environment steps")
    return figure


def _name_eta(eta: str) -> str:
    return "eta " + ", ".join(f"{number:g}" for number in dict.fromkeys(ETAS[eta]))


def draw_returns(
    histories: Mapping[tuple[str, str], Sequence[Mapping[str, np.ndarray]]], periods: int
) -> Drawing:
    """Draw the return over episodes of so many periods; histories by follower and eta, one line a seed."""
    from matplotlib import pyplot as plt

    names, etas = (list(dict.fromkeys(part)) for part in zip(*histories, strict=True))
    shape = len(names), len(etas)
    figure, axes = plt.subplots(*shape, figsize=(8, 5), layout="constrained", sharex=True, squeeze=False)
    for (name, eta), runs in histories.items():
        panel = axes[names.index(name), etas.index(eta)]
        for run in runs:
            colour = SERIES_STYLES[names.index(name)][0]
            panel.plot(run["steps"] / periods, run["return"], color=colour, linewidth=0.7)
        panel.set_title(f"{name}, {_name_eta(eta)}", loc="left", fontsize=9)
    for row in axes:
        row[0].set_ylabel("return")
    for panel in axes[-1]:
        panel.set_xlabel("episodes")
    return figure


def draw_gains(gains: Mapping[tuple[str, str], Sequence[np.ndarray]], period_s: float) -> Drawing:
    """Draw the three gains over the run; arrays of shape (T, 3) by follower and eta, one line a seed.

    A seed that runs on after a contact is cut where most have arrived.
    """
    from matplotlib import pyplot as plt

    low, high = gains_of(-np.ones(3)), gains_of(np.ones(3))
    ends_s = period_s * float(np.median([len(run) for runs in gains.values() for run in runs]))
    shape = len(high), len(gains)
    figure, axes = plt.subplots(
        *shape, figsize=(11, 6), layout="constrained", sharex=True, sharey="row", squeeze=False
    )
    for ((name, eta), runs), column in zip(gains.items(), axes.T, strict=True):
        column[0].set_title(f"{name}, {_name_eta(eta)}", loc="left", fontsize=9)
        column[0].set_xlim(0.0, ends_s)
        column[-1].set_xlabel("time (s)")
        for k, panel in enumerate(column):
            for run, (colour, _) in zip(runs, SERIES_STYLES, strict=False):
                panel.plot(period_s * np.arange(len(run)), run[:, k], color=colour, linewidth=0.7)
            for bound in (low[k], high[k]):
                panel.axhline(bound, color=GREY, linewidth=0.8)
    for name, row in zip(high._fields, axes, strict=True):
        row[0].set_ylabel(f"{name} gain")
    return figure


def draw_profiles(drive: ConvoyDrive) -> Drawing:
    """Draw the speeds of both trainsets over time."""
    figure, axes = _panels(1, 3.6)
    for k, t in enumerate(drive.trajectories):
        name = "trainset 1 (head)" if k == 0 else f"trainset {k + 1} ({drive.follower})"
        colour, dashes = (BLACK, "-") if k == 0 else (SERIES_STYLES[0][0], (0, (6, 2)))
        axes.plot(t.time_s, t.speed_mps, color=colour, linestyle=dashes, label=name)
    axes.set(xlabel="time (s)", ylabel="speed (m/s)")
    axes.legend()
    return figure


def draw_gaps(drives: Mapping[str, ConvoyDrive]) -> Drawing:
    """Draw the gaps over time and the published band."""
    figure, axes = _panels(1, 4.2)
    axes.axhspan(PUBLISHED["gap_min_m"], PUBLISHED["gap_max_m"], color="#EDEDED", zorder=0)
    for (name, drive), (colour, dashes) in zip(drives.items(), SERIES_STYLES, strict=False):
        axes.plot(drive.time_s, drive.gap_m[:, 0], color=colour, linestyle=dashes, label=name)
    axes.set(xlabel="time (s)", ylabel="gap (m)")
    axes.legend(ncols=3)
    return figure


def draw_differences(drives: Mapping[str, ConvoyDrive]) -> Drawing:
    """Draw the speed differences over time and the published bound."""
    figure, axes = _panels(1, 4.2)
    bound = PUBLISHED["speed_difference_max_mps"]
    for level in (-bound, bound):
        axes.axhline(level, color=GREY, linewidth=0.8)
    for (name, drive), (colour, dashes) in zip(drives.items(), SERIES_STYLES, strict=False):
        apart = drive.speed_difference_mps[:, 0]
        axes.plot(drive.time_s, apart, color=colour, linestyle=dashes, label=name)
    axes.set(xlabel="time (s)", ylabel="speed ahead less own speed (m/s)")
    axes.legend(ncols=3)
    return figure


def draw_stability(gains: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Drawing:
    """Draw the ratio of the last trainset's speed amplitude to the head's over the oscillation period."""
    figure, axes = _panels(1, 4.0)
    for (name, (periods, values)), (colour, dashes) in zip(gains.items(), SERIES_STYLES, strict=False):
        axes.plot(
            periods, values[:, -1], color=colour, linestyle=dashes, marker="o", markersize=3, label=name
        )
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    axes.set(xlabel="period of the head's swing (s)", ylabel="speed swing of the last over the head's")
    axes.set_xscale("log")
    axes.legend()
    return figure


def figures(
    runs: dict[str, list[SeedResult]],
    drives: dict[str, ConvoyDrive],
    gains: dict[str, tuple[np.ndarray, np.ndarray]],
) -> list[Figure]:
    """Figures 3 to 9 of the paper, reproduced, and string stability."""
    histories = {NAMES[algorithm]: [run.history for run in each] for algorithm, each in runs.items()}
    losses = {"sac_pid": "actor_loss", "ddpg_pid_follow": "loss"}
    curves = [
        Figure(
            "rewards",
            "Figs. 3 and 4: return of the episodes while learning, one line a seed.",
            lambda: draw_learning(histories, dict.fromkeys(histories, "return"), "return of an episode"),
        ),
        Figure(
            "losses",
            "Figs. 5 and 6: policy loss of SAC, critic loss of DDPG, one line a seed.",
            lambda: draw_learning(histories, losses, "loss"),
        ),
    ]
    return [
        *(curves if runs else ()),
        Figure(
            "profiles",
            "Fig. 7: speed of both trainsets under SAC-PID.",
            lambda: draw_profiles(drives["sac_pid"]),
        ),
        Figure(
            "gap",
            "Fig. 8: gap of every follower; the band is the published 5.88 to 5.98 m.",
            lambda: draw_gaps(drives),
        ),
        Figure(
            "speed_difference",
            "Fig. 9: speed difference of every follower; published: below 0.15 m/s.",
            lambda: draw_differences(drives),
        ),
        Figure(
            "string_stability",
            "Beyond the paper: the last trainset's swing of speed over the head's; above 1 it grows.",
            lambda: draw_stability(gains),
        ),
    ]
