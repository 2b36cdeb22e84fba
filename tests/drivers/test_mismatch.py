"""Learned drivers where the trainset answers differently than told; elsewhere they drive as they learned."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.control import Adaptation, adapt_trainset, adapt_vehicle
from metropilot.evaluate import kpis_of, make_driver
from metropilot.physics import effort_at, vehicle_arrays
from metropilot.planning import minimum_running_time
from metropilot.railway import Actuation, Restriction, Steps, load_line, load_trainset
from metropilot.sim import Disturbance, Outcome, Rollout, Run, TimetableUpdate

LATE = {"delay_s": 0.6, "lag_s": 0.4, "speed_noise_mps": 0.05}


def run_of(origin, destination, ratio=1.1, **fields):
    section, trainset = load_line("yizhuang").section(origin, destination), load_trainset("dkz32", "AW2")
    scenario = Disturbance(**fields)
    return Run(section, trainset, ratio * minimum_running_time(section, trainset), scenario, seed=3)


def driven(run, name):
    """The run, and when the driver began to act on what it observed."""
    rollout, began = Rollout(run, make_driver(name)), None
    while rollout.outcome is None:
        rollout.advance()
        if began is None and rollout.memory.monitor.protection is not None:
            began = rollout.recorder.trajectory(rollout.params.track, 0.0).time_s[-1]
    return rollout.drive(), began


@pytest.mark.parametrize(
    ("name", "section", "corner"),
    [
        ("generalist", ("YZQ", "WHY"), (0.8, 1.5)),
        ("generalist", ("WYJ", "RJ"), (1.2, 0.5)),
        ("ppo_scaled", ("YZQ", "WHY"), (1.2, 0.5)),
        ("ppo_scaled", ("WYJ", "RJ"), (0.8, 1.5)),
    ],
)
def test_in_the_corners_of_the_plant_it_stops_at_the_point_and_in_time(name, section, corner):
    mass, drag = corner
    done, began = driven(run_of(*section, mass_factor=mass, resistance_factor=drag, **LATE), name)
    assert began is not None
    assert began < 10.0
    assert done.outcome is Outcome.ARRIVED
    assert done.max_overspeed_mps == 0.0
    assert abs(done.running_time_s - done.scheduled_time_s) < 3.0
    assert abs(done.trajectory.position_m[-1] - done.section.length_m) < 0.3
    assert done.interventions == 0


@pytest.mark.parametrize(("name", "ideal"), [("generalist", True), ("ppo", False), ("dqn", True)])
def test_where_all_is_as_told_nothing_observed_is_acted_upon(name, ideal):
    run = run_of("RJ", "WYJ", 1.2, ideal=ideal)
    news = (
        TimetableUpdate(30.0, scheduled_time_s=1.05 * run.scheduled_time_s),
        TimetableUpdate(30.0, restriction=Restriction(600.0, 800.0, 16.0)),
    )
    noisy = run_of("RJ", "WYJ", 1.2, ideal=ideal, speed_noise_mps=0.05, updates=news)
    for one in (run, noisy):
        _, began = driven(one, name)
        assert began is None


@pytest.mark.parametrize("name", ["cn_beijing_subway", "cheng2023", "dkz32"])
def test_noise_of_the_measured_speed_does_not_move_the_stop(name):
    trainset, line = load_trainset(name), load_line("yizhuang")
    for origin, destination in (("RJ", "WYJ"), ("YZQ", "WHY")):
        section = line.section(origin, destination)
        noise = Disturbance(speed_noise_mps=0.05)
        for seed in (3, 4):
            run = Run(section, trainset, section.planned_time_s, noise, seed=seed)
            done, began = driven(run, "generalist")
            assert began is None
            assert done.outcome is Outcome.ARRIVED
            assert abs(done.trajectory.position_m[-1] - section.length_m) < 0.05


def test_a_policy_knows_how_fast_noise_lets_it_drive():
    trainset = load_trainset("dkz32")
    limits = Steps(np.arange(-400.0, 2400.0, 200.0), np.resize([19.4, 12.5, 18.0, 8.3], 14))
    section = replace(load_line("yizhuang").section("TJN", "JHL"), limit_mps=limits)
    for noise, ratio in ((0.1, 1.2), (0.2, 1.3)):
        time_s = ratio * minimum_running_time(section, trainset)
        run = Run(section, trainset, time_s, Disturbance(speed_noise_mps=noise), seed=3)
        done, _ = driven(run, "generalist")
        assert done.interventions == 0
        assert done.running_time_s - time_s < 0.8


@pytest.mark.parametrize(("origin", "destination", "late_s"), [("RC", "RJ", 3.6), ("YZQ", "JG", 3.2)])
def test_one_that_even_flat_out_is_late_does_not_coast_to_the_stop(origin, destination, late_s):
    """Coasting over the last half kilometre it was 3.98 and 3.61 s late."""
    run = run_of(origin, destination, 1.05, mass_factor=1.2, resistance_factor=1.5, adhesion=0.08, **LATE)
    done, _ = driven(run, "generalist")
    assert done.interventions == 0
    assert done.running_time_s - run.scheduled_time_s < late_s
    assert abs(done.trajectory.position_m[-1] - run.section.length_m) < 0.1


@pytest.mark.parametrize(
    ("name", "load", "delay_s", "lag_s"),
    [
        ("generalist", "AW0", 0.1, 0.0),
        ("generalist", "AW2", 0.3, 0.2),
        ("generalist", "AW0", 1.0, 0.6),
        ("ppo", "AW0", 0.6, 0.2),
        ("ppo_scaled", "AW0", 0.0, 0.6),
    ],
)
def test_a_dead_time_or_lag_that_is_declared_is_allowed_for(name, load, delay_s, lag_s):
    plain = load_trainset("dkz32", load)
    jerk = plain.actuation.jerk_limit_mps3
    trainset = replace(plain, actuation=Actuation(delay_s, lag_s, jerk))
    run = Run(load_line("yizhuang").section("RJ", "WYJ"), trainset, 105.0)
    done, _ = driven(run, name)
    kpis = kpis_of(done, None)
    on_the_way = (done.trajectory.position_m > 20.0) & (
        done.trajectory.position_m < run.section.length_m - 5.0
    )
    assert kpis.success
    assert abs(kpis.stopping_error_m) < 0.05
    assert kpis.interventions == 0
    assert done.trajectory.speed_mps[on_the_way].min() > 1.0
    assert kpis.max_jerk_mps3 < 1.2 * jerk


def test_the_adapted_trainset_is_the_adapted_vehicle():
    trainset, shown = load_trainset("dkz32", "AW2"), Adaptation(0.83, 0.91, 1.4)
    whole, numbers = (
        vehicle_arrays(adapt_trainset(trainset, shown)),
        adapt_vehicle(vehicle_arrays(trainset), shown),
    )
    for speed in np.linspace(0.0, 22.0, 12):
        a, b = effort_at(whole, speed), effort_at(numbers, speed)
        np.testing.assert_allclose(np.array(a), np.array(b), rtol=1e-12)
    np.testing.assert_allclose(np.array(whole.davis_n), np.array(numbers.davis_n), rtol=1e-12)


@pytest.mark.parametrize("name", ["generalist", "ppo"])
def test_a_short_dead_time_in_the_bounds_of_protection_is_no_intervention(name):
    done, began = driven(run_of("RJ", "WYJ", 1.06, delay_s=0.1), name)
    assert began == done.run.dt  # from the first command on
    assert done.interventions == 0
    assert np.abs(done.trajectory.jerk_mps3).max() < 1.01
