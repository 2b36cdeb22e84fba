"""Order of accuracy by regression of the error's slope, as diffrax's ``test_ode_order`` does."""

import numpy as np
import pytest
from tests.physics import cases

from metropilot.physics import INTEGRATORS


def smooth(position, speed):
    """A force law without a closed form that depends on both: a gradient wave and quadratic drag."""
    return 0.8 - 0.02 * speed - 0.003 * speed**2 - 0.3 * np.sin(position / 20.0)


def advance(name, dt, end_s=8.0):
    position, speed = 0.0, 1.0
    for _ in range(round(end_s / dt)):
        moved, speed = INTEGRATORS[name](smooth, position, speed, dt)
        position += moved
    return np.array([position, speed])


# Held acceleration is of order 1: its formula for the position is better, that for the speed is not.
@pytest.mark.parametrize(("name", "order"), [("euler", 1), ("held", 1), ("heun", 2), ("rk4", 4)])
def test_order_of_accuracy(name, order):
    steps = np.array([0.4, 0.2, 0.1, 0.05])
    exact = advance("rk4", 0.002)
    errors = [np.abs(advance(name, dt) - exact).max() for dt in steps]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.25), errors


@pytest.mark.parametrize("name", INTEGRATORS)
def test_constant_acceleration_is_exact_but_for_euler(name):
    moved, speed = INTEGRATORS[name](lambda x, v: 0.7 + 0 * x * v, 3.0, 2.0, 0.5)
    assert speed == pytest.approx(2.35)
    assert moved == pytest.approx(1.0 if name == "euler" else 2.0 * 0.5 + 0.5 * 0.7 * 0.25)


@pytest.mark.parametrize(("name", "order"), [("held", 1), ("heun", 2), ("rk4", 4)])
def test_the_plant_has_the_order_of_its_integrator_while_the_wheel_force_is_constant(name, order):
    from metropilot.railway import Davis

    trainset = cases.trainset(davis=Davis(4e3, 200.0, 150.0))  # strong enough for the error to show
    vehicle, track = cases.plant(cases.section(), trainset)

    def end(name, dt):
        return cases.drive(vehicle, track, np.full(round(32.0 / dt), 1.0), dt, integrator=name)[-1]

    exact = end("rk4", 0.05)
    steps = np.array([4.0, 2.0, 1.0, 0.5]) if name == "rk4" else np.array([1.0, 0.5, 0.25])
    errors = [abs(float(end(name, dt).position_m - exact.position_m)) for dt in steps]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.35), errors
