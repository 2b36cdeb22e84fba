"""Measures against values worked out by hand."""

import numpy as np
import pytest

from metropilot.evaluate import measures
from metropilot.sim import COLUMNS, Trajectory


def trajectory(**given):
    rows = len(next(iter(given.values())))
    values = {name: np.zeros(rows) for name in COLUMNS if name != "phase"}
    values["time_s"] = np.arange(rows, dtype=float)
    values["phase"] = np.array(["power"] * rows)
    return Trajectory(**(values | {name: np.array(value) for name, value in given.items()}))


def test_comfort_is_the_total_variation_of_the_command():
    # Huang25: 0 -> 0.6 -> 0 -> -1 -> 0 makes 0.6 + 0.6 + 1 + 1 = 3.2; the last row has no step of its own.
    assert measures.command_variation(trajectory(command=[0.6, 0.0, -1.0, -1.0])) == pytest.approx(3.2)


def test_window_jerk_looks_two_seconds_around():
    # One row a second: within 2 s the acceleration goes from 0.2 to -0.5; -0.5 to 0.9 takes 3 s.
    accel = [0.0, 0.1, 0.2, 0.0, -0.5, -0.5, -0.5, 0.9]
    assert measures.window_jerk(trajectory(acceleration_mps2=accel)) == pytest.approx(1.4)
    accel = [0.0, 0.1, 0.2, 0.0, -0.5, 0.0, 0.0, 0.9]
    assert measures.window_jerk(trajectory(acceleration_mps2=accel)) == pytest.approx(0.9)


def test_jerk_counts_the_stop():
    t = trajectory(jerk_mps3=[0.5, 0.0, -0.7, 2.0])
    assert measures.max_jerk(t) == 2.0
    assert measures.stopping_jerk(t) == 2.0


def test_regime_switches_and_coasting():
    phase = ["power", "power", "coast", "coast", "stand", "power", "brake", "stand"]
    position = [0.0, 10.0, 30.0, 60.0, 70.0, 70.0, 75.0, 80.0]
    t = trajectory(phase=phase, position_m=position)
    assert measures.regime_switches(t) == 3
    assert measures.coasting_distance_m(t) == 40.0


def test_huang_energy_of_a_single_peak_is_the_square_of_the_peak():
    # papers: the integral of |dv/dt| v dt of a single-peak run is v_peak^2; 0 -> 20 -> 0 m/s gives 400 J/kg.
    t = trajectory(acceleration_mps2=[1.0, -0.5, 0.0], position_m=[0.0, 200.0, 600.0])
    assert measures.motion_energy_jpkg(t) == pytest.approx(400.0)


def test_effort_energy_counts_every_brake():
    t = trajectory(
        traction_n=[1e5, 0.0, 0.0],
        electric_brake_n=[0.0, 6e4, 0.0],
        friction_brake_n=[0.0, 4e4, 9e9],
        position_m=[0.0, 10.0, 20.0],
    )
    assert measures.effort_energy_j(t) == pytest.approx(2e6)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.3, "not uncomfortable"),
        (0.315, "not uncomfortable"),
        (0.6, "a little uncomfortable"),
        (3.0, "extremely uncomfortable"),
    ],
)
def test_comfort_bands(value, words):
    assert measures.comfort_band(value) == words


def test_rms_weighs_by_time():
    t = trajectory(acceleration_mps2=[1.0, 0.0, 5.0], time_s=[0.0, 1.0, 4.0])
    assert measures.rms_acceleration(t) == pytest.approx(0.5)
