"""Planned motion of a trainset of a convoy, as it is sent to the one behind with the messages."""

from __future__ import annotations

from typing import NamedTuple, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._typing import Array, Float, Scalar
from metropilot.physics import namespace, scalars

STANDING_MPS = 1e-3
"""Speed below which a planned motion stands."""
MEMORY_S = 20.0
"""Time before a new plan for which the one before it is kept."""


class MotionPlan(NamedTuple):
    """Planned motion over time on a uniform grid; the trainset stands before and after it.

    Attributes:
        start_s: Time of the first row. 0-d.
        period_s: Time between rows. 0-d.
        position_m: Position of the front. Shape (T,).
        speed_mps: Speed. Shape (T,).
    """

    start_s: Scalar
    period_s: Scalar
    position_m: Float[Array, " rows"]
    speed_mps: Float[Array, " rows"]


class PlannedMotion(NamedTuple):
    """Planned motion at one time. All 0-d."""

    position_m: Scalar
    speed_mps: Scalar
    acceleration_mps2: Scalar


@no_type_check
def plan_at(plan: MotionPlan, time_s: Scalar) -> PlannedMotion:
    """Planned motion at a time; the acceleration is that of the period which begins there."""
    xp = namespace(plan.start_s, plan.position_m[0], time_s)
    last, dt = plan.position_m.shape[-1] - 1, plan.period_s
    # A clock that is a sum of periods may be a rounding error before the row.
    row = xp.clip((time_s - plan.start_s) / dt + 1e-3, 0.0, 1.0 * last)
    whole = xp.minimum(row // 1.0, last - 1.0)
    k = int(whole) if xp is scalars else whole.astype(np.int32)
    x, v = plan.position_m[k], plan.speed_mps[k]
    rise, way = plan.speed_mps[k + 1] - v, plan.position_m[k + 1] - x
    done = row - whole
    # The rows give both ends; a constant acceleration between them is right but for the period of the stop.
    moved = done * (way + 0.5 * (done - 1.0) * rise * dt)
    still = (time_s < plan.start_s - 1e-3 * dt) | (row >= last)
    return PlannedMotion(x + moved, v + done * rise, xp.where(still, 0.0 * v, rise / dt))


def plan_times(plan: MotionPlan) -> Float[ndarray, " rows"]:
    """Times of the rows of a plan (NumPy)."""
    return float(plan.start_s) + float(plan.period_s) * np.arange(plan.position_m.size)


def splice(before: MotionPlan, plan: MotionPlan) -> MotionPlan:
    """A new plan of the trainset ahead, with what was planned for the time before it (NumPy)."""
    dt = float(plan.period_s)
    rows = min(round(MEMORY_S / dt), max(round(float(plan.start_s - before.start_s) / dt), 0))
    start_s = float(plan.start_s) - rows * dt
    known = [plan_at(before, start_s + k * dt) for k in range(rows + 1)]
    position_m, speed_mps = (np.array([at[field] for at in known]) for field in range(2))
    # The new plan begins where the trainset is, and at its speed, not where it was planned to be.
    position_m += plan.position_m[0] - position_m[-1]
    speed_mps = lead_to(speed_mps, plan.speed_mps[0])
    return plan._replace(
        start_s=np.float64(start_s),
        position_m=np.concatenate([position_m[:-1], plan.position_m]),
        speed_mps=np.concatenate([speed_mps[:-1], plan.speed_mps]),
    )


def lead_to(speed_mps: Float[ndarray, " rows"], last_mps: float) -> Float[ndarray, " rows"]:
    """Speeds of the past changed little by little to end with the first of a new plan (NumPy).

    A step between the two would be read as an acceleration that was planned.
    """
    return speed_mps + (last_mps - speed_mps[-1]) * np.linspace(0.0, 1.0, speed_mps.size)


def stand_on(plan: MotionPlan, rows: int) -> MotionPlan:
    """Planned motion that stands for so many rows more at its end, if it stands there (NumPy)."""
    if plan.speed_mps[-1] > STANDING_MPS:
        return plan
    return plan._replace(
        position_m=np.pad(plan.position_m, (0, rows), "edge"), speed_mps=np.pad(plan.speed_mps, (0, rows))
    )
