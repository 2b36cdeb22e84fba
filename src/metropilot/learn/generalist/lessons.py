"""Lessons: what the optimal plan does from a state, for states on its way and beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from metropilot.drivers.policy.networks import Params
from metropilot.errors import MetropilotError
from metropilot.learn.generalist.worlds import World
from metropilot.planning import Plan, PlanOptions, plan_arrays
from metropilot.task import Run, declared_bounds
from metropilot.task.observers import FEATURES, OBSERVERS, Sight
from metropilot.task.tables import PERMITTED, Rows, build_tables

FEATURE_NAMES = OBSERVERS["line"]
SPACING_M = 4.0
WINDOW_M = 30.0
LATE_W = 500.0
BELOW_PERMITTED_MPS = 0.2
SAFE_SHARE = 0.97
"""Share of the last braking's rate from which a disturbed state may still have to stop."""


class Lessons(NamedTuple):
    """States and what the optimal plan does there.

    Attributes:
        observations: Shape (N, O), float32.
        efforts_mps2: Traction less braking per effective mass, mean of the next ``WINDOW_M``. Shape (N,).
    """

    observations: Float[ndarray, "states features"]
    efforts_mps2: Float[ndarray, " states"]


@dataclass(frozen=True)
class Teaching:
    """How many lessons a world gives.

    Attributes:
        disturbed: Plans from states beside the first plan.
        states: States along each plan, even in time.
        speed_mps: Standard deviation of a disturbed state's speed.
        time_share: Standard deviation of its time left, as a share.
        time_s: And besides, s.
    """

    disturbed: int = 5
    states: int = 60
    speed_mps: float = 1.5
    time_share: float = 0.04
    time_s: float = 1.0


class Classroom:
    """One world with its tables: observes states in it, and asks the plan.

    Args:
        world: Where and with what.
        scheduled_ratio: Scheduled time over the minimum.
    """

    def __init__(self, world: World, scheduled_ratio: float) -> None:
        run = Run(world.section, world.trainset, scheduled_time_s=1.0)
        tables = build_tables([(world.section, world.trainset, declared_bounds(run))], SPACING_M, np.float64)
        self.rows = Rows(tables, jax=False)
        self.case = self.rows.case(0)
        self.length_m = float(self.case.length_m)
        self.scheduled_s = scheduled_ratio * float(self.case.minimum_s)
        self._at = np.arange(0.0, self.length_m + SPACING_M, SPACING_M)
        cap = self.rows.ground_at(PERMITTED, 0, self._at) - BELOW_PERMITTED_MPS
        self._cap = np.maximum(cap, 0.5)

    def permitted_mps(self, position_m: float) -> float:
        """Permitted speed at a position."""
        return float(self.rows.ground_at(PERMITTED, 0, np.array(position_m)))

    def plan(self, time_s: float, start_m: float = 0.0, start_mps: float = 0.0) -> Plan:
        """The optimal plan from a state, below what protection permits; late if it must.

        Raises:
            MetropilotError: No plan from there.
        """
        jerk = float(self.case.vehicle.jerk_mps3)
        options = PlanOptions(
            start_m=start_m,
            start_mps=start_mps,
            jerk_mps3=jerk if np.isfinite(jerk) else None,
            late_w=LATE_W,
            cap_m=self._at,
            cap_mps=self._cap,
            deceleration_mps2=float(self.case.stop_mps2),
        )
        return plan_arrays(self.case.vehicle, self.case.track, time_s, options)

    def observed(self, time_s: ndarray, position_m: ndarray, speed_mps: ndarray) -> ndarray:
        """What the policy would see in these states. Shape (N, O), float32."""
        case, nothing = self.case, np.zeros_like(position_m)
        sight = Sight(
            rows=self.rows,
            case=0,
            vehicle=case.vehicle,
            track=case.track,
            length_m=case.length_m,
            load=case.load,
            stop_mps2=case.stop_mps2,
            rates=case.protection.rates,
            time_s=time_s,
            position_m=position_m,
            speed_mps=speed_mps,
            acceleration_mps2=nothing,
            scheduled_s=np.full_like(position_m, self.scheduled_s),
            command=nothing,
        )
        values = [np.broadcast_to(v, position_m.shape) for name in FEATURE_NAMES for v in FEATURES[name](sight)]
        return np.stack(values, axis=1).astype(np.float32)

    def efforts(self, plan: Plan, position_m: ndarray) -> ndarray:
        """What a plan does over the next metres: work over distance, per effective mass, m/s^2."""
        work = (plan.traction_n - plan.brake_n) * np.diff(plan.position_m)
        total = np.concatenate([[0.0], np.cumsum(work)])
        window = np.minimum(WINDOW_M, np.maximum(self.length_m - position_m, 1.0))
        ends = (np.interp(position_m + shift, plan.position_m, total) for shift in (window, 0.0))
        return (next(ends) - next(ends)) / window / float(self.case.vehicle.effective_mass_kg)
