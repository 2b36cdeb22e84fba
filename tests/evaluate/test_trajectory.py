"""The record of a run: its identities, its regimes, its file."""

import numpy as np
import pytest

from metropilot.errors import InputError
from metropilot.sim import COLUMNS, Trajectory, drive, phase_names

DESIGN = (
    "time_s, position_m, speed_mps, acceleration_mps2, jerk_mps3, command, traction_n, electric_brake_n, "
    "friction_brake_n, resistance_n, gradient_n, gradient_permil, limit_mps, permitted_mps, energy_wheel_j, "
    "energy_line_j, phase"
)


@pytest.fixture(scope="module")
def driven():
    from metropilot.evaluate import RunSpec
    from metropilot.sim import Disturbance

    heavy = Disturbance(mass_factor=1.1)
    where = ("yizhuang", "XHM", "JG", 170.0)
    request = RunSpec(*where, driver="flat_out", load="AW2", disturbance=heavy)
    return drive(request.run(), request.make_driver())


def test_columns_are_those_of_the_design():
    assert ", ".join(COLUMNS) == DESIGN


def test_forces_balance_in_every_row(driven):
    residual = driven.trajectory.balance_n(driven.trainset.effective_mass_kg)
    assert np.abs(residual).max() < 1e-6


def test_motion_follows_from_the_held_accelerations(driven):
    t = driven.trajectory
    dt = np.diff(t.time_s)
    speed = t.speed_mps[:-1] + t.acceleration_mps2[:-1] * dt
    moved = t.speed_mps[:-1] * dt + 0.5 * t.acceleration_mps2[:-1] * dt**2
    np.testing.assert_allclose(speed, t.speed_mps[1:], atol=1e-9)
    np.testing.assert_allclose(moved, np.diff(t.position_m), atol=1e-9)


def test_the_end_is_exact_and_lasts_no_time(driven):
    t = driven.trajectory
    assert t.speed_mps[-1] == 0.0
    assert t.duration_s[-1] == 0.0
    assert t.acceleration_mps2[-1] == 0.0
    assert t.phase[-1] == "stand"


def test_energy_is_force_times_distance(driven):
    t = driven.trajectory
    work = float((t.traction_n[:-1] * np.diff(t.position_m)).sum())
    assert t.energy_wheel_j[-1] == pytest.approx(work, rel=1e-12)


def test_energy_is_conserved(driven):
    """From standstill to standstill the works of all forces, gradient included, add up to nothing."""
    t = driven.trajectory
    moved = np.diff(t.position_m)
    losses = t.electric_brake_n + t.friction_brake_n + t.resistance_n + t.gradient_n
    kinetic = float(((t.traction_n - losses)[:-1] * moved).sum())
    assert kinetic == pytest.approx(0.0, abs=1e-6 * t.energy_wheel_j[-1])


def test_csv_reads_back_to_the_same_bits(driven, tmp_path):
    path = tmp_path / "trajectory.csv"
    driven.trajectory.write(path)
    again = Trajectory.read(path)
    for name in COLUMNS:
        assert np.array_equal(getattr(again, name), getattr(driven.trajectory, name)), name


def test_a_broken_csv_is_one_line(tmp_path):
    path = tmp_path / "trajectory.csv"
    path.write_text("time_s,position_m\n0,0\n")
    with pytest.raises(InputError, match="column missing"):
        Trajectory.read(path)
    path.write_text(",".join(COLUMNS) + "\n" + ",".join(["x"] * len(COLUMNS)) + "\n")
    with pytest.raises(InputError, match="not a number"):
        Trajectory.read(path)
    with pytest.raises(InputError, match="cannot read"):
        Trajectory.read(tmp_path / "nowhere.csv")


def test_regimes_in_words():
    #          power  cruise  cruise  coast  brake  stand  departs
    speed = [10.0, 10.0, 10.0, 10.0, 10.0, 0.0, 0.0]
    accel = [0.50, 0.00, 0.00, -0.1, -0.8, 0.0, 0.3]
    wheel = [90e3, 20e3, -9e3, 0.00, -9e4, 0.0, 6e4]
    words = phase_names(np.array(speed), np.array(accel), np.array(wheel), 1e5)
    assert words.tolist() == ["power", "cruise", "cruise", "coast", "brake", "stand", "power"]
