"""The floor of a line whose trains meet seldom: no timetable and no driving undercuts it, and it is sharp."""

from dataclasses import replace
from functools import cache
from math import inf

import numpy as np
import pytest
from tests.operation.lines import TRAINSET, short_line

from metropilot.errors import Infeasible
from metropilot.operation import (
    LineOperation,
    OperationOptions,
    Timetable,
    TripFloors,
    find_timetable,
    profile_of_plan,
    zone_floor_j,
)
from metropilot.operation.floor import _meeting, _Windows
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import (
    PlanOptions,
    ReceivedEnergy,
    Receiver,
    cruise_plan,
    minimum_running_time,
    plan_arrays,
)
from metropilot.railway import Efficiency

STATIONS, WINDOW_S = 4, 1
EVERYBODY = Receiver(inf, inf, inf)


def operation(**given):
    options = {"zones": 3, "time_window_s": WINDOW_S} | given
    return LineOperation(short_line(STATIONS), TRAINSET, OperationOptions(**options))


@cache
def floors():
    return TripFloors(operation())


@cache
def drivings():
    """Drivings of every trip at every running time: plans for several receptivities, soft ones, cruising."""
    line, found = operation(), []
    silent = line.silent
    for trip in line.trips:
        track = track_arrays(trip.section, silent)
        kinds = []
        for receptivity, brake_mps2 in ((0.9, None), (0.0, None), (0.45, None), (0.9, 0.6), (0.0, 0.4)):
            vehicle = vehicle_arrays(replace(silent, receptivity=receptivity))
            options = PlanOptions(objective="line", deceleration_mps2=brake_mps2)
            plans = {s: plan_arrays(vehicle, track, float(s), options) for s in trip.allowed_s}
            kinds.append({s: profile_of_plan(plan, silent) for s, plan in plans.items()})
        options = PlanOptions(objective="line")
        plans = {s: cruise_plan(trip.section, silent, float(s), options) for s in trip.allowed_s}
        kinds.append({s: profile_of_plan(plan, silent) for s, plan in plans.items()})
        found.append(kinds)
    return found


def random_timetable(line, random):
    """Running times and dwells anywhere in their windows, with the planned sum in each direction."""
    starts, running = [], line.planned_s
    for first in (0, line.count):
        a, b = first + random.choice(line.count, 2, replace=False)
        shift = int(random.integers(-WINDOW_S, WINDOW_S + 1))
        running[[a, b]] += shift, -shift
        move = int(random.integers(-line.options.dwell_window_s, line.options.dwell_window_s + 1))
        dwell = line.options.dwell_s + np.array([move, -move])
        steps = np.append(0, np.cumsum(running[first : first + line.count - 1] + dwell))
        starts.append(steps + random.uniform(0.0, line.options.headway_s))
    return Timetable(np.concatenate(starts), running)


@pytest.mark.parametrize(("headway_s", "zones"), [(120, 3), (400, 3), (400, 2)])
def test_no_timetable_and_no_driving_undercuts_the_floor(headway_s, zones):
    random = np.random.default_rng(headway_s + zones)
    line = operation(headway_s=headway_s, zones=zones)
    floor_j = zone_floor_j(line, floors(), windows=True)
    lowest = inf
    for _ in range(700):
        driven = [kinds[random.integers(len(kinds))] for kinds in drivings()]
        lowest = min(lowest, line.energy(random_timetable(line, random), driven).supplied_j)
    plans = [[kinds[k] for kinds in drivings()] for k in range(3)]
    lowest = min(lowest, line.energy(*find_timetable(line, plans, moves=1500, restarts=2)).supplied_j)
    # within a few percent: a floor of zero would not be undercut either
    assert floor_j < lowest < 1.08 * floor_j


def test_the_floor_of_the_planned_times_holds_for_every_offset():
    line = operation(headway_s=400)
    floor_j = zone_floor_j(line, floors())
    assert floor_j > zone_floor_j(line, floors(), windows=True)
    for kind in (0, 1, 2):
        driven = [kinds[kind] for kinds in drivings()]
        for offset_s in np.arange(0.0, 400.0, 6.7):
            assert line.energy(line.plain_timetable(offset_s), driven).supplied_j > floor_j


def test_trains_that_never_meet_receive_what_they_return_themselves():
    line = operation(headway_s=7200)
    alone = line.profiles(received_w=TRAINSET.auxiliary_w)
    energy_j = line.energy(line.plain_timetable(3600.0), alone).supplied_j
    own = [floors().least_energies(k, [frozenset()])[0].bound_j for k in range(len(line.trips))]
    aboard_j = TRAINSET.auxiliary_w * sum(line.journey_s(backward=b) for b in (False, True))
    assert sum(own) + aboard_j == pytest.approx(energy_j, rel=2e-3)
    assert sum(own) + aboard_j <= energy_j
    assert zone_floor_j(line, floors()) < sum(own) + aboard_j


def test_more_zones_never_lower_the_floor():
    by_zones = [zone_floor_j(operation(headway_s=500, zones=zones), floors()) for zones in (1, 2, 3)]
    assert by_zones[0] <= by_zones[1] * (1 + 1e-6)
    assert by_zones[1] <= by_zones[2] * (1 + 1e-6)
    assert by_zones[2] > 1.005 * by_zones[0]


def test_efficiencies_that_depend_on_speed_have_no_such_floor():
    value = np.array([[0.8, 0.9], [0.85, 0.92]])
    mapped = Efficiency(np.array([5.0, 15.0]), np.array([0.5, 1.0]), value)
    line = LineOperation(
        short_line(STATIONS), replace(TRAINSET, efficiency_traction=mapped), OperationOptions(zones=1)
    )
    assert zone_floor_j(line) == -inf


def test_a_running_time_is_bounded_by_the_nearest_tangent():
    window_s = 4
    line = operation(headway_s=400, time_window_s=window_s)
    meeting = _meeting(_Windows(line, windows=True), TripFloors(line), 1)
    planned = next(each for each in meeting.tangents if each.changes_s == (0, 0))
    assert {each.changes_s for each in meeting.tangents} == {(-3, -3), (0, 0), (3, 3)}
    energy_j = np.stack(list(meeting.energies_j()), axis=1)
    alone_j = np.stack(list(meeting._replace(tangents=(planned,)).energies_j()), axis=1)
    assert (energy_j >= alone_j).all()
    assert energy_j[:, window_s, window_s] == pytest.approx(alone_j[:, window_s, window_s])
    assert (energy_j[:, 0, -1] > 1.001 * alone_j[:, 0, -1]).all()


@cache
def trip():
    line = operation()
    silent, section, time_s = line.silent, line.trips[1].section, float(line.trips[1].planned_s)
    return vehicle_arrays(silent), track_arrays(section, silent), time_s


def least(case, own_w=0.0):
    vehicle, track, time_s = trip()
    return ReceivedEnergy(vehicle, track, time_s).bound(own_w, case)


def test_all_or_nothing_received_is_the_plan_of_that_receptivity():
    vehicle, track, time_s = trip()
    options = PlanOptions(objective="line")
    whole = plan_arrays(vehicle, track, time_s, options)
    none = plan_arrays(vehicle._replace(receptivity=np.float64(0.0)), track, time_s, options)
    assert least([EVERYBODY]).bound_j == pytest.approx(whole.bound_j, rel=1e-5)
    assert least([EVERYBODY]).second_w == pytest.approx(whole.second_w, rel=1e-2)
    assert least([]).bound_j == pytest.approx(none.bound_j, rel=1e-5)
    assert least([Receiver(inf, inf, 1e9)]).bound_j == pytest.approx(whole.bound_j, rel=1e-5)


def test_the_more_is_received_the_less_is_needed():
    levels = [least([], own_w).bound_j for own_w in (0.0, 1e5, 3e5, 1e6, 1e7)]
    assert levels == sorted(levels, reverse=True)
    assert levels[0] > 1.01 * levels[-1]
    late = [least([Receiver(inf, last_s, inf)]).bound_j for last_s in (2.0, 6.0, 10.0, 30.0)]
    assert late == sorted(late, reverse=True)
    # who is there until the brakes are applied receives nothing, who comes with them receives all
    assert least([Receiver(0.4 * trip()[2], inf, inf)]).bound_j == pytest.approx(levels[0], rel=1e-4)
    assert late[-1] == pytest.approx(levels[-1], rel=1e-4)


def test_what_a_trainset_takes_itself_is_found_on_its_best_drive():
    vehicle, track, time_s = trip()
    own_w = 120e3
    options = PlanOptions(objective="line")
    nothing = plan_arrays(vehicle._replace(receptivity=np.float64(0.0)), track, time_s, options)
    taken = ReceivedEnergy(vehicle, track, time_s).plan(own_w)
    assert taken.running_time_s == pytest.approx(time_s, abs=0.02)
    driven_j = []
    for plan in (taken, nothing):
        profile = profile_of_plan(plan, operation().silent)
        worth = np.minimum(0.9 * profile.returned_w, own_w).mean(axis=1)
        driven_j.append(profile.drawn_j - float(np.sum(np.diff(profile.time_s) * worth)))
    assert taken.bound_j <= driven_j[0] < 0.99 * driven_j[1]
    assert taken.bound_j == pytest.approx(driven_j[0], rel=2e-3)


def test_the_slope_is_below_the_energy_of_other_running_times():
    vehicle, track, time_s = trip()
    case = [Receiver(inf, 8.0, inf)]
    here = least(case, 120e3)
    for change_s in (-4.0, 4.0, 10.0):
        there = ReceivedEnergy(vehicle, track, time_s + change_s).bound(120e3, case)
        assert here.bound_j - here.second_w * change_s <= there.bound_j * (1 + 1e-6)


@pytest.mark.parametrize("length_m", [221.0, 228.0, 235.0])
def test_the_minimum_running_time_has_a_bound_and_a_drive_on_a_coarser_mesh(length_m):
    section = replace(short_line(STATIONS).sections()[1], length_m=length_m)
    least_s = minimum_running_time(section, TRAINSET) + 1e-3
    energy = ReceivedEnergy(vehicle_arrays(TRAINSET), track_arrays(section, TRAINSET), least_s)
    assert least_s < energy.clock_s[-1] < least_s * 1.001, "a hair later"
    assert energy.bound(0.0, [EVERYBODY]).bound_j <= energy.bound(0.0, []).bound_j
    driven = cruise_plan(section, TRAINSET, least_s)
    assert least_s < driven.running_time_s < least_s * 1.001
    with pytest.raises(Infeasible, match="minimum running time"):
        cruise_plan(section, TRAINSET, least_s - 0.01)
