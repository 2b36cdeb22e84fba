"""Integrators of position and speed with the wheel force held over the step.

Each takes the acceleration as a function of position and speed and returns displacement and new speed. The
default holds the acceleration found at the start of the step, so that a recorded trajectory replays exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from metropilot.physics.arrays import Scalar

Acceleration = Callable[[Scalar, Scalar], Scalar]
Integrator = Callable[[Acceleration, Scalar, Scalar, Scalar], tuple[Scalar, Scalar]]


def euler(acceleration: Acceleration, x: Scalar, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
    """Explicit Euler, order 1."""
    return v * dt, v + acceleration(x, v) * dt


def held(acceleration: Acceleration, x: Scalar, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
    """Constant acceleration over the step, order 1, exact where it is constant (Chen23a eq. 15)."""
    after = v + acceleration(x, v) * dt
    return 0.5 * (v + after) * dt, after


def heun(acceleration: Acceleration, x: Scalar, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
    """Heun's method, order 2."""
    a0 = acceleration(x, v)
    v1 = v + a0 * dt
    a1 = acceleration(x + v * dt, v1)
    return 0.5 * (v + v1) * dt, v + 0.5 * (a0 + a1) * dt


def rk4(acceleration: Acceleration, x: Scalar, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
    """The classical Runge-Kutta method, order 4."""
    h = 0.5 * dt
    a0 = acceleration(x, v)
    v1 = v + h * a0
    a1 = acceleration(x + h * v, v1)
    v2 = v + h * a1
    a2 = acceleration(x + h * v1, v2)
    v3 = v + dt * a2
    a3 = acceleration(x + dt * v2, v3)
    return dt * (v + 2 * v1 + 2 * v2 + v3) / 6, v + dt * (a0 + 2 * a1 + 2 * a2 + a3) / 6


INTEGRATORS: Mapping[str, Integrator] = MappingProxyType(
    {"euler": euler, "held": held, "heun": heun, "rk4": rk4}
)
