"""A day of a line: its sums beside those of one headway, its trains, its floor, its network."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.operation.lines import TRAINSET, short_line

from metropilot.errors import Infeasible, InputError
from metropilot.operation import (
    DayTimetable,
    Journeys,
    LineDay,
    LineOperation,
    OperationOptions,
    PeriodicPart,
    ServiceScatter,
    TripDrives,
    check_day,
    day_energy,
    day_floor_j,
    feed_day,
    lay_out_day,
    link_trains,
    plain_days,
    plan_trips,
    repeat_timetables,
    timetable_energy,
)
from metropilot.railway import Period, ServiceDay, Storage, load_feeding

HOUR_S = 3600


@cache
def operation():
    return LineOperation(short_line(4), TRAINSET, OperationOptions(zones=2, headway_s=120))


@cache
def profiles(driving="optimal"):
    return operation().profiles(driving)


def part(from_s, to_s, headway_s=120, offset_s=43.0):
    trips = len(operation().trips)
    timetable = operation().with_headway(headway_s).plain_timetable(offset_s)
    return PeriodicPart(from_s, to_s, headway_s, timetable, np.zeros(trips, dtype=int))


@cache
def working_day(**given):
    periods = (
        Period(name="early", from_s=5 * HOUR_S, to_s=6 * HOUR_S, headway_s=300),
        Period(name="peak", from_s=6 * HOUR_S, to_s=8 * HOUR_S, headway_s=110, dwell_s=40),
        Period(name="late", from_s=8 * HOUR_S, to_s=9 * HOUR_S, headway_s=400),
    )
    return ServiceDay(id="short", name="short day", line_id="yizhuang", periods=periods, **given)


def one_way(*starts_s):
    """Journeys of one section and 100 s."""
    count = len(starts_s)
    starts = np.array(starts_s, dtype=float).reshape(count, 1)
    zeros = np.zeros((count, 1), dtype=int)
    return Journeys(starts, zeros + 100, zeros, zeros[:, 0])


@pytest.mark.parametrize("driving", ["optimal", "cruise"])
def test_an_hour_amid_even_departures_is_that_of_the_headway(driving):
    timetable = repeat_timetables([part(0, 4 * HOUR_S)])
    power = LineDay(operation(), timetable, [profiles(driving)]).power()
    balance = operation().energy(operation().plain_timetable(43.0), profiles(driving))
    assert power.hourly_kwh[1:3] == pytest.approx(balance.supplied_kwh * 30, rel=1e-9)
    periodic = power.supplied_w[60:180].reshape(-1, 2, 2)
    # two minutes are the headway: every second minute is the same
    assert periodic == pytest.approx(np.broadcast_to(periodic[0], periodic.shape), rel=1e-7)


def test_the_energy_of_a_day_adds_up():
    timetable = repeat_timetables([part(0, 2000), part(2000, 9000, 87, 11.0)])
    line = LineDay(operation(), timetable, [profiles("cruise")])
    power = line.power()
    balance = line.energy(power)
    assert balance.supplied_j + balance.received_j == pytest.approx(balance.drawn_j, rel=1e-9)
    net_w = power.supplied_w.sum() - power.unused_w.sum()
    through = 1.0 - operation().options.transfer_loss
    assert 60.0 * net_w == pytest.approx(balance.drawn_j - through * balance.returned_j, rel=1e-9)
    aboard_s = sum(float((each.arrival_s[:, -1] - each.departure_s[:, 0]).sum()) for each in timetable)
    quiet = LineOperation(short_line(4), replace(TRAINSET, auxiliary_w=0.0), operation().options)
    silent_j = LineDay(quiet, timetable, [profiles("cruise")]).energy().drawn_j
    assert balance.drawn_j - silent_j == pytest.approx(TRAINSET.auxiliary_w * aboard_s, rel=1e-6)


def test_one_train_alone_returns_in_vain():
    quiet = LineOperation(short_line(4), replace(TRAINSET, auxiliary_w=0.0), operation().options)
    far = repeat_timetables([part(0, 7000, 7000, 3000.0)])
    balance = LineDay(quiet, far, [profiles()]).energy()
    assert balance.supplied_j == pytest.approx(balance.drawn_j, rel=1e-9)
    assert balance.received_j == pytest.approx(0.0, abs=1e-3)


def test_the_second_by_second_loads_have_the_energy_of_the_day():
    timetable = repeat_timetables([part(20000, 22000), part(22000, 23000, 250, 61.0)])
    line = LineDay(operation(), timetable, [profiles("cruise")])
    loads, seconds = line.loads()
    balance = line.energy()
    assert loads.power_w.sum() == pytest.approx(balance.drawn_j - balance.returned_j, rel=1e-9)
    first_s, last_s = timetable.span_s
    assert seconds == pytest.approx(last_s - first_s, abs=1.0)
    for way, each in enumerate(timetable):
        trains = loads.train[loads.backward == bool(way)]
        assert sorted(set(trains.tolist())) == list(range(each.period.size))
        second = 20000 + loads.second[(loads.backward == bool(way)) & (loads.train == 3)].min()
        assert second == each.departure_s[3, 0]


def test_the_network_of_a_day_balances_and_costs_more_than_zones():
    feeding = load_feeding("yizhuang")
    network = replace(feeding, substations=feeding.substations[:4])
    line = LineDay(operation(), repeat_timetables([part(0, 3000)]), [profiles()])
    links = link_trains(line.timetable, 120, 900)
    fed = feed_day(line, network, links)
    assert abs(fed.flow.imbalance) < 1e-9
    assert fed.energy_kwh > line.energy().supplied_kwh
    weak = replace(network, substations=(replace(network.substations[0], resistance_ohm=0.2),))
    with pytest.raises(Infeasible, match=r"train \d+ at \d+ m in second \d+"):
        feed_day(line, weak, links)


def test_a_train_keeps_its_storage_from_journey_to_journey():
    line = LineDay(operation(), repeat_timetables([part(0, 3000)]), [profiles()])
    links = link_trains(line.timetable, 120, 900)
    loads, _ = line.loads(links)
    parts = loads.journeys()
    assert len(parts) == links.fleet < line.timetable.journeys
    for number, rows in enumerate(parts):
        assert (np.diff(loads.second[rows]) >= 1).all()
        driven = set(zip(loads.backward[rows].tolist(), loads.train[rows].tolist(), strict=True))
        assert driven == {
            (bool(way), int(j))
            for way, train in enumerate(links.train)
            for j in np.flatnonzero(train == number)
        }


def test_storages_give_a_day_no_energy_that_they_did_not_take():
    feeding = load_feeding("yizhuang")
    aboard = Storage(capacity_j=72e6, power_w=8e5, charge_above_v=855.0, discharge_below_v=845.0)
    bare = replace(feeding, substations=feeding.substations[:4])
    line = LineDay(operation(), repeat_timetables([part(0, 900)]), [profiles()])
    links = link_trains(line.timetable, 120, 900)
    fed, without = (feed_day(line, each, links) for each in (replace(bare, onboard=aboard), bare))
    assert abs(fed.flow.stored_j) < 10.0
    given = -fed.flow.onboard_w[fed.flow.onboard_w < 0.0].sum()
    taken = fed.flow.onboard_w[fed.flow.onboard_w > 0.0].sum()
    assert 0.0 < given == pytest.approx(0.95**2 * taken, rel=1e-4)
    assert 0.9 * without.energy_kwh < fed.energy_kwh < without.energy_kwh


def test_periods_follow_each_other_without_a_train_too_near():
    offsets = {120: 43.0, 77: 70.0, 400: 5.0}
    parts = [part(a, b, h, offsets[h]) for a, b, h in ((0, 3000, 120), (3000, 6000, 77), (6000, 9000, 400))]
    found = repeat_timetables(parts)
    for each in found:
        gaps = np.diff(each.departure_s[:, 0])
        least = np.minimum(*(np.array([120, 77, 400])[p] for p in (each.period[1:], each.period[:-1])))
        assert (gaps >= least).all()
        for index, own in enumerate(parts):
            starts = each.departure_s[each.period == index, 0]
            assert (np.diff(starts) == own.headway_s).all()
            assert starts.min() >= own.from_s
            assert starts.max() < own.to_s
    for index, own in enumerate(parts):
        ahead = [each.departure_s[each.period == index, 0][0] for each in found]
        assert (ahead[1] - ahead[0]) % own.headway_s == offsets[own.headway_s] % own.headway_s
    # forward trains keep the headway of the period that they left in
    assert sorted(set(np.diff(found.forward.departure_s[:, 0]))) == [77.0, 120.0, 400.0]


def complaint_of(line, timetable, driven):
    """Complaint of a day with every trip driven by the same profiles; empty if it is possible."""
    try:
        check_day(line, timetable, [driven] * 3)
    except InputError as error:
        return error.line()
    return ""


@pytest.mark.parametrize("driving", ["optimal", "cruise"])
def test_a_train_that_dwells_less_does_not_reach_the_one_ahead(driving):
    periods = (
        Period(name="slow", from_s=0, to_s=2000, headway_s=300, dwell_s=150),
        Period(name="fast", from_s=2000, to_s=4000, headway_s=110, dwell_s=15),
    )
    line, day = operation(), replace(working_day(), periods=periods)
    plans = plan_trips(line)
    drivings = [plans["optimal"][0], *plans["cruise"]]
    found = lay_out_day(line, day, plans[driving], others=drivings)
    check_day(line, found, plans[driving])
    for timetable in (found, *plain_days(line, day, drivings)):
        for each in drivings:
            assert complaint_of(line, timetable, each) == ""
    first = int(np.flatnonzero(found.forward.period == 1)[0])
    gap_s = found.forward.departure_s[first, 0] - found.forward.departure_s[first - 1, 0]
    assert gap_s > 300.0
    # a second less is refused
    near = [each.departure_s - (each.period == 1)[:, None] for each in found]
    nearer = DayTimetable(*(each._replace(departure_s=s) for each, s in zip(found, near, strict=True)))
    complaints = [complaint_of(line, nearer, each) for each in drivings]
    assert any("allowed: at least" in each for each in complaints)


def test_timetables_are_compared_at_as_many_journeys():
    periods = (Period(name="one", from_s=0, to_s=1300, headway_s=400),)
    line, day = operation(), replace(working_day(), periods=periods)
    plans = plan_trips(line)
    found = day_energy(line, day, plans=plans)
    journeys = found.day.timetable.journeys
    plain = plain_days(line, day, [plans["optimal"][0], *plans["cruise"]])
    counts = {each.journeys for each in plain}
    assert len(counts) > 1
    each_kwh = [LineDay(line, each, plans["cruise"]).energy().supplied_kwh / each.journeys for each in plain]
    assert found.cruise_kwh == pytest.approx(journeys * np.mean(each_kwh), rel=1e-9)


def test_a_period_after_a_pause_begins_anew():
    found = repeat_timetables([part(0, 1000), part(5000, 6000)])
    assert found.forward.departure_s[found.forward.period == 1, 0][0] == 5000.0
    assert found.backward.departure_s[found.backward.period == 1, 0][0] == 5043.0


def test_trains_take_the_next_departure_after_the_turn_round():
    # 0 arrives at 100 and is ready at 150; 1 at 300 and ready at 350
    found = link_trains(DayTimetable(one_way(0, 200, 400), one_way(150, 349, 360)), 50, 1000)
    assert found.train[0].tolist() == [0, 1, 0]
    assert found.train[1].tolist() == [0, 2, 1]
    assert (found.fleet, found.pull_outs, found.pull_ins) == (3, 3, 3)


def test_a_train_that_waits_too_long_goes_to_the_depot_and_may_come_back():
    day = DayTimetable(one_way(0, 2000), one_way(1000))
    patient, hasty = (link_trains(day, 50, wait_s) for wait_s in (850, 849))
    assert (patient.fleet, patient.pull_outs) == (1, 1)
    assert (hasty.fleet, hasty.pull_outs, hasty.train[1].tolist()) == (1, 3, [0])


def test_a_train_at_the_other_end_comes_from_the_depot_as_well():
    links = link_trains(DayTimetable(one_way(0, 2000), one_way(4000)), 50, 900)
    assert (links.fleet, links.pull_outs) == (1, 3)


@pytest.mark.parametrize("headway_s", [97, 120, 400])
def test_the_fleet_of_a_long_even_day_is_that_of_the_headway(headway_s):
    line = operation().with_headway(headway_s)
    timetable = line.plain_timetable(43.0)
    links = link_trains(repeat_timetables([part(0, 4 * HOUR_S, headway_s)]), 120, 10**6)
    assert links.fleet == line.fleet(timetable)


def test_no_scatter_undercuts_the_floor_and_each_costs():
    line, timetable = operation(), repeat_timetables([part(0, 6000)])
    floor_j = day_floor_j(line, timetable, profiles())
    random = np.random.default_rng(2)
    for seconds in (3.0, 10.0, 40.0):
        moved = timetable.scatter(seconds, random)
        for each, before in zip(moved, timetable, strict=True):
            assert np.abs(each.departure_s - before.departure_s).max() <= seconds + 20.0
            assert (each.departure_s[:, 1:] >= each.arrival_s[:, :-1]).all()
        shorter_j = sum(
            TRAINSET.auxiliary_w
            * float(
                np.minimum(
                    each.arrival_s[:, -1]
                    - each.departure_s[:, 0]
                    - (before.arrival_s[:, -1] - before.departure_s[:, 0]),
                    0.0,
                ).sum()
            )
            for each, before in zip(moved, timetable, strict=True)
        )
        assert LineDay(line, moved, [profiles()]).energy().supplied_j > floor_j + shorter_j
        assert day_floor_j(line, moved, profiles()) >= floor_j + shorter_j


def test_a_train_that_arrives_late_leaves_at_once():
    slow = [
        {trip.planned_s: each[trip.planned_s]}
        for trip, each in zip(operation().trips, profiles(), strict=True)
    ]
    own = slow[0][operation().trips[0].planned_s]
    slow[0] = {operation().trips[0].planned_s: replace(own, time_s=own.time_s * 1.5)}
    timetable = repeat_timetables([part(0, 500)])
    line = LineDay(operation(), timetable, [slow])
    late_s = 1.5 * own.running_time_s
    assert line.timetable.forward.departure_s[:, 1] == pytest.approx(
        timetable.forward.departure_s[:, 0] + late_s
    )
    # the next ones are late by what the dwells do not take up
    assert line.timetable.forward.departure_s[0, 2] > timetable.forward.departure_s[0, 2]
    balance = line.energy()
    assert balance.supplied_j + balance.received_j == pytest.approx(balance.drawn_j, rel=1e-9)


def test_energy_of_a_last_train_that_arrives_late_is_that_of_the_day():
    """The minutes go on until it arrives, into another hour than its timetable says."""
    lasts = operation().count - 1
    late = [dict(each) for each in profiles()]
    late[lasts] = {
        running_s: replace(each, time_s=each.time_s * 1.5) for running_s, each in late[lasts].items()
    }
    whole = repeat_timetables([part(0, 500)])
    ends_s = float(whole.forward.arrival_s[-1, -1])
    to_hour_s = 2 * HOUR_S - 10.0 - ends_s
    forward = whole.forward._replace(departure_s=whole.forward.departure_s + to_hour_s)
    timetable = DayTimetable(forward, Journeys(*(each[:0] for each in whole.backward)))
    line = LineDay(operation(), timetable, [late])
    assert line.timetable.span_s[1] == pytest.approx(2 * HOUR_S - 10.0)
    balance = line.energy()
    assert line.power().supplied_w.shape[0] == 2 * 60, "minutes of two hours"
    assert balance.supplied_j + balance.received_j == pytest.approx(balance.drawn_j, rel=1e-9)


def test_a_day_is_found_above_its_floor_and_below_plain_driving():
    found = day_energy(operation(), working_day())
    told = found.as_dict()
    assert told["floor_kwh"] < told["energy_kwh"] < told["driving_only_kwh"] < told["cruise_kwh"]
    assert told["energy_kwh"] < told["timetable_only_kwh"] < told["cruise_kwh"]
    assert sum(each["energy_kwh"] for each in told["hours"]) == pytest.approx(told["energy_kwh"], rel=1e-9)
    assert sum(told["zones_kwh"]) == pytest.approx(told["energy_kwh"], rel=1e-9)
    assert told["hours"][0]["from"] == "05:00:00"
    assert told["driver"] is None
    assert told["journeys"]["forward"] == found.links.train[0].size
    dwell_s = found.day.timetable.forward.departure_s[:, 1] - found.day.timetable.forward.arrival_s[:, 0]
    assert set(zip(found.day.timetable.forward.period.tolist(), dwell_s.tolist(), strict=True)) == {
        (0, 30.0),
        (1, 40.0),
        (2, 30.0),
    }
    # the same timetable, given
    plain = lay_out_day(operation(), working_day(), plan_trips(operation())["cruise"])
    given = timetable_energy(operation(), plain, "given")
    assert given.cruise_kwh == pytest.approx(found.timetable_only_kwh, rel=1e-9)
    assert given.floor_kwh == pytest.approx(found.floor_kwh, rel=1e-4)


def test_a_searched_day_stays_within_its_windows_and_above_a_lower_floor():
    line = LineOperation(short_line(3), TRAINSET, OperationOptions(zones=2, time_window_s=1))
    plain, searched = (day_energy(line, working_day(), searched=each, moves=500) for each in (False, True))
    assert searched.floor_kwh < plain.floor_kwh
    assert searched.floor_kwh < searched.energy_kwh < plain.energy_kwh
    for way, each in enumerate(searched.day.timetable):
        planned_s = line.planned_s[line.count * way :][: line.count]
        assert np.abs(each.running_time_s - planned_s).max() <= 1
        assert (each.running_time_s.sum(axis=1) == planned_s.sum()).all()


@pytest.mark.parametrize(("running_s", "least"), [(40, "allowed: >= "), (90000, "allowed: ")])
def test_a_running_time_that_cannot_be_driven_names_its_train(running_s, least):
    whole = repeat_timetables([part(6 * HOUR_S, 7 * HOUR_S)])
    running = whole.forward.running_time_s.copy()
    running[2, 1] = running_s
    given = whole._replace(forward=whole.forward._replace(running_time_s=running))
    where = f"mine: train of 06:04:00, forward, {operation().trips[1].section.name}: "
    with pytest.raises(InputError, match=rf"{where}.*minimum running time.*: {running_s}\.0 s \({least}"):
        timetable_energy(operation(), given, "mine")


def test_a_headway_too_short_names_its_period():
    busy = Period(name="rush", from_s=0, to_s=3600, headway_s=60)
    day = replace(working_day(), periods=(busy,))
    with pytest.raises(
        InputError, match=r"headway of rush: trains disturb one another at .*: 60 s \(allowed: at least"
    ):
        day_energy(operation(), day)


def test_a_fleet_too_small_is_named():
    plans = plan_trips(operation())
    needed = day_energy(operation(), working_day(), plans=plans).links.fleet
    assert day_energy(operation(), working_day(fleet=needed), plans=plans).links.fleet == needed
    with pytest.raises(Infeasible, match=rf"trains.fleet: .*: {needed - 1} \(allowed: >= {needed}\)"):
        day_energy(operation(), working_day(fleet=needed - 1), plans=plans)


def test_a_driver_drives_the_trips_of_a_day():
    line = LineOperation(short_line(2), TRAINSET, OperationOptions(zones=1))
    drives = TripDrives(line, "manual", (0, 1))
    found = day_energy(line, working_day(), scatter=ServiceScatter(drives))
    assert found.driven is not None
    assert abs(found.driven.mean_late_s) < 5.0
    assert 0.0 < found.driven.scatter_s < 5.0
    assert found.energy_kwh < found.driven.energy_kwh < 1.3 * found.cruise_kwh
    with pytest.raises(
        Infeasible, match="driver: flat_out does not arrive, SJZ-XC in 5 s, seed 3: 'out_of_time'"
    ):
        TripDrives(line, "flat_out", (3,)).profiles([(5,)] * 2)
