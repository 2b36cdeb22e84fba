"""The optimum by notches: above the convex plan, down to it with many, and a drive the plant can do."""

import numpy as np
import pytest
from tests.planning import cases

from metropilot.errors import Infeasible, InputError
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import load_line, load_trainset
from metropilot.studies.lu2023.notches import NotchOptions, notch_plan


def lu2023():
    return load_line("lu2023").section("WHY", "WYJ"), load_trainset("lu2023")


def convex_j(section, trainset, time_s):
    return optimal_plan(section, trainset, time_s, PlanOptions(spacing_m=5.0)).energy_j


def test_three_notches_reach_the_closed_form_on_level_track():
    # without a limit in the way, full traction, coasting and full braking is the optimum: three notches do
    section = cases.simple_section(1500.0, limits=((0.0, 60.0),))
    trainset = cases.simple_trainset(max_speed_mps=60.0)
    time_s = 1.2 * cases.fastest_without_limit(1500.0)
    plan = notch_plan(section, trainset, time_s, (-200e3, 0.0, 200e3), NotchOptions(2.0, 300))
    expected = cases.coasting_optimum(1500.0, plan.running_time_s)
    # with three notches the energy goes in steps of one cell of full traction: 2 m of 240
    assert plan.energy_j == pytest.approx(expected, rel=2e-2)
    assert plan.energy_j > expected * (1 - 1e-3)
    assert plan.running_time_s == pytest.approx(time_s, rel=5e-3)


@pytest.mark.parametrize("time_s", [120.0, 140.0])
def test_lu2023_twelve_notches_are_barely_above_the_convex_plan(time_s):
    section, trainset = lu2023()
    plan = notch_plan(section, trainset, time_s, trainset.notches["lu2023"], NotchOptions(5.0, 400))
    assert time_s - 1.0 < plan.running_time_s <= time_s
    above = plan.energy_j / convex_j(section, trainset, plan.running_time_s) - 1
    assert -1e-3 < above < 0.01
    # the programme's own bound agrees: the value is interpolated, the drive is not
    assert plan.bound_j == pytest.approx(plan.energy_j, rel=0.01)
    assert set(np.round(plan.force_n[:-1])) <= {
        *np.round(trainset.notches["lu2023"]),
        *(np.round(plan.force_n[plan.force_n > 100e3])),
    }


def test_a_largest_acceleration_is_kept_and_costs():
    section, trainset = lu2023()
    free, gentle = (
        notch_plan(section, trainset, 125.0, trainset.notches["lu2023"], NotchOptions(5.0, 400, 0.0, most))
        for most in (5.0, 0.8)
    )
    energy = 0.5 * gentle.speed_mps**2
    rate = np.diff(energy) / np.diff(gentle.position_m)
    assert rate[gentle.force_n != 0.0].max() < 0.8 + 1e-6
    assert rate[gentle.force_n < 0.0].min() > -0.8 - 1e-6
    assert 1.02 * free.energy_j < gentle.energy_j < 1.08 * free.energy_j
    assert gentle.bound_j > free.energy_j


def test_fewer_notches_cost_more_and_many_come_down_to_the_convex_plan():
    # a weak brake costs time and so energy, a weak pull too
    section, trainset = lu2023()
    time_s = 125.0
    energies = [
        notch_plan(section, trainset, time_s, table, NotchOptions(8.0, 200)).energy_j
        for table in (
            (-66e3, 0.0, 136e3),
            (-149e3, 0.0, 136e3),
            trainset.notches["lu2023"],
            tuple(np.unique(np.append(np.linspace(-149e3, 180e3, 60), 0.0))),
        )
    ]
    assert energies[0] > energies[1] > energies[2] > 0.999 * energies[3]
    assert energies[0] > 1.05 * energies[-1]
    assert energies[-1] == pytest.approx(convex_j(section, trainset, time_s), rel=1e-2)


def test_halving_the_mesh_changes_little():
    section, trainset = lu2023()
    coarse, fine = (
        notch_plan(section, trainset, 130.0, trainset.notches["lu2023"], NotchOptions(spacing, speeds))
        for spacing, speeds in ((6.0, 300), (3.0, 600))
    )
    at_time = [plan.energy_j + plan.second_w * (plan.running_time_s - 130.0) for plan in (coarse, fine)]
    assert at_time[0] == pytest.approx(at_time[1], rel=4e-3)
    assert fine.bound_j == pytest.approx(coarse.bound_j, rel=4e-3)


def test_its_own_books_balance():
    # work of the forces less resistance and climb is what is left as kinetic energy, segment by segment
    section, trainset = lu2023()
    plan = notch_plan(section, trainset, 125.0, trainset.notches["lu2023"], NotchOptions(4.0, 300, 1.0))
    ds, energy = np.diff(plan.position_m), 0.5 * plan.speed_mps**2
    a, b, c = trainset.davis.newtons(trainset.mass_kg)
    v = np.sqrt(energy[:-1] + energy[1:])
    climb = section.gradient_permil.at(0.5 * (plan.position_m[1:] + plan.position_m[:-1])) * 9.81e-3
    change = (plan.force_n - (a + b * v + c * v * v)) / trainset.mass_kg - climb
    np.testing.assert_allclose(np.diff(energy)[:-1], (change * ds)[:-1], atol=0.15)
    assert plan.energy_effort_j == pytest.approx(float(np.abs(plan.force_n) @ ds))
    assert plan.energy_j == pytest.approx(plan.energy_effort_j)
    limit = section.limit_mps.at(plan.position_m)
    assert (plan.speed_mps <= limit + 1e-6).all()


def test_what_cannot_be_is_refused():
    section, trainset = lu2023()
    least = minimum_running_time(section, trainset)
    with pytest.raises(Infeasible, match="minimum running time by these notches"):
        notch_plan(section, trainset, least - 1.0, trainset.notches["lu2023"], NotchOptions(8.0, 200))
    with pytest.raises(InputError, match="at least one brakes"):
        notch_plan(section, trainset, 130.0, (-149e3, 180e3))
    with pytest.raises(InputError, match="stronger than the brakes"):
        notch_plan(section, trainset, 130.0, (-300e3, 0.0, 180e3))
    with pytest.raises(InputError, match="spacing_m"):
        NotchOptions(spacing_m=0.0)
