"""The optimum is one: closed form, simulated drives that cannot beat it, refinement, the whole line."""

import dataclasses

import numpy as np
import pytest
from tests.planning import cases
from tests.sections import section_of

from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import load_trainset


@pytest.mark.parametrize("ratio", [1.02, 1.1, 1.3, 1.6])
def test_closed_form_on_level_track(ratio):
    # constant forces, constant resistance, no limit in the way: accelerate, coast, brake is the optimum
    length = 1500.0
    fastest = cases.fastest_without_limit(length)
    expected = cases.coasting_optimum(length, ratio * fastest)
    section = cases.simple_section(length, limits=((0.0, 60.0),))
    trainset = cases.simple_trainset(max_speed_mps=60.0)
    assert minimum_running_time(section, trainset) == pytest.approx(fastest, rel=1e-3)
    plan = optimal_plan(section, trainset, ratio * fastest)
    assert plan.energy_j == pytest.approx(expected, rel=1e-3)


def test_no_simulated_drive_beats_the_bound_and_the_best_comes_close():
    # the drives use the plant itself: time, energy and stop are what it integrated
    section, trainset = cases.reference_section(), cases.contest()
    rng, above = np.random.default_rng(5), []
    for _ in range(12):
        cruise, coast_from = rng.uniform(14.0, 19.0), rng.uniform(250.0, 900.0)
        drive = cases.drive(section, trainset, cruise, coast_from)
        if drive is None:
            continue
        time_s, energy_j, stop_m = drive
        plan = optimal_plan(cases.lengthened(section, stop_m), trainset, time_s)
        above.append(energy_j / plan.bound_j - 1)
    assert len(above) > 7
    assert min(above) > -1e-3  # the plant's 0.1 s steps hold forces that the plan must lower
    assert min(above) < 0.01


@pytest.mark.parametrize("permil", [10.0, 25.0, 35.0])
@pytest.mark.parametrize("ratio", [1.6, 2.0, 3.0])
def test_a_valley_with_much_time_is_driven_in_that_time(permil, ratio):
    """The resistance was that of another speed: up to 88 s early, 10 % above what is possible."""
    section = section_of(1200.0, {0.0: 80.0}, {0.0: -permil, 600.0: permil})
    trainset = load_trainset("dkz32")
    time_s = ratio * minimum_running_time(section, trainset)
    plan = optimal_plan(section, trainset, time_s)
    assert plan.running_time_s == pytest.approx(time_s, abs=0.05)
    assert plan.tightness < 1e-3
    assert plan.bound_j <= plan.energy_j
    # more time costs no energy
    assert plan.energy_j <= optimal_plan(section, trainset, time_s - 10.0).energy_j * (1 + 1e-4)


@pytest.mark.parametrize("stops", [("RJ", "WYJ"), ("JHL", "CQN"), ("SJZ", "XC")])
@pytest.mark.parametrize("ratio", [1.05, 1.3])
def test_refining_the_mesh_changes_nothing(stops, ratio):
    section = cases.yizhuang().section(*stops)
    trainset = cases.contest("AW2")
    time_s = ratio * minimum_running_time(section, trainset)
    energies = [
        optimal_plan(section, trainset, time_s, PlanOptions(spacing_m=spacing)).energy_j
        for spacing in (12.5, 6.0, 3.0)
    ]
    assert energies == pytest.approx([energies[-1]] * 3, rel=1e-3)


@pytest.mark.parametrize("load", ["AW0", "AW2", "AW3"])
@pytest.mark.parametrize("backward", [False, True])
def test_every_section_load_and_reserve_is_solved(load, backward):
    trainset = cases.contest(load)
    for section in cases.yizhuang().sections(backward=backward):
        fastest, last = minimum_running_time(section, trainset), np.inf
        for ratio in (1.02, 1.05, 1.2, 1.6):
            plan = optimal_plan(section, trainset, ratio * fastest)
            where = f"{section.name} {load} {ratio}"
            assert abs(plan.gap) < 1e-5, where
            assert plan.tightness < 1e-4, where
            assert abs(plan.effort_excess) < 1e-4, where
            assert plan.running_time_s == pytest.approx(ratio * fastest, abs=1e-4), where
            assert cases.limit_between_nodes(plan, trainset, section) < 1e-4, where
            assert plan.energy_j < last, where
            last = plan.energy_j


def test_forces_and_accelerations_stay_within_the_trainset():
    section, trainset = cases.yizhuang().section("JHL", "CQN"), cases.contest("AW3")
    plan = optimal_plan(section, trainset, 1.1 * minimum_running_time(section, trainset))
    acceleration = np.diff(0.5 * plan.speed_mps**2) / np.diff(plan.position_m)
    assert acceleration.max() < trainset.max_acceleration_mps2 + 1e-6
    assert -acceleration.min() < trainset.max_deceleration_mps2 + 1e-6
    middle = np.sqrt(0.5 * (plan.speed_mps[1:] ** 2 + plan.speed_mps[:-1] ** 2))
    # effort is interpolated on a grid of 0.02 m/s, so the corner of a curve is off by a little
    assert np.all(plan.traction_n <= trainset.traction.at(middle) * 1.0005 + 1.0)
    assert np.all(plan.brake_n <= trainset.electric_brake.at(middle) * 1.0005 + 1.0)


def test_the_work_is_accounted_for():
    # traction - braking - resistance - gradient = change of kinetic energy: here from rest to rest
    section, trainset = cases.yizhuang().section("XHM", "JG"), cases.contest()
    section = dataclasses.replace(section, curves=())
    plan = optimal_plan(section, trainset, 160.0)
    ds = np.diff(plan.position_m)
    a, b, c = trainset.davis.newtons(trainset.mass_kg)
    v = plan.speed_mps
    davis = np.sum(ds * (a + b * (v[1:] + v[:-1]) / 2 + c * (v[1:] ** 2 + v[:-1] ** 2) / 2))
    climb = section.gradient_permil.integral(section.length_m) - section.gradient_permil.integral(0.0)
    height = trainset.mass_kg * 9.81 * float(climb) / 1e3
    work = np.sum(ds * (plan.traction_n - plan.brake_n))
    assert work == pytest.approx(davis + height, abs=1e-4 * plan.energy_j)
