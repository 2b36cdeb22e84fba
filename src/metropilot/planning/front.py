"""What a second costs: the time-energy front of a section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.planning.optimal import Plan, PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import Section, Trainset

RATIOS = (1.02, 1.03, 1.05, 1.075, 1.1, 1.15, 1.2, 1.25, 1.3, 1.4, 1.5, 1.6)


@dataclass(frozen=True)
class Front:
    """Optimal energy over running time.

    Attributes:
        minimum_s: Minimum running time.
        time_s: Running times, increasing. Shape (P,).
        energy_j: Optimal energy at each. Shape (P,).
        second_w: Energy saved by one more second at each, J/s. Shape (P,).
        plans: The plans themselves.
    """

    minimum_s: float
    time_s: Float[ndarray, " points"]
    energy_j: Float[ndarray, " points"]
    second_w: Float[ndarray, " points"]
    plans: tuple[Plan, ...]


def time_energy_front(
    section: Section,
    trainset: Trainset,
    times_s: Sequence[float] | None = None,
    options: PlanOptions | None = None,
) -> Front:
    """Optimal plans at several running times.

    Args:
        section: Section.
        trainset: Trainset with its load.
        times_s: Running times; None takes 1.02 to 1.6 of the minimum.
        options: See :class:`PlanOptions`.

    Raises:
        Infeasible: A time is below the minimum.
    """
    minimum = minimum_running_time(section, trainset)
    wanted = sorted(times_s) if times_s is not None else [minimum * r for r in RATIOS]
    plans = tuple(optimal_plan(section, trainset, t, options) for t in wanted)
    return Front(
        minimum_s=minimum,
        time_s=np.array(wanted),
        energy_j=np.array([p.energy_j for p in plans]),
        second_w=np.array([p.second_w for p in plans]),
        plans=plans,
    )
