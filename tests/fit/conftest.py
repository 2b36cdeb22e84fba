"""Logs with known parameters."""

import pytest

from metropilot.evaluate import make_driver
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Run, drive

TRUTH = {"mass_factor": 1.1, "resistance_factor": 1.2, "brake_factor": 0.9, "delay_s": 0.43, "lag_s": 0.3}


@pytest.fixture(scope="session")
def nominal():
    return load_trainset("dkz32")


@pytest.fixture(scope="session")
def section():
    line = load_line("yizhuang")
    return line.section(line.station("RJ"), line.station("WYJ"))


@pytest.fixture(scope="session")
def trajectory(nominal, section):
    """A run by the driver ``manual``, which coasts."""
    return drive(Run(section, nominal, 130.0, Disturbance(**TRUTH)), make_driver("manual")).trajectory


@pytest.fixture(scope="session")
def trajectory_file(trajectory, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "trajectory.csv"
    trajectory.write(path)
    return path
