"""The model-predictive follower: the next seconds as a small box-constrained quadratic programme.

Over the horizon the acceleration ahead dies away; the own accelerations are chosen within what brakes,
traction and jerk allow, to keep gap error, speed difference and changes of acceleration small. The Hessian
never changes, so a fixed number of accelerated projected gradient steps (Nesterov 1983) solves it, in NumPy
and compiled alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, final, no_type_check

import numpy as np
from numpy import ndarray

from metropilot.convoy.drivers.base import AbstractFollower
from metropilot.convoy.drivers.motion import command_for, reachable
from metropilot.convoy.step import FollowerObservation
from metropilot.errors import InputError
from metropilot.physics import Vehicle, namespace, scalars

Scalar = Any
HORIZON = 15
STEPS = 30
HARSH_MPS2 = 1e3
FURTHEST_M = 30.0
"""A longer gap error is taken for this much: closing up goes on at a speed that can still be lost."""


@dataclass(frozen=True)
class FollowMpcOptions:
    """What the programme weighs.

    Attributes:
        gap: Weight of the squared gap error, 1/m^2.
        speed: Weight of the squared speed difference, 1/(m/s)^2.
        change: Weight of the squared change of acceleration between periods, 1/(m/s^2)^2.
        fading: Share of the acceleration ahead that is left one period later.
    """

    gap: float = 1.0
    speed: float = 1.0
    change: float = 0.05
    fading: float = 0.97

    def __post_init__(self) -> None:
        for name, high in (("gap", 1e3), ("speed", 1e3), ("change", 1e3), ("fading", 1.0)):
            value = getattr(self, name)
            if not 0.0 <= value <= high:
                raise InputError("out of range", field=name, value=value, allowed=f"0 to {high:g}")


class MpcMemory(NamedTuple):
    """Accelerations planned last, m/s^2. Shape (HORIZON,)."""

    plan: Any


class Matrices(NamedTuple):
    """The programme for one control period: ``x' H x / 2 + x' (G start)``, and the largest curvature."""

    hessian: ndarray
    gradient: ndarray
    curvature: float


@final
class FollowMpc(AbstractFollower):
    """Looks three seconds ahead and obeys what brakes, traction and jerk allow."""

    id = "follow_mpc"

    def __init__(self, options: FollowMpcOptions | None = None) -> None:
        self.options = options or FollowMpcOptions()

    def init(self, vehicle: Vehicle, period_s: float) -> MpcMemory:
        """Nothing planned yet."""
        del period_s
        return MpcMemory(np.zeros(HORIZON, np.asarray(vehicle.mass_kg).dtype))

    @no_type_check
    def act(self, memory: MpcMemory, sight: FollowerObservation) -> tuple[Scalar, MpcMemory]:
        """Solve the programme, do its first move."""
        xp = namespace(sight.position_m, sight.gap_m)
        join = np if xp is scalars else xp
        programme = matrices(self.options, float(sight.period_s))
        error = xp.clip(sight.gap_m - sight.wanted_gap_m, -FURTHEST_M, FURTHEST_M)
        closing = sight.ahead_mps - sight.speed_mps
        start = join.stack([error, closing, sight.ahead_mps2, sight.acceleration_mps2])
        low, high = reachable(sight)
        room = xp.minimum(sight.vehicle.jerk_mps3, HARSH_MPS2) * sight.period_s
        reach = room * join.arange(1, HORIZON + 1)
        lowest = join.maximum(low, sight.acceleration_mps2 - reach)
        highest = join.maximum(join.minimum(high, sight.acceleration_mps2 + reach), lowest)
        kind = memory.plan.dtype
        plan = solved(programme, start.astype(kind), memory.plan, lowest.astype(kind), highest.astype(kind))
        later = join.concatenate([plan[1:], plan[-1:]])
        return command_for(sight, plan[0]), MpcMemory(later)


@lru_cache
def matrices(options: FollowMpcOptions, period_s: float) -> Matrices:
    """Hessian, gradient and curvature of the programme, from the exact motion over held accelerations.

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
def solved(programme: Matrices, start: Any, guess: Any, lowest: Any, highest: Any) -> Any:  # noqa: ANN401
    """The accelerations, after a fixed number of steps from the last plan. Shape (HORIZON,)."""
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
