"""Model-predictive follower: a small box-constrained quadratic programme over the next seconds.

Over the horizon the acceleration of the trainset ahead decays; the own accelerations minimise gap error,
speed difference and changes of acceleration within the limits of brakes, traction and jerk. The Hessian is
constant, so a fixed number of accelerated projected gradient steps (Nesterov 1983) solves it, in NumPy and
compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, final, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._schema import check_fields, declare
from metropilot._typing import Scalar
from metropilot.convoy.drivers.base import AbstractFollower, command_for, reachable
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import Vehicle, namespace, scalars

HORIZON = 15
STEPS = 30
HARSH_MPS2 = 1e3
FURTHEST_M = 30.0
"""Largest gap error in the programme, so that a long gap is closed at a speed that can still be braked."""


@dataclass(frozen=True)
class FollowMpcOptions:
    """Weights of the programme.

    Attributes:
        gap: Weight of the squared gap error, 1/m^2.
        speed: Weight of the squared speed difference, 1/(m/s)^2.
        change: Weight of the squared change of acceleration between periods, 1/(m/s^2)^2.
        fading: Share of the acceleration ahead that remains one period later.
    """

    gap: float = declare(1.0, low=0.0, high=1e3)
    speed: float = declare(1.0, low=0.0, high=1e3)
    change: float = declare(0.05, low=0.0, high=1e3)
    fading: float = declare(0.97, low=0.0, high=1.0)

    def __post_init__(self) -> None:
        check_fields(self)


class MpcMemory(NamedTuple):
    """Accelerations of the last plan, m/s^2. Shape (HORIZON,)."""

    plan: Any


class Matrices(NamedTuple):
    """The programme for one control period: ``x' H x / 2 + x' (G start)``, and the largest curvature."""

    hessian: ndarray
    gradient: ndarray
    curvature: float


@final
class FollowMpc(AbstractFollower):
    """Model-predictive control over 15 periods within the limits of brakes, traction and jerk."""

    id = "follow_mpc"

    def __init__(self, options: FollowMpcOptions | None = None) -> None:
        self.options = options or FollowMpcOptions()

    def init(self, vehicle: Vehicle, period_s: float) -> MpcMemory:
        """Start from a plan of zeros."""
        del period_s
        return MpcMemory(np.zeros(HORIZON, np.asarray(vehicle.mass_kg).dtype))

    @no_type_check
    def act(self, memory: MpcMemory, observation: FollowerObservation) -> tuple[Scalar, MpcMemory]:
        """Solve the programme and apply its first acceleration."""
        xp = namespace(observation.position_m, observation.gap_m)
        join = np if xp is scalars else xp
        programme = matrices(self.options, float(observation.period_s))
        error = xp.clip(observation.gap_m - observation.wanted_gap_m, -FURTHEST_M, FURTHEST_M)
        closing = observation.ahead_mps - observation.speed_mps
        start = join.stack([error, closing, observation.ahead_mps2, observation.acceleration_mps2])
        low, high = reachable(observation)
        room = xp.minimum(observation.vehicle.jerk_mps3, HARSH_MPS2) * observation.period_s
        reach = room * join.arange(1, HORIZON + 1)
        lowest = join.maximum(low, observation.acceleration_mps2 - reach)
        highest = join.maximum(join.minimum(high, observation.acceleration_mps2 + reach), lowest)
        kind = memory.plan.dtype
        plan = solve_box_qp(
            programme, start.astype(kind), memory.plan, lowest.astype(kind), highest.astype(kind)
        )
        later = join.concatenate([plan[1:], plan[-1:]])
        return command_for(observation, plan[0]), MpcMemory(later)


@lru_cache
def matrices(options: FollowMpcOptions, period_s: float) -> Matrices:
    """Hessian, gradient and curvature of the programme, for piecewise constant accelerations.

    The start is gap error, speed difference, acceleration ahead and own acceleration.
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
