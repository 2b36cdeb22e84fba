"""The sharp floor: what trains can exchange while they meet; no timetable and no driving undercuts it."""

from functools import cache
from math import inf

import numpy as np
import pytest
from tests.operation.lines import TRAINSET
from tests.operation.test_floor import WINDOW_S, drivings, floors, operation, random_timetable

from metropilot.errors import InputError
from metropilot.operation import (
    LineOperation,
    OperationOptions,
    TripFloors,
    adapt_plans,
    find_timetable,
    zone_floor_j,
)
from metropilot.operation.floor import _exchange, _meeting, _Windows
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import ExchangeTrip, ReceivedEnergy, Receiver, exchange_bound
from metropilot.railway import load_line, load_trainset

EVERYBODY = Receiver(inf, inf, inf)


@cache
def sharp_floor_j(headway_s):
    return zone_floor_j(operation(headway_s=headway_s), floors(), windows=True, sharp=True, programmes=350)


@pytest.mark.parametrize("headway_s", [150, 320])
def test_no_timetable_and_no_driving_undercuts_the_sharp_floor(headway_s):
    random = np.random.default_rng(headway_s)
    line = operation(headway_s=headway_s)
    floor_j, lowest = sharp_floor_j(headway_s), inf
    for _ in range(500):
        driven = [kinds[random.integers(len(kinds))] for kinds in drivings()]
        lowest = min(lowest, line.energy(random_timetable(line, random), driven).supplied_j)
    plans = [[kinds[k] for kinds in drivings()] for k in range(3)]
    timetable, profiles = find_timetable(line, plans, moves=1500, restarts=2)
    lowest = min(lowest, line.energy(timetable, adapt_plans(line, timetable, profiles)).supplied_j)
    assert floor_j < lowest < 1.06 * floor_j


@pytest.mark.parametrize(
    ("headway_s", "timetables", "some", "near"),
    [(150, 3, (0, 1, 2), 1.02), (320, 3, (0, 1, 2), 1.02), (150, 1, (2,), 1.03)],
)
def test_no_drives_undercut_a_section_however_finely_it_is_bounded(headway_s, timetables, some, near):
    random = np.random.default_rng(headway_s)
    line, own_w = operation(headway_s=headway_s), TRAINSET.auxiliary_w
    allowed = _Windows(line, windows=True)
    sections = {k: _exchange(allowed, floors(), k, _meeting(allowed, floors(), k)) for k in some}
    sharper, nearest = 0, inf
    for _ in range(timetables):
        timetable = random_timetable(line, random)
        driven = adapt_plans(line, timetable, [kinds[random.integers(3)] for kinds in drivings()])
        dwell = line.dwells_s(timetable)
        for k, section in sections.items():
            pair = [k, len(line.trips) - 1 - k]
            running = timetable.running_time_s[pair]
            change = running - line.planned_s[pair]
            aboard_j = own_w * float((running + dwell[pair]).sum())
            zone_j = line.power_in(line.trips[k].zone, timetable, driven).positive_j - aboard_j
            row = int(timetable.arrival_s[pair[1]] - timetable.departure_s[k]) % headway_s
            at = row, *(int(c) + WINDOW_S for c in change)
            first_j = section.energy_j[at]
            while section.refine(row, int(change.sum())):
                assert section.energy_j[at] <= zone_j
            sharper += section.energy_j[at] > first_j
            nearest = min(nearest, zone_j / section.energy_j[at])
    assert sharper >= timetables
    assert nearest < near


def test_it_is_sharper_where_trains_meet_seldom():
    plain_j = zone_floor_j(operation(headway_s=320), floors(), windows=True)
    assert sharp_floor_j(320) > 1.003 * plain_j


def test_zones_of_several_sections_are_refused():
    with pytest.raises(InputError, match=r"zones.*allowed: 3"):
        zone_floor_j(operation(zones=2), sharp=True)


@cache
def trips():
    line = operation()
    vehicle = vehicle_arrays(line.silent)
    asked = line.trips[1], line.trips[-2]
    tracks = [track_arrays(each.section, line.silent) for each in asked]
    changes = [[s - each.planned_s for s in each.allowed_s] for each in asked]
    made = zip(tracks, asked, changes, strict=True)
    return (
        tuple(ExchangeTrip(vehicle, track, float(each.planned_s), change) for track, each, change in made),
        [
            ReceivedEnergy(vehicle, track, float(each.planned_s))
            for track, each in zip(tracks, asked, strict=True)
        ],
    )


def test_two_trips_that_always_meet_receive_all_and_apart_what_they_take_themselves():
    both, alone = trips()
    count = sum(each.groups for each in both)
    every = np.argwhere(np.ones((count, count), dtype=bool))
    none = np.zeros((0, 2), dtype=int)
    nothing, plenty = np.zeros(count), np.full(count, 1e9)
    whole_j = sum(each.bound(0.0, [EVERYBODY]).bound_j for each in alone)
    apart_j = sum(each.bound(0.0, []).bound_j for each in alone)
    assert exchange_bound(both, none, plenty).bound_j == pytest.approx(whole_j, rel=1e-4)
    assert exchange_bound(both, none, nothing).bound_j == pytest.approx(apart_j, rel=1e-4)
    # more is drawn than returned, so all that is returned finds somebody
    assert exchange_bound(both, every, nothing).bound_j == pytest.approx(whole_j, rel=1e-4)
    half = every[every[:, 0] < both[0].groups]
    assert whole_j * 1.001 < exchange_bound(both, half, nothing).bound_j < apart_j * 0.999


def test_the_bound_in_other_running_times_is_above_the_tangent_of_the_planned_ones():
    both, _ = trips()
    count = sum(each.groups for each in both)
    every = np.argwhere(np.ones((count, count), dtype=bool))
    half, nothing = every[every[:, 0] < both[0].groups], np.zeros(count)
    planned = exchange_bound(both, half, nothing)
    for changes_s in ((-WINDOW_S, WINDOW_S), (WINDOW_S, 1)):
        there_j = exchange_bound(both, half, nothing, changes_s).bound_j
        sloped_j = sum(w * change for w, change in zip(planned.second_w, changes_s, strict=True))
        assert planned.bound_j - sloped_j < there_j * (1 - 1e-4)
        least_j = sum(each.least_j[change] for each, change in zip(both, changes_s, strict=True))
        assert exchange_bound(both, every, nothing, changes_s).bound_j == pytest.approx(least_j, rel=1e-4)


def test_a_trip_may_be_as_fast_as_its_window_allows():
    trainset = load_trainset("ch_stadler_flirt_tpf")
    line = LineOperation(
        load_line("zurich-stadelhofen"), trainset, OperationOptions(zones=3, time_window_s=20)
    )
    fastest = line.trips[0]
    change_s = fastest.allowed_s[0] - fastest.planned_s
    trip = TripFloors(line).exchange_trip(0, range(change_s, change_s + 1))
    flat_s = trip.flat_s[-1]
    assert flat_s < fastest.allowed_s[0] < flat_s + 1.0
    track = track_arrays(fastest.section, line.silent)
    energy = ReceivedEnergy(vehicle_arrays(line.silent), track, float(fastest.allowed_s[0]))
    assert trip.least_j[change_s] == pytest.approx(energy.bound(0.0, [EVERYBODY]).bound_j, rel=1e-4)


def test_drives_that_cost_little_more_pass_when_they_are_said_to():
    (trip, _), _ = trips()
    kinds = drivings()[1]
    checked = 0
    for excess_j, group_s in ((0.5 * 3.6e6, 5.0), (2.0 * 3.6e6, 1.25)):
        grouped = trip.regroup(group_s)
        for kind in kinds:
            for time_s, profile in kind.items():
                net_j = profile.drawn_j - 0.9 * profile.returned_j
                if net_j > trip.least_j[time_s - round(trip.time_s)] + excess_j:
                    continue
                passing = grouped.passing(excess_j, [time_s])
                at_s = np.interp(grouped.edges_m, profile.position_m, profile.time_s)
                assert (at_s >= passing.after_s[1:] - 0.05).all()
                assert (profile.running_time_s - at_s >= passing.before_s[:-1] - 0.05).all()
                checked += 1
    assert checked > 5
    times_s = list(kinds[0])
    tight, wide = trip.passing(1e5, times_s), trip.passing(1e7, times_s)
    assert (tight.after_s >= wide.after_s).all()
    assert (tight.before_s >= wide.before_s).all()
    assert (tight.after_s - wide.after_s).max() > 2.0
    assert (trip.passing(1e5, times_s[:1]).after_s >= tight.after_s).all()
