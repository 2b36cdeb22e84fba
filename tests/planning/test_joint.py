"""A convoy planned as one: alike to one trainset, within every limit of each, below any other rigid drive."""

from itertools import accumulate

import numpy as np
import pytest
from tests.planning import cases

from metropilot.errors import Infeasible, InputError
from metropilot.physics import effort_at, resistance_and_gradient, track_arrays, vehicle_arrays
from metropilot.planning import (
    PlanOptions,
    joint_minimum_running_time,
    joint_plan,
    limit_at,
    minimum_running_time,
    optimal_plan,
    plan_speed,
)
from metropilot.railway import load_trainset
from metropilot.sim import Disturbance

GAP_M = 5.92


def offsets(trainsets):
    return [0.0, *accumulate(each.length_m + GAP_M for each in trainsets[:-1])]


def true_plants(trainset, *factors):
    return [Disturbance(mass_factor=factor).true_plant(trainset) for factor in factors]


def driven_energy_j(section, trainset, offset_m, position_m, speed_mps):
    """Traction work of one trainset of a rigid convoy that drives this profile, by the plant's own forces."""
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    energy = 0.5 * speed_mps**2
    at = 0.5 * (position_m[1:] + position_m[:-1])
    work = 0.0
    for x, e, ds, gained in zip(
        at, 0.5 * (energy[1:] + energy[:-1]), np.diff(position_m), np.diff(energy), strict=True
    ):
        resistance, gradient = resistance_and_gradient(vehicle, track, x - offset_m, np.sqrt(2 * e))
        force = vehicle.effective_mass_kg * gained / ds + resistance + gradient
        work += max(float(force), 0.0) * ds
    return work


def fine(plan, step_m=1.0):
    """Positions and speeds of a plan, kinetic energy linear between its nodes."""
    position = np.unique(np.concatenate([plan.position_m, np.arange(0.0, plan.position_m[-1], step_m)]))
    return position, np.sqrt(np.interp(position, plan.position_m, plan.speed_mps**2))


@pytest.mark.parametrize("objective", ["wheel", "line"])
@pytest.mark.parametrize("name", ["dkz32", "cheng2023"])
def test_one_trainset_has_the_plan_of_one_trainset(name, objective):
    section, trainset = cases.reference_section(), load_trainset(name)
    options = PlanOptions(objective=objective)
    alone = optimal_plan(section, trainset, 100.0, options)
    joint = joint_plan(section, [trainset], [0.0], 100.0, options)
    assert (joint.energy_j, joint.bound_j) == (alone.energy_j, alone.bound_j)
    np.testing.assert_array_equal(joint.speed_mps, alone.speed_mps)
    fastest = minimum_running_time(section, trainset)
    assert joint_minimum_running_time(section, [trainset], [0.0]) == fastest


@pytest.mark.parametrize("objective", ["wheel", "line"])
def test_trainsets_alike_on_level_track_need_as_many_times_the_energy(objective):
    section = cases.simple_section(1500.0, limits=((0.0, 20.0),))
    trainset = load_trainset("dkz32")
    options = PlanOptions(objective=objective)
    alone = optimal_plan(section, trainset, 110.0, options)
    for count in (2, 4):
        trainsets = [trainset] * count
        joint = joint_plan(section, trainsets, offsets(trainsets), 110.0, options)
        assert joint.energy_j == pytest.approx(count * alone.energy_j, rel=2e-4)
        assert joint.trainset_energy_j == pytest.approx([alone.energy_j] * count, rel=2e-4)
        assert joint.gap < 1e-5


@pytest.mark.parametrize("objective", ["wheel", "line"])
def test_alike_and_nearly_alike_have_nearly_one_plan(objective):
    # alike trainsets share loads of the programme, these do not
    section, trainset = cases.yizhuang().section("JHL", "CQN"), load_trainset("dkz32")
    alike, apart = [trainset] * 3, true_plants(trainset, 1.0, 1.0 + 1e-9, 1.0 - 1e-9)
    options = PlanOptions(objective=objective)
    first, second = (joint_plan(section, t, offsets(t), 190.0, options) for t in (alike, apart))
    assert first.energy_j == pytest.approx(second.energy_j, rel=1e-5)
    assert first.trainset_energy_j == pytest.approx(second.trainset_energy_j, rel=1e-3)


@pytest.mark.parametrize("stops", [("RJ", "WYJ"), ("JHL", "CQN"), ("YZQ", "WHY")])
def test_each_trainset_keeps_its_own_limits_and_the_energies_are_the_plants(stops):
    section = cases.yizhuang().section(*stops)
    trainsets = [*true_plants(load_trainset("dkz32"), 0.8, 1.2), load_trainset("cheng2023")]
    at = offsets(trainsets)
    plan = joint_plan(section, trainsets, at, 1.12 * joint_minimum_running_time(section, trainsets, at))
    assert plan.gap < 1e-5
    assert plan.effort_excess < 1e-3
    assert sum(plan.trainset_energy_j) == pytest.approx(plan.energy_j)
    middle = 0.5 * (plan.position_m[1:] + plan.position_m[:-1])
    speed = np.array([plan_speed(plan, x) for x in middle])
    gained = np.diff(plan.speed_mps**2) / (2 * np.diff(plan.position_m))
    for own, offset_m, energy_j in zip(trainsets, at, plan.trainset_energy_j, strict=True):
        vehicle, track = vehicle_arrays(own), track_arrays(section, own)
        assert (plan.speed_mps[1:] <= limit_at(track, middle - offset_m) + 1e-6).all()
        assert gained.max() <= own.max_acceleration_mps2 + 1e-6
        assert gained.min() >= -own.max_deceleration_mps2 - 1e-6
        drag = [
            sum(resistance_and_gradient(vehicle, track, x - offset_m, v))
            for x, v in zip(middle, speed, strict=True)
        ]
        force = vehicle.effective_mass_kg * gained + np.array(drag)
        assert (force <= effort_at(vehicle, speed).traction_n + 0.01 * vehicle.effective_mass_kg).all()
        assert driven_energy_j(section, own, offset_m, *fine(plan)) == pytest.approx(energy_j, rel=3e-3)


@pytest.mark.parametrize("stops", [("JHL", "CQN"), ("SJZ", "XC")])
def test_no_rigid_drive_needs_less_than_the_bound(stops):
    # driven by all: what the head alone would plan under the limits of all, and joint plans of others
    section, trainset = cases.yizhuang().section(*stops), load_trainset("dkz32")
    trainsets = true_plants(trainset, 1.2, 1.0, 0.8, 1.1)
    at = offsets(trainsets)
    fastest = joint_minimum_running_time(section, trainsets, at)
    grid = np.arange(0.0, section.length_m + 0.5, 0.5)
    tracks = [track_arrays(section, each) for each in trainsets]
    cap = np.min([limit_at(t, grid - x) for t, x in zip(tracks, at, strict=True)], axis=0)
    above = []
    for ratio in (1.08, 1.25):
        plan = joint_plan(section, trainsets, at, ratio * fastest)
        others = [true_plants(trainset, *factors) for factors in ((1.2, 1.2, 1.2, 1.2), (0.8, 1.2, 1.2, 0.8))]
        profiles = [joint_plan(section, other, at, ratio * fastest) for other in others]
        under = PlanOptions(cap_m=grid, cap_mps=cap)
        profiles.append(optimal_plan(section, trainsets[0], ratio * fastest, under))
        for profile in profiles:
            driven = fine(profile)
            each = zip(trainsets, at, strict=True)
            need = sum(driven_energy_j(section, own, offset_m, *driven) for own, offset_m in each)
            above.append(need / plan.bound_j - 1.0)
    assert min(above) > -1e-3
    assert max(above) > 3e-3


def test_the_weakest_sets_the_minimum_time_and_the_message_names_it():
    section = cases.simple_section(1500.0, limits=((0.0, 40.0),))
    trainset = cases.simple_trainset(max_speed_mps=40.0)
    light, heavy = true_plants(trainset, 1.0, 1.4)
    at = [0.0, trainset.length_m + 6.0]
    least = joint_minimum_running_time(section, [light, heavy], at)
    assert least == pytest.approx(minimum_running_time(section, heavy), rel=1e-3)
    assert least > 1.05 * minimum_running_time(section, light)
    with pytest.raises(Infeasible, match="minimum running time is"):
        joint_plan(section, [light, heavy], at, 0.95 * least)


def test_a_plan_from_the_middle_of_the_run_keeps_jerk_and_comes_late_rather_than_not():
    section, trainset = cases.yizhuang().section("RJ", "WYJ"), load_trainset("dkz32")
    trainsets = [trainset] * 4
    options = PlanOptions(start_m=300.0, start_mps=12.0, jerk_mps3=1.0, release_mps3=0.9, late_w=500.0)
    for time_s in (120.0, 30.0):
        plan = joint_plan(section, trainsets, offsets(trainsets), time_s, options)
        assert plan.gap < 1e-4
        assert plan.speed_mps[0] == 12.0
        assert (plan.running_time_s > 31.0) if time_s == 30.0 else (plan.running_time_s < 120.1)
    # the price of a second counts all trainsets: this plan is no later than it must be
    sure = PlanOptions(start_m=300.0, start_mps=12.0, jerk_mps3=1.0, release_mps3=0.9, late_w=5000.0)
    least = joint_plan(section, trainsets, offsets(trainsets), 30.0, sure).running_time_s
    assert plan.running_time_s < 1.02 * least


@pytest.mark.parametrize(
    ("count", "at"), [(0, []), (2, [0.0]), (2, [1.0, 150.0]), (2, [0.0, 0.0]), (3, [0.0, 150.0, 140.0])]
)
def test_distances_that_do_not_fit_are_refused(count, at):
    section, trainset = cases.reference_section(), load_trainset("dkz32")
    with pytest.raises(InputError, match="offsets_m"):
        joint_plan(section, [trainset] * count, at, 120.0)
