"""Driving by notches on the host: the filter keeps any policy in time, and nothing but notches is given."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.drivers import LearnedDriver, PolicyOptions
from metropilot.env import DrivingTask, task_config
from metropilot.evaluate import kpis_of
from metropilot.policy import Policy, PolicySpec, save_policy
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Outcome, Run, drive, simulate_nominal
from metropilot.studies.lu2023.drivers import ImprovedDqn, PidLu2023, PidLu2023Options

NOTCHES = np.array(load_trainset("lu2023").notches["lu2023"])
COAST, FULL = 5, 11


def run(time_s=125.0):
    return Run(load_line("lu2023").section("WHY", "WYJ"), load_trainset("lu2023"), time_s)


def lazy(observation, mask):
    """Coasts wherever the filter lets it, else pulls."""
    del observation
    return COAST if mask[COAST] else FULL


def restless(observation, mask):
    """Some allowed notch, another one at every decision."""
    return int(np.flatnonzero(mask)[int(1e4 * abs(float(observation[0]))) % mask.sum()])


@pytest.mark.parametrize("policy", [lazy, restless])
@pytest.mark.parametrize(("changes", "late_s"), [({"most_mps2": 0.0, "margin": 0.06}, 3.0), ({}, 5.0)])
def test_any_policy_is_in_time_by_notches_alone(policy, changes, late_s):
    # at 115 s there are 11 s to idle away at the origin: fewer than the 20 s that count as stalled; the
    # filter does not know the largest acceleration
    interface = task_config("lu2023").interface
    interface = replace(interface, action=replace(interface.action, **changes))
    found = drive(run(115.0), LearnedDriver(policy, interface))
    kpis = kpis_of(found, None)
    assert found.outcome is Outcome.ARRIVED
    assert abs(kpis.stopping_error_m) <= 0.3
    assert abs(kpis.time_error_s) <= late_s
    assert kpis.max_overspeed_mps == 0.0
    t = found.trajectory
    force = (t.traction_n - t.electric_brake_n - t.friction_brake_n)[:-2]
    nearest = np.abs(force[:, None] - NOTCHES[None, :]).min(axis=1)
    # above 54 km/h the strongest pulls give what there is; the last step holds whatever stops it
    below = (nearest > 1.0) & ~((force > 86e3) & (t.speed_mps[:-2] > 14.0))
    assert below.sum() <= kpis.interventions  # protection has no notches


def random_policy(path):
    """An improved DQN that has learned nothing, as a file."""
    config = task_config("lu2023")
    size = DrivingTask(config).observation_size
    spec = PolicySpec("dueling", size, 12, (8,), "relu", 12, normalised=False)
    rng = np.random.default_rng(5)
    params = {name: rng.normal(size=shape).astype(np.float32) for name, shape in spec.shapes().items()}
    save_policy(path, Policy(spec, params), {"perception": config.interface.as_dict()})
    return path


def test_pid_tracks_the_curve_of_a_policy(tmp_path):
    path = random_policy(tmp_path / "random.safetensors")
    driver = PidLu2023(PidLu2023Options(policy=str(path)))
    found = drive(run(140.0), driver)
    assert found.outcome is Outcome.ARRIVED
    learned = simulate_nominal(run(140.0), driver_of(path))
    again = drive(run(140.0), driver_of(path))
    # the rehearsal is the drive
    assert learned.running_time_s == pytest.approx(again.running_time_s, abs=0.05)
    t = found.trajectory
    curve = np.interp(t.position_m, learned.position_m, learned.speed_mps)
    middle = (t.position_m > 100.0) & (t.position_m < 1400.0)
    assert np.sqrt(np.mean((t.speed_mps - curve)[middle] ** 2)) < 0.5


def driver_of(path):
    return ImprovedDqn(PolicyOptions(str(path)))
