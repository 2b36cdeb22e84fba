"""Reading a plan while driving: its speed, time and acceleration at a position."""

from __future__ import annotations

import numpy as np

from metropilot.planning.optimal import Plan

START_STRETCH_M = 3.0


def plan_speed(plan: Plan, position_m: float) -> float:
    """Speed of the plan at a position; kinetic energy is linear between its nodes."""
    return float(np.sqrt(np.interp(position_m, plan.position_m, plan.speed_mps**2)))


def plan_time(plan: Plan, position_m: float) -> float:
    """Time since the plan's start at a position, at constant acceleration between its nodes."""
    k = int(np.clip(np.searchsorted(plan.position_m, position_m, side="right") - 1, 0, plan.time_s.size - 2))
    v0, v = float(plan.speed_mps[k]), plan_speed(plan, position_m)
    gone = min(max(position_m, float(plan.position_m[k])), float(plan.position_m[-1])) - float(
        plan.position_m[k]
    )
    return float(plan.time_s[k]) + (2 * gone / (v0 + v) if v0 + v > 1e-6 else 0.0)


def ramped_acceleration(plan: Plan, position_m: float) -> float:
    """Acceleration of a plan that allows for the jerk limit: linear between the middles of its segments."""
    change = np.diff(plan.speed_mps**2) / (2 * np.diff(plan.position_m))
    return float(np.interp(position_m, 0.5 * (plan.position_m[1:] + plan.position_m[:-1]), change))


def pull_away(plan: Plan, position_m: float) -> float:
    """Acceleration to ask for just after departure: the largest planned near by; the plant builds it up."""
    change = np.diff(plan.speed_mps**2) / (2 * np.diff(plan.position_m))
    near = plan.position_m[:-1] < position_m + START_STRETCH_M
    return float(change[near].max())
