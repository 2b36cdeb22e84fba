"""Optima of many runs of one trainset on one section, interpolated between a few running times.

In a campaign with many seeds the plant is the same and only the achieved running time differs. The least
energy decreases smoothly with that time, and each solution also gives its slope (the marginal energy of one
second), so that a cubic Hermite polynomial interpolates between two neighbouring solutions. A knot is solved
on first use.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from metropilot.evaluate import OPTIMUM_SPACING_M, OPTIMUM_TOLERANCE, Optimum
from metropilot.planning import Objective, Plan, PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import Section, Trainset

STEP = 0.02
"""Distance between two knots, as a share of the minimum running time."""
KEPT = 256
"""Largest number of curves in the cache of a worker."""


class EnergyCurve:
    """Least energy of one trainset on one section, over running time.

    Args:
        section: The section with every restriction of the run.
        trainset: True plant.
        objective: Energy minimised.

    Raises:
        Infeasible: The trainset cannot cover the section.
    """

    def __init__(self, section: Section, trainset: Trainset, objective: Objective) -> None:
        self.section, self.trainset = section, trainset
        self.options = PlanOptions(objective=objective, spacing_m=OPTIMUM_SPACING_M)
        self.fastest_s = minimum_running_time(section, trainset)
        self.knots: dict[int, Plan] = {}

    def at(self, time_s: float) -> Optimum:
        """The optimum for a running time; within one step of the minimum it is solved directly.

        Raises:
            Infeasible: There is no plan.
        """
        time_s = max(time_s, self.fastest_s * (1.0 + OPTIMUM_TOLERANCE))
        share = (time_s / self.fastest_s - 1.0) / STEP
        k = math.floor(share)
        if k < 1:
            plan = optimal_plan(self.section, self.trainset, time_s, self.options)
            return Optimum(plan, self.fastest_s)
        low, high = self._knot(k), self._knot(k + 1)
        energy = _hermite(share - k, self.fastest_s * STEP, low, high)
        bound = energy * min(low.bound_j / low.energy_j, high.bound_j / high.energy_j)
        return Optimum(replace(low, energy_j=energy, bound_j=bound, running_time_s=time_s), self.fastest_s)

    def _knot(self, k: int) -> Plan:
        if k not in self.knots:
            time_s = self.fastest_s * (1.0 + STEP * k)
            self.knots[k] = optimal_plan(self.section, self.trainset, time_s, self.options)
        return self.knots[k]


def _hermite(share: float, step_s: float, low: Plan, high: Plan) -> float:
    """Energy between two plans from their energies and marginal energies (cubic Hermite), J."""
    a, b = low.energy_j, high.energy_j
    da, db = -low.second_w * step_s, -high.second_w * step_s
    t = share
    ends = a * (1.0 + 2.0 * t) * (1.0 - t) ** 2 + b * t * t * (3.0 - 2.0 * t)
    return ends + da * t * (1.0 - t) ** 2 - db * t * t * (1.0 - t)


class Curves:
    """Energy curves of a worker; the oldest are dropped beyond ``KEPT``."""

    def __init__(self) -> None:
        self.known: dict[Any, EnergyCurve] = {}

    def get(self, plant: Any, section: Section, trainset: Trainset, objective: Objective) -> EnergyCurve:  # noqa: ANN401
        """The curve of a plant.

        Args:
            plant: Key of the plant, hashable.
            section: Its section.
            trainset: Its trainset.
            objective: Energy minimised.

        Raises:
            Infeasible: The trainset cannot cover the section.
        """
        if plant not in self.known:
            while len(self.known) >= KEPT:
                del self.known[next(iter(self.known))]
            self.known[plant] = EnergyCurve(section, trainset, objective)
        return self.known[plant]
