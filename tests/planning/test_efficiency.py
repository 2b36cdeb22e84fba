"""The line objective: efficiencies constant and mapped, recovery, auxiliaries."""

import dataclasses

import numpy as np
import pytest
from tests.planning import cases

from metropilot.physics import map_value, traction_available_n, vehicle_arrays
from metropilot.planning import PlanOptions, optimal_plan
from metropilot.railway import Efficiency

LINE = PlanOptions(objective="line")
SPEEDS = np.array([0.0, 12.0, 25.0])
SHARES = np.array([0.0, 0.5, 1.0])
MAPS = {
    "full load is dear": np.array([[0.9, 0.9, 0.6]] * 3),
    "part load is dear": np.array([[0.6, 0.6, 0.95]] * 3),
    "fast is dear": np.array([[0.9] * 3, [0.9] * 3, [0.5] * 3]),
    "slow is dear": np.array([[0.5] * 3, [0.9] * 3, [0.95] * 3]),
    "a motor's": np.array([[0.5, 0.6, 0.55], [0.7, 0.9, 0.88], [0.75, 0.93, 0.9]]),
}


def section():
    return cases.yizhuang().section("RJ", "WYJ")


def trainset(efficiency=None, **changes):
    """The contest's trainset with 0.9 both ways, half of the braking recovered and 120 kW of auxiliaries."""
    given = {
        "efficiency_traction": efficiency or Efficiency.constant(0.9),
        "efficiency_braking": Efficiency.constant(0.9),
        "receptivity": 0.5,
        "auxiliary_w": 120e3,
    }
    return dataclasses.replace(cases.contest(), **{**given, **changes})


def work_shares(plan, train):
    """Middle speed, share of the available traction, and work of every segment."""
    middle = np.sqrt(0.5 * (plan.speed_mps[1:] ** 2 + plan.speed_mps[:-1] ** 2))
    available = traction_available_n(vehicle_arrays(train), middle)
    return middle, np.clip(plan.traction_n / available, 0, 1), plan.traction_n * np.diff(plan.position_m)


def line_energy_j(plan, train):
    """Another way to the objective: the plant's map, segment by segment, one number at a time."""
    vehicle, total = vehicle_arrays(train), 0.0
    electric = np.minimum(plan.brake_n, 166e3) * np.diff(plan.position_m)
    for speed, share, work, braked in zip(*work_shares(plan, train), electric, strict=True):
        efficiency = map_value(vehicle, vehicle.efficiency_traction, float(speed), float(share))
        total += work / efficiency - 0.9 * train.receptivity * braked
    return total + train.auxiliary_w * plan.running_time_s


def test_constant_efficiency_scales_what_nothing_is_recovered_of():
    poor = trainset(Efficiency.constant(0.8), receptivity=0.0, auxiliary_w=0.0)
    wheel = optimal_plan(section(), poor, 101.0)
    line = optimal_plan(section(), poor, 101.0, LINE)
    assert line.energy_j == pytest.approx(wheel.energy_j / 0.8, rel=1e-5)
    assert line.energy_wheel_j == pytest.approx(wheel.energy_j, rel=1e-5)


def test_auxiliaries_cost_time():
    train = trainset(receptivity=0.0)
    with_them, without = (
        optimal_plan(section(), dataclasses.replace(train, auxiliary_w=w), 101.0, LINE) for w in (120e3, 0.0)
    )
    assert with_them.energy_j - without.energy_j == pytest.approx(120e3 * 101.0, rel=1e-4)


def test_recovery_is_worth_something_and_moves_the_optimum():
    plans = [optimal_plan(section(), trainset(receptivity=r), 101.0, LINE) for r in (0.0, 0.5, 1.0)]
    energies = [p.energy_j for p in plans]
    assert energies == sorted(energies, reverse=True)
    # what braking gives back makes coasting less worth: more traction, a lower peak held longer
    assert plans[0].energy_wheel_j < plans[2].energy_wheel_j
    assert plans[2].speed_mps.max() < plans[0].speed_mps.max() - 1.0
    # the plan for no recovery, paid with recovery, is beaten by the one that knows of it
    assert line_energy_j(plans[0], trainset(receptivity=1.0)) > plans[2].energy_j * 1.003
    assert all(abs(p.gap) < 1e-5 for p in plans)


def test_a_map_that_is_constant_changes_nothing():
    flat = Efficiency(SPEEDS, SHARES, np.full((3, 3), 0.9))
    plain = optimal_plan(section(), trainset(), 101.0, LINE)
    mapped = optimal_plan(section(), trainset(flat), 101.0, LINE)
    assert mapped.energy_j == pytest.approx(plain.energy_j, rel=1e-5)
    assert mapped.speed_mps == pytest.approx(plain.speed_mps, abs=1e-2)
    assert abs(mapped.gap) < 1e-4


@pytest.mark.parametrize("name", MAPS)
def test_a_map_is_charged_as_the_plant_charges_it_and_never_ignored(name):
    train = trainset(Efficiency(SPEEDS, SHARES, MAPS[name]))
    plan = optimal_plan(section(), train, 101.0, LINE)
    assert plan.energy_j == pytest.approx(line_energy_j(plan, train), rel=1e-5)
    assert plan.running_time_s == pytest.approx(101.0, abs=1e-3)
    # a plan that knows the map is no dearer than one that does not
    ignorant = optimal_plan(section(), trainset(), 101.0, LINE)
    assert plan.energy_j <= line_energy_j(ignorant, train) * (1 + 1e-4)
    # the hull is a bound: exact to its grid of shares, loose where part load is dear
    assert -1e-3 < plan.gap < 0.03


def test_maps_change_the_plan_in_the_right_direction():
    plans = {}
    for name, values in MAPS.items():
        train = trainset(Efficiency(SPEEDS, SHARES, values))
        speed, share, work = work_shares(optimal_plan(section(), train, 101.0, LINE), train)
        plans[name] = float((share * work).sum() / work.sum()), float((speed * work).sum() / work.sum())
    _, share, work = work_shares(optimal_plan(section(), trainset(), 101.0, LINE), trainset())
    plain = float((share * work).sum() / work.sum())
    assert plans["full load is dear"][0] < 0.7 < plain < plans["part load is dear"][0]
    assert plans["fast is dear"][1] < plans["slow is dear"][1] - 0.2
