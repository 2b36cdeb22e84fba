"""The driver `mpc` in closed loop: safe as `optimal`, nearer to the optimum where data sheets are wrong."""

import numpy as np
import pytest

from metropilot.control import weighs_load
from metropilot.drivers import DRIVERS
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan, plan_arrays
from metropilot.railway import Restriction, load_line, load_trainset
from metropilot.sim import Disturbance, Outcome, Run, TimetableUpdate, drive

LATE = {"delay_s": 0.6, "lag_s": 0.4, "speed_noise_mps": 0.05}
CORNERS = [(0.8, 0.5), (0.8, 1.5), (1.2, 0.5), (1.2, 1.5)]


def run_of(origin, destination, load="AW2", ratio=1.1, **scenario):
    section = load_line("yizhuang").section(origin, destination)
    trainset = load_trainset("dkz32", load)
    time_s = minimum_running_time(section, trainset) * ratio
    return Run(section, trainset, time_s, Disturbance(**scenario))


def gap(done):
    best = optimal_plan(done.section, done.trainset, done.running_time_s)
    return float(done.trajectory.energy_wheel_j[-1]) / best.bound_j - 1.0


def check_arrival(done, seconds):
    assert done.outcome is Outcome.ARRIVED
    assert done.max_overspeed_mps == 0.0
    assert abs(done.trajectory.position_m[-1] - done.section.length_m) <= 0.3
    assert abs(done.running_time_s - done.scheduled_time_s) <= seconds


@pytest.mark.parametrize(("mass", "resistance"), CORNERS)
@pytest.mark.parametrize(("origin", "destination"), [("WHY", "YZQ"), ("XC", "XHM")])
def test_arrives_in_the_corners_of_the_disturbances(origin, destination, mass, resistance):
    told = {"mass_factor": mass, "resistance_factor": resistance}
    check_arrival(drive(run_of(origin, destination, **told, **LATE), DRIVERS.make("mpc")), seconds=3.0)


def test_as_told_it_is_as_good_as_the_plan():
    run = run_of("RJ", "WYJ", load="AW0", ratio=1.2, ideal=True)
    done = drive(run, DRIVERS.make("mpc"))
    check_arrival(done, seconds=0.5)
    assert done.interventions == 0
    assert -1e-3 <= gap(done) <= 0.01


def test_neither_planner_wastes_much_on_a_heavy_trainset():
    run = run_of("WYJ", "WHY", mass_factor=1.2, resistance_factor=0.5, **LATE)
    wasted = {name: gap(drive(run, DRIVERS.make(name))) for name in ("optimal", "mpc")}
    assert max(wasted.values()) < 0.13, wasted


def test_a_restriction_announced_on_the_way_is_kept():
    news = (TimetableUpdate(30.0, restriction=Restriction(500.0, 700.0, 40 / 3.6)),)
    done = drive(run_of("RJ", "WYJ", ratio=1.25, updates=news, mass_factor=1.2), DRIVERS.make("mpc"))
    check_arrival(done, seconds=3.0)  # a fifth more mass, told to nobody: `flat_out` is 4.8 s late
    held = (done.trajectory.position_m > 500.0) & (done.trajectory.position_m < 700.0)
    assert done.trajectory.speed_mps[held].max() <= 40 / 3.6


def test_a_plan_that_starts_from_another_is_the_same_plan_in_fewer_passes():
    section, trainset = load_line("yizhuang").section("RJ", "WYJ"), load_trainset("dkz32", "AW2")
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    first = plan_arrays(vehicle, track, 110.0, PlanOptions(jerk_mps3=1.0, late_w=500.0))
    options = PlanOptions(jerk_mps3=1.0, late_w=500.0, start_m=300.0, start_mps=16.0)
    cold = plan_arrays(vehicle, track, 80.0, options)
    warm = plan_arrays(vehicle, track, 80.0, options, about=first)
    assert warm.passes < cold.passes
    assert warm.energy_j == pytest.approx(cold.energy_j, rel=2e-3)
    assert np.max(np.abs(warm.speed_mps - cold.speed_mps)) < 0.1


def test_brakes_with_force_to_spare_weigh_their_load():
    assert weighs_load(vehicle_arrays(load_trainset("dkz32", "AW3")))
    assert not weighs_load(
        vehicle_arrays(load_trainset("dkz32", "AW3"))._replace(friction_n=np.float64(150e3))
    )
