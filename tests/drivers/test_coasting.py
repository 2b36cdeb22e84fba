"""The coasting forecast against closed forms and a fine integration, and the coasting point that follows."""

import itertools

import numpy as np
import pytest

from metropilot.control import (
    COAST_SHARES,
    ceiling_of,
    coast,
    coast_point_for,
    forecast_of,
    model_of,
    time_to_go,
)
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Run

WAY = COAST_SHARES * 1000.0
LEVEL = np.zeros(WAY.size)


def integrate(speed, way, climb, davis, cap):
    """Energy over distance in steps of 5 cm, lowered where a cap is below it."""
    at = np.arange(0.0, way[-1], 0.05)
    rise = np.gradient(np.interp(at, way, climb), at)
    most, energy, found = np.interp(at, way, cap), 0.5 * speed**2, []
    for k in range(at.size):
        v = np.sqrt(2.0 * energy)
        found.append(v)
        energy = min(energy - 0.05 * (davis[0] + v * (davis[1] + v * davis[2]) + rise[k]), most[k])
    return np.interp(way, at, found)


def test_constant_resistance_and_climb_have_a_closed_form():
    # 0.1 m/s2 of resistance and 20 J/kg of climb in 1000 m
    found = coast(np.float64(20.0), WAY, 0.02 * WAY, (0.1, 0.0, 0.0))
    np.testing.assert_allclose(found, np.sqrt(400.0 - 2.0 * 0.12 * WAY), rtol=1e-6)


def test_quadratic_resistance_has_a_closed_form():
    # dE/ds = -2 c E: the energy decays exponentially
    found = coast(np.float64(20.0), WAY, LEVEL, (0.0, 0.0, 2e-4))
    np.testing.assert_allclose(found, 20.0 * np.exp(-2e-4 * WAY), rtol=1e-3)


def test_below_a_cap_the_trainset_coasts_on_from_the_cap():
    cap = np.where((WAY > 300.0) & (WAY < 420.0), 0.5 * 8.0**2, 1e4)
    davis, climb = (0.02, 1e-3, 1e-4), 3.0 * np.sin(WAY / 150.0)
    found = np.minimum(coast(np.float64(18.0), WAY, climb, davis, cap), np.sqrt(2.0 * cap))
    truth = np.minimum(integrate(18.0, WAY, climb, davis, cap), np.sqrt(2.0 * cap))
    np.testing.assert_allclose(found, truth, rtol=0.02)
    assert found[WAY > 420.0].max() < 9.0


def test_a_trainset_that_stalls_never_arrives_and_coasting_later_arrives_earlier():
    section = load_line("yizhuang").section("RJ", "WYJ")
    run = Run(section, load_trainset("dkz32"), 110.0)
    model = model_of(run, section)
    forecast = forecast_of(model, ceiling_of(run, section), 0.65)
    assert time_to_go(forecast, 0.0, 0.0, 15.0, 5.0) == np.inf
    times = [time_to_go(forecast, 300.0, 15.0, 16.0, x) for x in (400.0, 700.0, 1000.0, section.length_m)]
    assert all(later <= earlier for earlier, later in itertools.pairwise(times))
    point = coast_point_for(forecast, 300.0, 15.0, times[1], 16.0)
    assert point == pytest.approx(700.0, abs=6.0)
    assert time_to_go(forecast, 300.0, 15.0, 16.0, point) <= times[1]
