"""From the histories of the learning runs to the measures of the paper's figures 5 to 19."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.studies.chen2023a.published import THRESHOLD_S
from metropilot.studies.chen2023a.setting import COMFORT, DECISION_S
from metropilot.studies.learning import SeedResult

Values = Float[ndarray, " chunks"]

CLOSE = 0.1
"""A return is near the final one when it differs by at most this share of it."""
KEPT = 0.95
"""Share of the later chunks in which the rule must hold: the paper, too, forgives a jump."""
LAST = 0.1
"""Final values are medians over this last share of the chunks."""


@dataclass(frozen=True, eq=False)
class DriveCourse:
    """How one learning run went, chunk by chunk.

    Attributes:
        episodes: Episodes ended so far.
        loss: Mean loss, as the learner minimises it.
        learning: Means over the episodes that ended in the chunk, exploration and all: ``return``,
            ``running_time_s`` (episodes that never arrive count with the time until they were stopped),
            ``energy_kwh``, ``impact_mps3``. NaN where no episode ended.
        driving: The same of the policy's own run from standstill without exploration, and
            ``stopping_error_m``, ``arrived``.
    """

    episodes: Values
    loss: Values
    learning: Mapping[str, Values]
    driving: Mapping[str, Values]


def course(result: SeedResult) -> DriveCourse:
    """The course of one run from its history."""
    history = result.history
    seconds = history["length"] * DECISION_S
    learning = {
        "return": history["return"],
        "running_time_s": seconds,
        "energy_kwh": -history["term.energy"],
        "impact_mps3": -history["term.comfort"] / COMFORT / seconds,
    }
    names = ("running_time_s", "energy_kwh", "impact_mps3", "stopping_error_m", "arrived")
    driving = {name: history[f"evaluation.{name}"] for name in names}
    driving["return"] = history["evaluation.score"]
    return DriveCourse(np.cumsum(history["episodes"]), history["loss"], learning, driving)


def converged_at(episodes: Values, running_time_s: Values, returned: Values) -> float | None:
    """Episodes after which a run has converged; None: never.

    Converged: from then on, in 95 % of the chunks, the running time is at most 88 s and the return within
    10 % of the final one (median of the last tenth).

    Args:
        episodes: Ended so far.
        running_time_s: Of each chunk; NaN holds nothing.
        returned: Return of each chunk.
    """
    final = float(np.nanmedian(returned[-last_chunks(len(returned)) :]))
    good = (running_time_s <= THRESHOLD_S) & (np.abs(returned - final) <= CLOSE * abs(final))
    later = np.cumsum(good[::-1])[::-1] / np.arange(len(good), 0, -1)
    holds = good & (later >= KEPT)
    if not good[-last_chunks(len(good)) :].mean() >= KEPT or not holds.any():
        return None
    return float(episodes[int(np.argmax(holds))])


def last_chunks(chunks: int) -> int:
    """How many chunks are the last tenth."""
    return max(1, round(LAST * chunks))


def final(values: Values) -> float:
    """Median over the last tenth of the chunks."""
    return float(np.nanmedian(values[-last_chunks(len(values)) :]))


def band(
    courses: Sequence[DriveCourse], values: Sequence[Values], grid: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """Smallest, median and largest over the seeds on a common grid of episodes.

    Args:
        courses: Of each seed.
        values: One measure of each seed.
        grid: Episodes. Shape (G,).
    """
    rows = []
    for one, measure in zip(courses, values, strict=True):
        there = np.isfinite(measure)
        rows.append(np.interp(grid, one.episodes[there], measure[there]) if there.any() else grid * np.nan)
    stacked = np.stack(rows)
    return np.nanmin(stacked, axis=0), np.nanmedian(stacked, axis=0), np.nanmax(stacked, axis=0)
