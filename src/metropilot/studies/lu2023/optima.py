"""The optimum over the paper's notches about each plan, and the convex optimum beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.planning import NotchOptions, PlanOptions, notch_plan, optimal_plan
from metropilot.railway import load_line, load_trainset
from metropilot.studies.lu2023.published import PlanCase

AROUND_S = (-4.0, 0.0, 4.0)
MESH = NotchOptions(spacing_m=5.0, speeds=400)
FINE = NotchOptions(spacing_m=2.0, speeds=1000)
TRAINSET, NOTCHES = "lu2023", "lu2023"


@dataclass(frozen=True)
class NotchFront:
    """Least traction energy over running time, near one plan.

    Attributes:
        time_s: Running times of the drives found. Shape (3,).
        energy_j: Their energies. Shape (3,).
    """

    time_s: Float[ndarray, "3"]
    energy_j: Float[ndarray, "3"]

    def at(self, time_s: float | ndarray) -> ndarray:
        """The parabola through the three, extended straight beyond the outer two, J."""
        bend = np.polynomial.Polynomial.fit(self.time_s, self.energy_j, 2)
        inside = np.clip(time_s, self.time_s[0], self.time_s[-1])
        return bend(inside) + bend.deriv()(inside) * (np.asarray(time_s) - inside)


@cache
def notch_front(plan: PlanCase) -> NotchFront:
    """The optimum over the twelve notches about a plan's time (a few seconds)."""
    section, trainset = load_line(plan.line).section("WHY", "WYJ"), load_trainset(TRAINSET)
    found = [
        notch_plan(section, trainset, plan.scheduled_s + shift, trainset.notches[NOTCHES], MESH)
        for shift in AROUND_S
    ]
    return NotchFront(
        np.array([p.running_time_s for p in found]), np.array([p.energy_wheel_j for p in found])
    )


def convex_j(plan: PlanCase, time_s: float) -> float:
    """The optimum over all forces up to the strongest notches, J."""
    section, trainset = load_line(plan.line).section("WHY", "WYJ"), load_trainset(TRAINSET)
    return optimal_plan(section, trainset, time_s, PlanOptions(spacing_m=5.0)).energy_wheel_j


@cache
def effort_j(plan: PlanCase) -> float:
    """The optimum over the notches of what the paper counts, traction and braking work, J."""
    section, trainset = load_line(plan.line).section("WHY", "WYJ"), load_trainset(TRAINSET)
    options = NotchOptions(MESH.spacing_m, MESH.speeds, 1.0)
    return notch_plan(section, trainset, plan.scheduled_s, trainset.notches[NOTCHES], options).energy_effort_j
