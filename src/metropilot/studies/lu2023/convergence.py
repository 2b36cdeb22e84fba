"""When a learning run has converged, and how much sooner one learner does than another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from metropilot.sim import PUNCTUALITY_S, STOP_TOLERANCE_M
from metropilot.studies.lu2023.optima import NotchFront

STEADY = 3
"""So many evaluations in a row that meet the demands are called steady."""
ABOVE = 0.08
OVERSPEED_MPS = 1e-3
RESAMPLES = 10_000
RULE = " ".join(
    f"""A run has converged at its first evaluation (forty a run, each one drive from standstill without
    exploration) that arrives within 3 s of the schedule and 0.3 m of the stop, without overspeed, at most
    {100 * ABOVE:.0f} % above the optimum over the same notches for the running time achieved: the policy kept
    is the best one evaluated, so that from then on there is one to ship. A run that never does counts with
    its whole length: a median that reaches it is a lower bound, and so is what a comparison with it says.
    Steady are runs that do so in {STEADY} evaluations in a row; the tables say how many are.""".split()
)


@dataclass(frozen=True)
class Converged:
    """What the rule says of a run.

    Attributes:
        episodes: Episodes learned from until it converged, or in all.
        converged: Whether it did.
    """

    episodes: float
    converged: bool


def meets(history: Mapping[str, ndarray], plan_id: str, scheduled_s: float, front: NotchFront) -> ndarray:
    """Which evaluations meet the rule's demands. Shape (E,), bool."""
    column = {
        name: np.asarray(history[f"evaluation.{plan_id}.{name}"], float)
        for name in ("kwh", "late_s", "stop_m", "over_mps", "arrived")
    }
    above = column["kwh"] * 3.6e6 / front.at(scheduled_s + column["late_s"]) - 1.0
    return (
        (column["arrived"] > 0.5)
        & (np.abs(column["late_s"]) <= PUNCTUALITY_S)
        & (np.abs(column["stop_m"]) <= STOP_TOLERANCE_M)
        & (column["over_mps"] <= OVERSPEED_MPS)
        & (above <= ABOVE)
    )


def converged(history: Mapping[str, ndarray], good: ndarray, in_a_row: int = 1) -> Converged:
    """Apply the rule to the evaluations that meet its demands.

    Args:
        history: Of the run.
        good: Which evaluations meet the demands, from :func:`meets`. Shape (E,), bool.
        in_a_row: How many in a row are asked for.
    """
    episodes = np.cumsum(np.nan_to_num(np.asarray(history["episodes"], float)))
    runs = np.convolve(good.astype(int), np.ones(in_a_row, int), mode="valid") == in_a_row
    if runs.any():
        return Converged(float(episodes[int(np.argmax(runs))]), True)
    return Converged(float(episodes[-1]), False)


@dataclass(frozen=True)
class Faster:
    """How much sooner the one converges than the other: median of the ratio less one, with its interval.

    Attributes:
        percent: Ratio of the medians less one.
        low: Lower end of the 95 % bootstrap interval over the seeds.
        high: Upper end.
    """

    percent: float
    low: float
    high: float


def faster(slow: Sequence[Converged], fast: Sequence[Converged], seed: int = 0) -> Faster:
    """Lu23's measure: 1100 episodes against 800 are 37 % faster.

    Args:
        slow: Runs of the learner compared with.
        fast: Runs of the other.
        seed: Of the bootstrap.
    """
    a, b = (np.array([run.episodes for run in runs]) for runs in (slow, fast))
    rng = np.random.default_rng(seed)
    drawn = [np.median(rng.choice(x, (RESAMPLES, x.size)), axis=1) for x in (a, b)]
    ratio = 100.0 * (drawn[0] / drawn[1] - 1.0)
    low, high = (float(x) for x in np.percentile(ratio, [2.5, 97.5]))
    return Faster(100.0 * float(np.median(a) / np.median(b) - 1.0), low, high)
