"""The two drivers on the real line, under protection."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.drivers import DRIVERS
from metropilot.planning import minimum_running_time
from metropilot.railway import (
    Actuation,
    Curve,
    Line,
    Restriction,
    Section,
    Station,
    Steps,
    load_line,
    load_trainset,
)
from metropilot.sim import Disturbance, Outcome, Run, TimetableUpdate, drive

UNKNOWN = {"resistance_factor": 1.5, "delay_s": 0.6, "lag_s": 0.4, "speed_noise_mps": 0.05}


@pytest.fixture(scope="module")
def dkz32():
    return load_trainset("dkz32")


def section(name):
    return load_line("yizhuang").section(*name.split("-"))


def driven(driver, run):
    done = drive(run, DRIVERS.make(driver))
    return done, float(done.trajectory.position_m[-1]) - run.section.length_m


@pytest.mark.parametrize("name", ["WYJ-RJ", "XC-SJZ", "CQN-JHL"])
@pytest.mark.parametrize("ideal", [True, False])
def test_flat_out_is_nearly_the_fastest_run_and_undisturbed(dkz32, name, ideal):
    run = Run(section(name), dkz32, 200.0, Disturbance(ideal=ideal))
    done, error = driven("flat_out", run)
    assert done.outcome is Outcome.ARRIVED
    assert (done.interventions, done.max_overspeed_mps) == (0, 0.0)
    assert abs(error) < 0.05
    assert done.running_time_s < 1.06 * minimum_running_time(run.section, dkz32)
    assert done.trajectory.acceleration_mps2.max() < 1.02
    if not ideal:
        assert np.abs(done.trajectory.jerk_mps3).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("mass", [0.8, 1.2])
def test_flat_out_stops_a_trainset_it_does_not_know(dkz32, mass):
    run = Run(section("RC-RJ"), dkz32, 200.0, Disturbance(mass_factor=mass, **UNKNOWN))
    done, error = driven("flat_out", run)
    assert done.outcome is Outcome.ARRIVED
    assert (done.interventions, done.max_overspeed_mps) == (0, 0.0)
    assert abs(error) < 0.2


def test_flat_out_slows_for_a_restriction_announced_on_the_way(dkz32):
    news = TimetableUpdate(at_s=10.0, restriction=Restriction(700.0, 900.0, 10.0))
    run = Run(section("RC-RJ"), dkz32, 200.0, Disturbance(updates=(news,)))
    done, _ = driven("flat_out", run)
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    inside = (done.trajectory.position_m > 700.0) & (done.trajectory.position_m < 900.0)
    assert 9.0 < done.trajectory.speed_mps[inside].max() <= 10.0


@pytest.mark.parametrize(
    ("name", "where", "late", "dt"),
    [
        ("ch_stadler_kiss_sbb", "CQN-JHL", Actuation(0.03, 0.07, 0.79), 1.0),
        ("ch_stadler_kiss_sbb", "WHY-WYJ", Actuation(0.08, 0.57, 0.6), 0.2),
    ],
)
def test_flat_out_asks_protection_before_it_steps_in(name, where, late, dt):
    """It was overruled, in the first case four times with the emergency brake."""
    run = Run(section(where), replace(load_trainset(name), actuation=late), 200.0, dt=dt)
    done, error = driven("flat_out", run)
    assert done.outcome is Outcome.ARRIVED
    assert (done.interventions, done.max_overspeed_mps) == (0, 0.0)
    assert abs(error) < 0.1


# By hand, 26 sections x 4 seeds: all within 3 s (extremes -2.1 and 1.2) and 0.14 m.
@pytest.mark.parametrize(
    ("name", "seed"), [("RJ-WYJ", 0), ("RJ-WYJ", 1), ("XHM-JG", 2), ("JHL-CQN", 3), ("SJZ-XC", 4)]
)
def test_manual_arrives_on_time_and_at_the_stop(dkz32, name, seed):
    where = section(name)
    assert where.planned_time_s is not None
    done, error = driven("manual", Run(where, dkz32, where.planned_time_s, seed=seed))
    assert done.outcome is Outcome.ARRIVED
    assert (done.interventions, done.max_overspeed_mps) == (0, 0.0)
    assert abs(done.running_time_s - where.planned_time_s) < 3.0
    assert abs(error) < 0.3


@pytest.mark.parametrize(
    ("service_mps2", "length_m", "time_s", "dt"),
    [(1.0, 1200.0, 96.0, 0.2), (0.7, 1200.0, 111.0, 1.0), (1.0, 300.0, 54.0, 1.0)],
)
def test_manual_brakes_no_harder_than_brakes_and_gradient_allow(dkz32, service_mps2, length_m, time_s, dt):
    """40 permil down toward the stop, and brakes that are just enough."""
    ends = Station("A", "A", 0.0), Station("B", "B", length_m)
    limits, slope = (
        Steps(np.zeros(1), np.array([22.0])),
        Steps(np.array([0.0, 600.0]), np.array([0.0, -40.0])),
    )
    where = Section("test", *ends, length_m, limits, slope, (Curve(-300.0, 0.0, 0.0),))
    trainset = replace(dkz32, service_deceleration_mps2=service_mps2)
    done, error = driven("manual", Run(where, trainset, time_s, dt=dt))
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    assert abs(error) < 0.3


def fall(permil, length_m, limit_kmh):
    """A section that falls evenly."""
    ends, at = (Station("A", "A", 0.0), Station("B", "B", length_m)), np.zeros(1)
    line = Line("test", "test", ends, Steps(at, np.array([limit_kmh / 3.6])), Steps(at, np.array([-permil])))
    return line.section("A", "B")


@pytest.mark.parametrize(
    ("name", "actuation", "where", "time_s", "dt"),
    [
        ("drawn-26-44", Actuation(0.09, 0.15), load_line("yizhuang").section("YZQ", "JG"), 148.0, 1.0),
        ("cheng2023", Actuation(0.27, 0.14, 0.8), fall(21.0, 282.0, 30.0), 59.5, 0.5),
    ],
)
def test_manual_looks_ahead_of_a_hand_that_long_periods_delay(name, actuation, where, time_s, dt):
    """It came up to the ceiling in full power, and coasted over it on a fall: overruled to a standstill."""
    trainset = replace(load_trainset(name), actuation=actuation)
    done, error = driven("manual", Run(where, trainset, time_s, dt=dt))
    assert done.interventions == 0
    assert abs(error) <= 0.3


@pytest.mark.parametrize(("permil", "length_m", "limit_kmh"), [(30.0, 600.0, 30.0), (40.0, 800.0, 40.0)])
def test_manual_keeps_to_a_gentle_stop_on_a_fall(permil, length_m, limit_kmh):
    """A stop planned at 0.1 m/s2 was taken for one too slow: let go of, it ended 1.3 m beyond."""
    trainset = replace(load_trainset("cheng2023"), actuation=Actuation(0.27, 0.14, 0.8))
    where = fall(permil, length_m, limit_kmh)
    run = Run(where, trainset, 1.4 * minimum_running_time(where, trainset), dt=1.0)
    done, error = driven("manual", run)
    assert done.interventions == 0
    assert abs(error) <= 0.3


def test_manual_moves_a_notched_lever_after_a_reaction_time(dkz32):
    done, _ = driven("manual", Run(section("RJ-WYJ"), dkz32, 101.0, seed=5))
    command = done.trajectory.command
    notches = command / np.where(command > 0, 0.25, 0.05)
    assert np.allclose(notches, np.round(notches), atol=1e-9)
    changes = np.flatnonzero(np.diff(command) != 0) * 0.2
    assert changes[0] >= 0.4 - 1e-9
    assert np.diff(changes).min() >= 0.2 - 1e-9


def test_manual_is_one_driver_per_seed(dkz32):
    runs = [Run(section("RJ-WYJ"), dkz32, 101.0, seed=seed) for seed in (1, 1, 2)]
    first, again, other = (drive(run, DRIVERS.make("manual")).trajectory for run in runs)
    assert np.array_equal(first.position_m, again.position_m)
    assert first.position_m.shape != other.position_m.shape or not np.array_equal(
        first.position_m, other.position_m
    )
