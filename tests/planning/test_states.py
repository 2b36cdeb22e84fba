"""Plans from any state, with restrictions, jerk limits and requests that nothing can meet."""

import dataclasses

import numpy as np
import pytest
from tests.planning import cases

from metropilot.errors import Infeasible, InputError
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import Davis, EffortCurve, Restriction, load_trainset


def section():
    return cases.yizhuang().section("RJ", "WYJ")


def test_the_rest_of_an_optimal_plan_is_optimal():
    # Bellman: from a state on the plan with the time left, nothing is better than going on
    full = optimal_plan(section(), cases.contest(), 101.0)
    for node in (12, 20, 30):
        start = PlanOptions(start_m=float(full.position_m[node]), start_mps=float(full.speed_mps[node]))
        rest = optimal_plan(section(), cases.contest(), 101.0 - float(full.time_s[node]), start)
        going_on = np.sum(full.traction_n[node:] * np.diff(full.position_m)[node:])
        assert rest.energy_j == pytest.approx(going_on, rel=2e-3, abs=100.0)
        assert rest.position_m[0] == start.start_m
        assert rest.speed_mps[0] == start.start_mps


@pytest.mark.parametrize("start_mps", [9.0, 12.0, 15.0, 19.0])
@pytest.mark.parametrize("late_w", [None, 500.0])
def test_a_new_restriction_ahead_is_met_as_soon_as_the_brakes_can(start_mps, late_w):
    # 50 m before a 9 m/s zone: 19 m/s needs (19^2 - 9^2) / (2 * 0.95) = 147 m, so it enters too fast
    restricted = section().with_restriction(Restriction(450.0, 700.0, 9.0))
    options = PlanOptions(start_m=400.0, start_mps=start_mps, late_w=late_w)
    plan = optimal_plan(restricted, cases.contest(), 130.0, options)
    inside = (plan.position_m >= 450.0) & (plan.position_m <= 700.0)
    fast = plan.speed_mps > 9.0 + 1e-3
    assert np.any(fast & inside) == (start_mps > 13.0)
    braking = 0.98 * (166e3 / trainset_mass() + 0.06)  # brakes, and the resistance about there
    reach = 400.0 + (start_mps**2 - 81.0) / (2 * braking) + 15.0
    assert not np.any(fast & inside & (plan.position_m > reach))
    assert abs(plan.gap) < 1e-3 or abs(plan.energy_j - plan.bound_j) < 1e3


def trainset_mass():
    return cases.contest().mass_kg


def test_above_the_limit_already_it_brakes_at_once():
    restricted = section().with_restriction(Restriction(300.0, 700.0, 10.0))
    start = PlanOptions(start_m=400.0, start_mps=16.0)
    plan = optimal_plan(restricted, cases.contest(), 130.0, start)
    first = np.diff(0.5 * plan.speed_mps**2)[:5] / np.diff(plan.position_m)[:5]
    assert np.all(first < -0.8)


def test_a_cap_from_outside_is_kept():
    at = np.array([0.0, 500.0, 500.1, 800.0, 800.1, 1300.0])
    cap = np.array([22.0, 22.0, 15.0, 15.0, 22.0, 22.0])
    options = PlanOptions(cap_m=at, cap_mps=cap)
    plan = optimal_plan(section(), cases.contest(), 105.0, options)
    x = np.linspace(0.0, 1279.9, 4000)
    speed = np.sqrt(np.interp(x, plan.position_m, plan.speed_mps**2))
    assert np.all(speed <= np.interp(x, at, cap) + 1e-3)
    assert plan.energy_j > optimal_plan(section(), cases.contest(), 105.0).energy_j


def test_too_little_time_left_arrives_as_early_as_it_can():
    start = PlanOptions(start_m=400.0, start_mps=15.0, late_w=500.0)
    plans = [optimal_plan(section(), cases.contest(), t, start) for t in (10.0, 40.0, 60.0)]
    fastest = minimum_running_time(section(), cases.contest())
    assert plans[0].running_time_s == pytest.approx(plans[1].running_time_s, abs=1e-3)
    assert 50.0 < plans[0].running_time_s < fastest
    assert plans[2].running_time_s == pytest.approx(60.0, abs=1e-3)
    # the certificate compares drives that are as late
    assert all(abs(p.gap) < 1e-5 for p in plans)


def test_a_lateness_price_is_the_marginal_price_of_a_late_plan():
    # cheap seconds are taken: late until the marginal price has fallen to what a second costs
    cheap = PlanOptions(late_w=8.0)
    plan = optimal_plan(section(), cases.contest(), 84.0, cheap)
    assert plan.running_time_s > 84.0 + 1.0
    assert plan.second_w / trainset_mass() == pytest.approx(8.0, rel=1e-3)
    on_time = optimal_plan(section(), cases.contest(), plan.running_time_s)
    assert plan.energy_j == pytest.approx(on_time.energy_j, rel=1e-4)


@pytest.mark.parametrize("jerk", [0.3, 0.7, 1.0])
def test_jerk_limit_along_the_plan(jerk):
    free = optimal_plan(section(), cases.contest(), 101.0)
    plan = optimal_plan(section(), cases.contest(), 101.0, PlanOptions(jerk_mps3=jerk))
    acceleration = np.diff(0.5 * plan.speed_mps**2) / np.diff(plan.position_m)
    time = np.diff(plan.time_s)
    change = np.diff(acceleration) / (0.5 * (time[1:] + time[:-1]))
    assert np.abs(change).max() < 1.01 * jerk
    # from rest x = J t^3 / 6: after ds the speed is (9 J ds^2 / 2)^(1/3), a mean of v^2 / 2 ds
    ds = plan.position_m[1]
    assert acceleration[0] <= 1.01 * (9 * jerk * ds**2 / 2) ** (2 / 3) / (2 * ds)
    assert plan.running_time_s == pytest.approx(101.0, abs=1e-3)
    assert free.energy_j * 1.005 < plan.energy_j < free.energy_j * 1.1


def test_less_jerk_costs_more():
    energies = [
        optimal_plan(section(), cases.contest(), 101.0, PlanOptions(jerk_mps3=j)).energy_j
        for j in (0.3, 0.5, 1.0, 2.0)
    ]
    assert energies == sorted(energies, reverse=True)


def test_below_the_minimum_running_time_is_explained():
    fastest = minimum_running_time(section(), cases.contest())
    with pytest.raises(Infeasible, match=r"minimum running time is 82\.1 s: 70\.0 s \(allowed: >= 82\.1 s\)"):
        optimal_plan(section(), cases.contest(), 70.0)
    with pytest.raises(Infeasible, match=r"minimum running time is 82\.1 s"):
        optimal_plan(section(), cases.contest(), fastest - 1e-6)
    # what the message allows is allowed
    assert optimal_plan(section(), cases.contest(), 82.1).running_time_s == pytest.approx(82.1, abs=1e-3)


@pytest.mark.parametrize("stops", [("RJ", "WYJ"), ("XHM", "JG"), ("JHL", "CQN")])
def test_exactly_the_minimum_running_time_is_solved(stops):
    here = cases.yizhuang().section(*stops)
    fastest = minimum_running_time(here, cases.contest("AW3"))
    plan = optimal_plan(here, cases.contest("AW3"), fastest)
    assert fastest - 1e-3 < plan.running_time_s < fastest * (1 + 5e-4)


def test_a_stall_says_where_and_what_holds_the_trainset():
    # 0.5 m/s2 of traction and 9.81 * 0.06 = 0.589 N/kg uphill from 300 m; the momentum of 15 m/s carries on
    # until v^2/2 = 112 J/kg are used up at 0.589 + 0.02 - 0.5 = 0.109 N/kg: about 1 km
    climb = cases.simple_section(2500.0, limits=((0.0, 15.0),), gradients=((0.0, 0.0), (300.0, 60.0)))
    weak = cases.simple_trainset(traction=EffortCurve.constant(100e3))
    with pytest.raises(
        Infeasible, match=r"the trainset stalls at 13\d\d m.*gradient and curve take 0\.589 N/kg"
    ):
        optimal_plan(climb, weak, 300.0)


def test_a_start_too_fast_to_stop_is_explained():
    start = PlanOptions(start_m=1200.0, start_mps=15.0)
    with pytest.raises(Infeasible, match="cannot bring it below"):
        optimal_plan(section(), cases.contest(), 30.0, start)


@pytest.mark.parametrize("time_s", [0.0, -1.0, float("nan"), float("inf")])
def test_times_that_are_none(time_s):
    with pytest.raises(InputError, match="running time out of range"):
        optimal_plan(section(), cases.contest(), time_s)


@pytest.mark.parametrize("start_m", [-1.0, 1280.0, 5000.0])
def test_starts_outside_the_section(start_m):
    with pytest.raises(InputError, match="start outside the section"):
        optimal_plan(section(), cases.contest(), 100.0, PlanOptions(start_m=start_m))


def test_downhill_without_traction():
    # -20 permil and next to no resistance: gravity does it all, the certificate must not divide by 0
    steep = cases.simple_section(800.0, gradients=((0.0, -20.0),))
    free = cases.simple_trainset(davis=Davis(100.0, 0.0, 0.0))
    plan = optimal_plan(steep, free, 200.0)
    assert plan.energy_j < 1e4
    assert abs(plan.energy_j - plan.bound_j) < 1e3
    assert plan.running_time_s == pytest.approx(200.0, abs=2e-2)


def test_length_and_rotating_mass_count():
    base = load_trainset("dkz32")
    heavy = dataclasses.replace(base, rotating_fraction=0.1)
    a, b = (optimal_plan(section(), t, 101.0).energy_j for t in (base, heavy))
    assert a * 1.02 < b < a * 1.15


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"spacing_m": 0.0}, "spacing_m"),
        ({"start_mps": -1.0}, "start_mps"),
        ({"start_mps": float("nan")}, "start_mps"),
        ({"end_mps": -1.0}, "end_mps"),
        ({"jerk_mps3": 0.0}, "jerk_mps3"),
        ({"late_w": -50.0}, "late_w"),
        ({"acceleration_mps2": 0.0}, "acceleration_mps2"),
        ({"deceleration_mps2": -0.5}, "deceleration_mps2"),
        ({"passes": 0}, "passes"),
        ({"cap_m": np.zeros(3)}, "cap_mps"),
        ({"cap_mps": np.ones(2)}, "cap_mps"),
    ],
)
def test_options_out_of_range_are_refused(wrong, field):
    with pytest.raises(InputError) as told:
        PlanOptions(**wrong)
    assert told.value.field == field


@pytest.mark.parametrize(("field", "value"), [("objective", "Line"), ("cap_mps", np.ones(2))])
def test_options_are_checked_without_the_types_too(field, value):
    options = PlanOptions(cap_m=np.arange(3.0), cap_mps=np.ones(3))
    object.__setattr__(options, field, value)  # the tests check annotations, a user's program does not
    with pytest.raises(InputError) as told:
        options.__post_init__()
    assert told.value.field == field


def test_acceleration_limits_of_the_options_only_tighten_the_trainset_s():
    plain = optimal_plan(section(), cases.contest(), 110.0)
    loose = PlanOptions(acceleration_mps2=5.0, deceleration_mps2=5.0)
    tight = PlanOptions(acceleration_mps2=0.5)
    assert optimal_plan(section(), cases.contest(), 110.0, loose).energy_j == plain.energy_j
    assert optimal_plan(section(), cases.contest(), 110.0, tight).energy_j > plain.energy_j
