"""Figures 7 to 10: errors over time, speed under other resistances and other references."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from metropilot.studies.cheng2023.setting import NAMES
from metropilot.studies.cheng2023.tracking import TrackRecord
from metropilot.studies.report import Figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

Records = Mapping[tuple[str, int], TrackRecord]
"""A record for each driver and scenario."""


def _counted_mask(record: TrackRecord) -> np.ndarray:
    return np.asarray(record.counted, bool)


def draw_errors(records: Records, field: str, label: str) -> Drawing:
    """Draw an error over time in the base scenario, one line per driver."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4))
    for (driver, scenario), record in records.items():
        if scenario != 1:
            continue
        keep = _counted_mask(record)
        wide = driver == "ddpg_pid"
        axes.plot(
            record.time_s[keep],
            getattr(record, field)[keep],
            label=driver,
            linewidth=1.8 if wide else 0.9,
            linestyle="--" if driver.endswith("tuned") else "-",
            zorder=3 if wide else 2,
        )
    axes.axhline(0.0, color="0.6", linewidth=0.6)
    axes.set(xlabel="time in s", ylabel=label)
    axes.legend(ncols=2, fontsize=8)
    return figure


def draw_profiles(records: Records, scenarios: tuple[int, ...], over: str) -> Drawing:
    """Draw the speed of DDPG-PID with its reference in some scenarios, the error below."""
    from matplotlib import pyplot as plt

    figure, (speeds, errors) = plt.subplots(
        2, 1, figsize=(8, 5.5), sharex=True, height_ratios=(2, 1), layout="constrained"
    )
    for scenario in scenarios:
        record = records["ddpg_pid", scenario]
        keep = _counted_mask(record)
        at = getattr(record, over)[keep]
        (line,) = speeds.plot(at, record.speed_mps[keep], label=NAMES[scenario])
        speeds.plot(at, record.reference_mps[keep], color="0.3", linewidth=0.7, linestyle=":")
        errors.plot(at, record.error_mps[keep], color=line.get_color(), linewidth=0.9)
    speeds.set(ylabel="speed in m/s (dotted: reference)")
    speeds.legend(fontsize=8)
    errors.set(xlabel="time in s" if over == "time_s" else "position in m", ylabel="error in m/s")
    return figure


def figures(records: Records) -> tuple[Figure, ...]:
    """Figures 7 to 10 of the paper, reproduced."""
    return (
        Figure(
            "speed_errors",
            "Speed error over time in the base scenario, all drivers (Cheng23 fig. 7).",
            lambda: draw_errors(records, "error_mps", "speed error in m/s"),
        ),
        Figure(
            "position_errors",
            "Position error over time in the base scenario, all drivers (Cheng23 fig. 8).",
            lambda: draw_errors(records, "distance_m", "position error in m"),
        ),
        Figure(
            "resistance",
            "DDPG-PID under half, plain and one and a half times the resistance (Cheng23 fig. 9).",
            lambda: draw_profiles(records, (1, 2, 3), "time_s"),
        ),
        Figure(
            "references",
            "DDPG-PID on the base, the faster and the slower reference (Cheng23 fig. 10).",
            lambda: draw_profiles(records, (1, 4, 5), "position_m"),
        ),
    )
