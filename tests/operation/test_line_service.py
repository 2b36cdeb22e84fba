"""A line in operation: exact sums of power, energy that adds up, and a floor below every timetable."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.operation.lines import TRAINSET, short_line

from metropilot.errors import Infeasible, InputError
from metropilot.evaluate import make_driver
from metropilot.operation import (
    LineOperation,
    OperationOptions,
    PeriodicPower,
    Timetable,
    add_periodic,
    divide_zones,
    profile_of_plan,
    profile_of_trajectory,
)
from metropilot.planning import PlanOptions, coast_plan, cruise_plan, minimum_running_time, optimal_plan
from metropilot.railway import load_line
from metropilot.sim import Run, drive


def operation(**given):
    return LineOperation(short_line(4), TRAINSET, OperationOptions(**({"zones": 2} | given)))


@cache
def profiles(driving="optimal"):
    return operation().profiles(driving, windows=True)


def planned_profiles(line, found):
    """Profiles at the planned running times."""
    return [{t.planned_s: p[t.planned_s]} for t, p in zip(line.trips, found, strict=True)]


def random_timetable(line, random):
    """Running times and dwells within their windows, each with the planned sum in its direction."""
    running, starts = line.planned_s, []
    for backward in (False, True):
        of = [k for k, trip in enumerate(line.trips) if trip.backward == backward]
        a, b = random.choice(of, 2, replace=False)
        running[a] += (shift := int(random.integers(0, 5)))
        running[b] -= shift
        dwell = np.full(line.count - 1, line.options.dwell_s)
        move = int(random.integers(-10, 11))
        dwell[0] += move
        dwell[1] -= move
        steps = running[of[:-1]] + dwell
        starts.append(np.concatenate([[0], np.cumsum(steps)]) + random.uniform(0.0, line.options.headway_s))
    return Timetable(np.concatenate(starts).astype(float), running)


def test_two_rectangles_add_and_wrap_in_closed_form():
    start, lasts = np.array([95.0, 10.0]), np.array([20.0, 30.0])
    power = np.array([[2.0, 2.0], [-5.0, -5.0]])
    total = add_periodic(start, lasts, power, 100.0)
    # 95 to 100 and 0 to 10: 2; 10 to 15: -3; 15 to 40: -5
    assert total.positive_j == pytest.approx(30.0, rel=1e-14)
    assert total.negative_j == pytest.approx(15.0 + 125.0, rel=1e-14)


def test_a_piece_longer_than_the_headway_meets_itself():
    total = add_periodic(np.array([30.0]), np.array([250.0]), np.array([[1.0, 1.0]]), 100.0)
    assert total.positive_j == pytest.approx(250.0, rel=1e-14)
    assert sorted(set(np.round(total.power_w[np.diff(total.time_s) > 1e-9].ravel(), 9))) == [2.0, 3.0]


def test_a_ramp_through_zero_is_two_triangles():
    ramp = PeriodicPower(np.array([0.0, 10.0]), np.array([[-3.0, 1.0]]))
    assert ramp.positive_j == pytest.approx(0.5 * 2.5 * 1.0)
    assert ramp.negative_j == pytest.approx(0.5 * 7.5 * 3.0)


def test_the_power_of_a_plan_integrates_to_its_energy():
    line = operation(transfer_loss=0.25)
    trip = line.trips[0]
    quiet = replace(line.trainset, auxiliary_w=0.0)
    plan = optimal_plan(trip.section, quiet, float(trip.planned_s), PlanOptions(objective="line"))
    found = profile_of_plan(plan, quiet)
    assert found.drawn_j - 0.75 * found.returned_j == pytest.approx(plan.energy_j, rel=1e-12)
    assert found.drawn_j == pytest.approx(plan.energy_wheel_j / 0.9, rel=1e-12)


def test_the_power_of_a_driven_run_integrates_to_its_energy_at_the_line():
    section = short_line(4).section("XC", "XHM")
    driven = drive(Run(section, TRAINSET, 108.0), make_driver("optimal")).trajectory
    found = profile_of_trajectory(driven, TRAINSET)
    share, aboard = TRAINSET.receptivity, TRAINSET.auxiliary_w * driven.time_s[-1]
    net_j = found.drawn_j - share * found.returned_j + aboard
    assert net_j == pytest.approx(driven.energy_line_j[-1], rel=1e-6)


def test_cruise_and_brake_keeps_its_time_and_costs_more_than_the_bound():
    section = short_line(4).section("XC", "XHM")
    for time_s in (100.0, 108.0, 140.0):
        cruise = cruise_plan(section, TRAINSET, time_s)
        assert cruise.running_time_s == pytest.approx(time_s, abs=1e-5)
        assert cruise.energy_j > optimal_plan(section, TRAINSET, time_s).bound_j
    top = cruise.speed_mps.max()
    # a third or more of the way at the cruising speed itself
    assert np.sum(np.diff(cruise.position_m)[cruise.speed_mps[1:] > top - 1e-6]) > section.length_m / 3
    with pytest.raises(Infeasible, match="minimum running time"):
        cruise_plan(section, TRAINSET, minimum_running_time(section, TRAINSET) - 1.0)
    assert cruise_plan(section, TRAINSET, 140.0).bound_j == -np.inf


@pytest.mark.parametrize("share", [1.05, 1.2, 1.5])
@pytest.mark.parametrize("ends", [("XHM", "JG"), ("XC", "XHM"), ("JG", "XHM")])
def test_coasting_keeps_its_time_and_costs_more_than_the_bound(ends, share):
    section = short_line(4).section(*ends)
    time_s = share * minimum_running_time(section, TRAINSET)
    options = PlanOptions(objective="line")
    coast = coast_plan(section, TRAINSET, time_s, options)
    assert coast.running_time_s == pytest.approx(time_s, abs=1e-5)
    assert coast.energy_j > optimal_plan(section, TRAINSET, time_s, options).bound_j
    assert coast.effort_excess < 0.01
    # after the flat-out run neither traction nor brake, until the stop or the brake that holds the speed
    begins = int(np.argmax(coast.traction_n < 1.0))
    assert begins > 3
    assert (np.diff(coast.speed_mps[begins:]) < 1e-9).all()


def test_coasting_takes_no_less_than_the_minimum():
    section = short_line(4).section("XC", "XHM")
    with pytest.raises(Infeasible, match="minimum running time"):
        coast_plan(section, TRAINSET, minimum_running_time(section, TRAINSET) - 1.0)


@pytest.mark.parametrize("loss", [0.0, 0.1, 1.0])
def test_energy_is_neither_made_nor_lost(loss):
    line = operation(transfer_loss=loss, headway_s=100)
    balance = line.energy(line.plain_timetable(31.7), profiles("cruise"))
    assert balance.supplied_j + balance.received_j == pytest.approx(balance.drawn_j, rel=1e-9)
    gone = balance.received_j + balance.transferred_loss_j + balance.unreceived_j
    assert gone == pytest.approx(balance.returned_j, rel=1e-9)
    assert min(balance.received_j, balance.transferred_loss_j, balance.unreceived_j) >= -1e-3


def test_the_sum_of_power_is_that_of_a_fine_sampling():
    line = operation(headway_s=100)
    timetable, found = line.plain_timetable(31.7), profiles()
    step_s = 0.005
    at = np.arange(0.5 * step_s, 100.0, step_s)
    total = np.zeros((2, at.size))
    dwell = line.dwells_s(timetable)
    for k, trip in enumerate(line.trips):
        each = found[k][int(timetable.running_time_s[k])]
        net = each.net_w(0.1)
        for turn in range(-1, 9):
            since = at + 100.0 * turn - timetable.departure_s[k]
            j = np.clip(np.searchsorted(each.time_s, since, side="right") - 1, 0, net.shape[0] - 1)
            way = (since - each.time_s[j]) / np.diff(each.time_s)[j]
            moving = (since >= 0) & (since < each.running_time_s)
            standing = (since >= each.running_time_s) & (since < each.running_time_s + dwell[k])
            total[trip.zone] += np.where(moving, net[j, 0] + way * (net[j, 1] - net[j, 0]), 0.0)
            total[trip.zone] += TRAINSET.auxiliary_w * (moving | standing)
    sampled = np.sum(np.maximum(total, 0.0)) * step_s
    assert line.energy(timetable, found).supplied_j == pytest.approx(sampled, rel=1e-4)


def test_no_timetable_undercuts_the_floor():
    random = np.random.default_rng(1)
    for headway_s in (60, 97, 400):
        line = operation(headway_s=headway_s, zones=1, time_window_s=4)
        floor_j = line.floor_j(profiles())
        assert floor_j < line.floor_j(planned_profiles(line, profiles()))
        for _ in range(30):
            timetable = random_timetable(line, random)
            for driving in ("optimal", "cruise"):
                assert line.energy(timetable, profiles(driving)).supplied_j > floor_j


def test_the_floor_is_met_where_others_always_draw_more_than_is_returned():
    # auxiliaries above any returned power take all of it, in every timetable
    hungry = replace(TRAINSET, auxiliary_w=1e8)
    line = LineOperation(short_line(4), hungry, OperationOptions(zones=1))
    found = planned_profiles(line, profiles())
    for offset_s in (0.0, 50.0, 111.1):
        energy_j = line.energy(line.plain_timetable(offset_s), found).supplied_j
        assert energy_j == pytest.approx(line.floor_j(found), rel=1e-9)


def test_a_train_alone_on_the_line_returns_in_vain():
    alone = replace(TRAINSET, auxiliary_w=0.0)
    line = LineOperation(short_line(4), alone, OperationOptions(zones=3, headway_s=7200))
    found = planned_profiles(line, profiles())
    balance = line.energy(line.plain_timetable(3600.0), found)
    assert balance.supplied_j == pytest.approx(balance.drawn_j, rel=1e-9)
    assert balance.received_j == pytest.approx(0.0, abs=1e-3)


def test_the_auxiliaries_of_a_train_count_while_it_is_on_the_way():
    line = operation()
    quiet = LineOperation(short_line(4), replace(TRAINSET, auxiliary_w=0.0), line.options)
    table = line.plain_timetable(40.0)
    seconds = sum(line.journey_s(backward=b) for b in (False, True))
    more = line.energy(table, profiles()).drawn_j - quiet.energy(table, profiles()).drawn_j
    assert more == pytest.approx(TRAINSET.auxiliary_w * seconds, rel=1e-6)


def test_the_fleet_holds_both_journeys_and_the_turn_rounds():
    line = operation(headway_s=100, turnround_s=60)
    there, back = (line.journey_s(backward=b) for b in (False, True))
    assert line.fleet(line.plain_timetable(float(there + 60))) == -(-(there + back + 120) // 100)
    late = line.fleet(line.plain_timetable(float(there + 59)))
    assert late == -(-(there + back + 120 + 99) // 100)


def test_zones_meet_at_stations_and_none_is_empty():
    line = load_line("yizhuang")
    for zones in range(1, 14):
        found = divide_zones(line, zones)
        assert found.size == 13
        assert sorted(set(found.tolist())) == list(range(zones))
        assert (np.diff(found) >= 0).all()
    with pytest.raises(InputError, match="too many feeding zones"):
        divide_zones(line, 14)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"zones": 0}, "zones"),
        ({"headway_s": 0}, "headway_s"),
        ({"dwell_s": 20, "dwell_window_s": 21}, "dwell_window_s"),
        ({"transfer_loss": 1.1}, "transfer_loss"),
        ({"efficiency_braking": 0.0}, "efficiency_braking"),
    ],
)
def test_a_bad_option_is_named(given, field):
    with pytest.raises(InputError) as error:
        OperationOptions(**given)
    assert error.value.field == field


def test_a_timetable_below_the_minimum_running_time_names_its_section():
    line = replace(short_line(4), planned_forward_s=(190.0, 60.0, 157.0))
    with pytest.raises(Infeasible, match="XC-XHM"):
        LineOperation(line, TRAINSET, OperationOptions(zones=1))
    planless = replace(short_line(4), planned_forward_s=(), planned_backward_s=())
    trip = LineOperation(planless, TRAINSET, OperationOptions(zones=1, reserve=0.2)).trips[0]
    minimum_s = minimum_running_time(trip.section, TRAINSET)
    assert 1.2 * minimum_s <= trip.planned_s < 1.2 * minimum_s + 1


def test_defaults_fit_the_line_and_what_is_given():
    fitting = OperationOptions.fitting
    assert fitting(short_line(2), {}) == {"zones": 1, "dwell_window_s": 10}
    assert fitting(short_line(9), {"dwell_s": 5}) == {"zones": 4, "dwell_window_s": 5}
    assert fitting(short_line(2), {"zones": 3, "dwell_window_s": 8, "dwell_s": 5}) == {}
