"""Model-predictive follower: a small box-constrained quadratic programme over the next seconds.

Over the horizon the own place moves with its planned acceleration, and a departure from that decays; the own
accelerations minimise errors of place and speed and changes of the acceleration beyond the planned one,
within the limits of brakes, traction and jerk. The Hessian is constant, so a fixed number of accelerated
projected gradient steps (Nesterov 1983) solves it, in NumPy and compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, final, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Array, Scalar
from metropilot.control import PredictedState
from metropilot.convoy.drivers.base import closing_mps
from metropilot.convoy.drivers.own_place import AbstractPlaceFollower, PlaceMemory
from metropilot.convoy.plan import PlannedMotion, plan_at
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import Vehicle, namespace, scalars

HORIZON = 15
STEPS = 30
HARSH_MPS2, CLOSING_PER_S = 1e3, 0.4
FURTHEST_M = 1.0
"""Largest error of place in the programme, whose horizon is shorter than braking takes: the rest of a gap
is closed at the speed that can still be braked."""


@dataclass(frozen=True)
class FollowMpcOptions(CheckedFields):
    """Weights of the programme.

    Attributes:
        gap: Weight of the squared error of place, 1/m^2.
        speed: Weight of the squared error of speed, 1/(m/s)^2.
        change: Weight of the squared change of acceleration between periods, 1/(m/s^2)^2.
        fading: Share of a departure from the planned acceleration that remains one period later.
    """

    gap: float = declare(0.1, low=0.0, high=1e3)
    speed: float = declare(1.0, low=0.0, high=1e3)
    change: float = declare(0.2, low=0.0, high=1e3)
    fading: float = declare(0.97, low=0.0, high=1.0)


class MpcMemory(NamedTuple):
    """Accelerations beyond the planned ones in the last solution, m/s^2. Shape (HORIZON,)."""

    solution: Any


class Matrices(NamedTuple):
    """The programme for one control period: ``x' H x / 2 + x' (G start)``, and the largest curvature."""

    hessian: ndarray
    gradient: ndarray
    curvature: float


@final
class FollowMpc(AbstractPlaceFollower):
    """Model-predictive control over 15 periods within the limits of brakes, traction and jerk."""

    id = "follow_mpc"

    def __init__(self, options: FollowMpcOptions | None = None) -> None:
        self.options = options or FollowMpcOptions()

    def init_law(self, vehicle: Vehicle, period_s: float) -> MpcMemory:
        """Start from a solution of zeros."""
        del period_s
        return MpcMemory(np.zeros(HORIZON, np.asarray(vehicle.mass_kg).dtype))

    @no_type_check
    def hold_place(
        self,
        memory: PlaceMemory,
        observation: FollowerObservation,
        place: PlannedMotion,
        ahead: PredictedState,
    ) -> tuple[Scalar, MpcMemory]:
        """Solve the programme and apply its first acceleration."""
        xp = namespace(observation.position_m, observation.gap_m)
        join = np if xp is scalars else xp
        dt = observation.period_s
        programme = matrices(self.options, float(dt))
        planned = planned_mps2(memory, observation, ahead)
        whole_m = place.position_m - ahead.position_m
        error = xp.clip(whole_m, -FURTHEST_M, FURTHEST_M)
        faster = closing_mps(CLOSING_PER_S, whole_m - error, observation.most_mps2)
        own = ahead.acceleration_mps2
        off_mps2 = place.acceleration_mps2 - planned[0]
        behind_mps = place.speed_mps + faster - ahead.speed_mps
        start = join.stack([error, behind_mps, off_mps2, own - planned[0]])
        drag = ahead.resistance_mps2 + ahead.gradient_mps2
        reach = xp.minimum(observation.vehicle.jerk_mps3, HARSH_MPS2) * dt * join.arange(1, HORIZON + 1)
        lowest = join.maximum(-ahead.brake_mps2 - drag, own - reach) - planned
        highest = join.minimum(ahead.traction_mps2 - drag, own + reach) - planned
        highest = join.maximum(highest, lowest)
        solution, kind = memory.law.solution, memory.law.solution.dtype
        solution = solve_box_qp(
            programme, start.astype(kind), solution, lowest.astype(kind), highest.astype(kind)
        )
        later = join.concatenate([solution[1:], solution[-1:]])
        return planned[0] + solution[0], MpcMemory(later)


@no_type_check
def planned_mps2(memory: PlaceMemory, observation: FollowerObservation, ahead: PredictedState) -> Array:
    """Planned accelerations over the horizon; zero while no plan counts. Shape (HORIZON,)."""
    xp = namespace(observation.position_m, observation.gap_m)
    join = np if xp is scalars else xp
    if observation.plan is None:
        return join.zeros(HORIZON)
    then_s = observation.time_s + ahead.seconds
    rows = [plan_at(observation.plan, then_s + k * observation.period_s) for k in range(HORIZON)]
    planned = join.stack([row.acceleration_mps2 for row in rows])
    return join.where(memory.alone > 0.0, 0.0 * planned, planned)


@lru_cache
def matrices(options: FollowMpcOptions, period_s: float) -> Matrices:
    """Hessian, gradient and curvature of the programme, for piecewise constant accelerations.

    Accelerations count from the planned ones. The start is error of place, error of speed, departure of the
    place's acceleration, and own acceleration in the period before.
    """
    dt, n = period_s, HORIZON
    speed = np.tril(np.full((n, n), dt))
    gap = dt * (np.tril(np.ones((n, n))) @ speed) - 0.5 * dt * speed
    fading = options.fading ** np.arange(n)
    one, far = np.ones(n), dt * np.arange(1, n + 1)
    gap_start = np.stack([one, far, gap @ fading, 0 * one], axis=1)
    speed_start = np.stack([0 * one, one, speed @ fading, 0 * one], axis=1)
    change = np.eye(n) - np.eye(n, k=-1)
    first = np.zeros((n, 4))
    first[0, 3] = -1.0
    hessian = options.gap * gap.T @ gap + options.speed * speed.T @ speed
    hessian = hessian + options.change * change.T @ change + 1e-6 * np.eye(n)
    gradient = -options.gap * gap.T @ gap_start - options.speed * speed.T @ speed_start
    gradient = gradient + options.change * change.T @ first
    return Matrices(hessian, gradient, float(np.linalg.eigvalsh(hessian)[-1]))


@no_type_check
def solve_box_qp(programme: Matrices, start: Any, guess: Any, lowest: Any, highest: Any) -> Any:  # noqa: ANN401
    """Solve the programme by a fixed number of steps from the last plan. Shape (HORIZON,)."""
    xp = namespace(guess, start)
    kind = guess.dtype
    hessian, pull = programme.hessian.astype(kind), programme.gradient.astype(kind) @ start
    x = y = xp.clip(guess, lowest, highest)
    weight = 1.0
    for _ in range(STEPS):
        after = xp.clip(y - (hessian @ y + pull) / programme.curvature, lowest, highest)
        heavier = 0.5 * (1.0 + (1.0 + 4.0 * weight * weight) ** 0.5)
        y = after + ((weight - 1.0) / heavier) * (after - x)
        x, weight = after, heavier
    return x
