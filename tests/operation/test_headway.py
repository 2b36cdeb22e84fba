"""Headways of a timetable: what binds, what the search may do, and that it keeps to it."""

from dataclasses import replace
from functools import cache
from math import ceil, inf

import numpy as np
import pytest
from tests.operation.lines import TRAINSET, short_line

from metropilot.convoy import needed_m, trainset_behind
from metropilot.errors import InputError
from metropilot.operation import (
    LineOperation,
    LongestDwells,
    OperationOptions,
    PeriodicPart,
    check_day,
    check_headway,
    find_timetable,
    lay_out_day,
    line_headways,
    operation_energy,
    repeat_timetables,
    timetable_energy,
)
from metropilot.railway import Period, ServiceDay, load_trainset


def operation(**given):
    options = {"zones": 3, "time_window_s": 0} | given
    return LineOperation(short_line(4), TRAINSET, OperationOptions(**options))


@cache
def plans():
    line = operation()
    return [line.profiles(), line.profiles(received_w=TRAINSET.auxiliary_w)]


def headways(line, timetable=None, profiles=None):
    return line_headways(line, timetable or line.plain_timetable(), profiles or plans()[0])


@pytest.mark.parametrize("blocks", [None, 1, 3])
def test_a_second_of_dwell_is_a_second_of_headway_and_so_is_one_of_the_message(blocks):
    now = headways(operation(blocks=blocks))
    late = headways(operation(blocks=blocks, age_s=5.4))
    long = headways(operation(blocks=blocks, dwell_s=40))
    for a, b, c in zip(now, late, long, strict=True):
        assert b.headway_s - a.headway_s == pytest.approx(3.0, abs=1e-6)
        assert c.headway_s - a.headway_s == pytest.approx(10.0, abs=0.3)


def motion(line, first, profiles):
    """Times, places and the farthest place asked for of a journey, every tenth of a second."""
    timetable, parts, from_m = line.plain_timetable(), [], 0.0
    for k in range(first, first + line.count):
        (driven,) = profiles[k].values()
        own = trainset_behind(line.trips[k].section, line.trainset)
        time_s, lasts_s = np.append(np.arange(0.0, driven.time_s[-1], 0.1), driven.time_s[-1]), driven.time_s
        j = np.minimum(np.searchsorted(lasts_s, time_s, side="right") - 1, lasts_s.size - 2)
        rate = (np.diff(driven.speed_mps) / np.diff(lasts_s))[j]
        since = time_s - lasts_s[j]
        speed = np.maximum(driven.speed_mps[j] + rate * since, 0.0)
        place = driven.position_m[j] + since * (driven.speed_mps[j] + 0.5 * rate * since)
        need = [
            needed_m(own, *each) for each in zip(place.tolist(), speed.tolist(), rate.tolist(), strict=True)
        ]
        departs_s = timetable.departure_s[k] - timetable.departure_s[first]
        parts.append((departs_s + time_s, from_m + place, from_m + place + np.array(need)))
        from_m += float(driven.position_m[-1])
    return (np.concatenate(each) for each in zip(*parts, strict=True))


@pytest.mark.parametrize(
    ("trainset", "age_s", "reserve"),
    [("ch_stadler_flirt_tpf", 0.0, 0.3), ("cn_beijing_subway", 2.4, 0.02), ("drawn-18-7", 10.0, 0.02)],
)
def test_at_the_least_headway_nothing_is_asked_for_that_is_not_free(trainset, age_s, reserve):
    short = replace(short_line(4), planned_forward_s=(), planned_backward_s=())
    given = OperationOptions(zones=1, age_s=age_s, dwell_s=20, dwell_window_s=0, reserve=reserve)
    line = LineOperation(short, load_trainset(trainset), given)
    profiles = line.profiles("cruise")
    for first, found in zip((0, line.count), headways(line, profiles=profiles), strict=True):
        time_s, place_m, asked_m = motion(line, first, profiles)
        lacks_m = []
        for headway_s in (found.headway_s, found.headway_s - 1.0):
            known_s = time_s + headway_s - age_s
            rear_m = np.interp(known_s, time_s, place_m) - line.trainset.length_m
            lacks_m.append(float((asked_m - rear_m)[known_s < time_s[-1]].max()))
        assert lacks_m[0] < 0.3, "metres"
        assert lacks_m[1] > 0.1


def test_blocks_are_farther_apart():
    moving, three, one = (max(each.headway_s for each in headways(operation(blocks=n))) for n in (None, 3, 1))
    assert 60.0 < moving < three - 10.0 < one - 50.0


@pytest.mark.parametrize("blocks", [None, 2])
def test_the_longest_dwells_are_those_of_the_blocking_times(blocks):
    line = operation(blocks=blocks, headway_s=130)
    longest, timetable = LongestDwells(line, plans()[:1]), line.plain_timetable()
    for first, found in zip((0, line.count), headways(line), strict=True):
        of = {each.name: each.headway_s for each in found.places if each.kind == "station"}
        for k in range(first, first + line.count - 1):
            spare = 130.0 - of[line.trips[k].section.destination.name]
            most = longest(k, int(timetable.running_time_s[k]), 0)
            # one samples the whole journey, the other the trip alone
            assert most - line.options.dwell_s == pytest.approx(spare, abs=0.6)


def test_who_has_left_before_the_next_sets_out_may_stay():
    longest = LongestDwells(operation(headway_s=600), plans())
    assert {longest(k, int(operation().planned_s[k]), 0) for k in range(6)} == {inf}


def test_a_headway_below_the_technical_one_names_the_place_and_what_is_allowed():
    least = max(headways(operation()), key=lambda each: each.headway_s)
    for headway_s in (ceil(least.headway_s), ceil(least.headway_s) + 20):
        line = operation(headway_s=headway_s)
        check_headway(line, line.plain_timetable(), plans()[0])
    line = operation(headway_s=int(least.headway_s))
    with pytest.raises(InputError, match=f"{least.bottleneck.name}.*at least {ceil(least.headway_s)} s"):
        check_headway(line, line.plain_timetable(), plans()[0])
    with pytest.raises(InputError, match="headway_s"):
        operation_energy(operation(headway_s=40))


def test_the_driving_that_needs_the_longest_headway_binds():
    line, drivings = operation(headway_s=40), (plans()[0], operation().profiles("cruise"))
    least = [
        max(each.headway_s for each in line_headways(line, line.plain_timetable(), of)) for of in drivings
    ]
    assert ceil(least[0]) != ceil(least[1])
    period = Period(name="all", from_s=0, to_s=3600, headway_s=40)
    day = ServiceDay(id="short", name="short day", line_id="yizhuang", periods=(period,))
    for both in (drivings, drivings[::-1]):
        with pytest.raises(InputError, match=f"at least {ceil(max(least))} s"):
            check_headway(line, line.plain_timetable(), *both)
    with pytest.raises(InputError, match=f"at least {ceil(max(least))} s"):
        operation_energy(line)
    with pytest.raises(InputError, match=f"at least {ceil(max(least))} s"):
        lay_out_day(line, day, plans(), others=[drivings[1]])


def test_the_search_keeps_the_headway():
    least_s = max(each.headway_s for each in headways(operation()))
    line = operation(headway_s=ceil(least_s) + 2)
    found, profiles = find_timetable(line, plans(), moves=1500, restarts=2)
    assert max(each.headway_s for each in headways(line, found, profiles)) <= line.options.headway_s


def test_dwells_that_are_allowed_disturb_nobody_and_others_do():
    least_s = max(each.headway_s for each in headways(operation()))
    line, random = operation(headway_s=ceil(least_s) + 1), np.random.default_rng(3)
    longest, allowed = LongestDwells(line, plans()[:1]), []
    for _ in range(8):
        timetable = line.plain_timetable()
        change = random.integers(-4, 5, 2)
        timetable.departure_s[1:3] += change[0]
        timetable.departure_s[2] += change[1]
        dwell = line.dwells_s(timetable)
        allowed.append(all(dwell[k] <= longest(k, int(line.planned_s[k]), 0) for k in range(6)))
        needed_s = headways(line, timetable)[0].headway_s
        assert needed_s <= line.options.headway_s if allowed[-1] else needed_s > line.options.headway_s - 0.6
    assert set(allowed) == {True, False}


def day_of(line, headway_s, timetable=None):
    plan = np.zeros(len(line.trips), dtype=int)
    part = PeriodicPart(0, 5 * headway_s, headway_s, timetable or line.plain_timetable(), plan)
    return repeat_timetables([part])


@pytest.mark.parametrize("blocks", [None, 2])
def test_a_day_keeps_the_headway_between_any_two_trains(blocks):
    line = operation(blocks=blocks)
    least_s = max(each.headway_s for each in headways(line))
    near = day_of(line, ceil(least_s))
    check_day(line, near, plans())
    early = day_of(line, ceil(least_s) - 1)
    for refused in (
        lambda: check_day(line, early, plans()),
        lambda: timetable_energy(line, early, "early"),
    ):
        with pytest.raises(InputError, match=rf"timetable: .*allowed: at least {ceil(least_s)} s later"):
            refused()
    # the third train stays longer at the first stop: the fourth comes too near
    late_s = near.forward.departure_s.copy()
    late_s[2, 1:] += 40.0
    held = near._replace(forward=near.forward._replace(departure_s=late_s))
    ways = {each: f"{int(near.forward.departure_s[each, 0]) // 60:02d}:" for each in (2, 3)}
    with pytest.raises(InputError, match=rf"forward, those of 00:{ways[2]}.* and 00:{ways[3]}") as told:
        check_day(line, held, plans())
    least = max(headways(line), key=lambda each: each.headway_s)
    assert f"at station {least.bottleneck.name}" in str(told.value)
    # with as much more distance it does not
    late_s[3:] += 41.0
    check_day(line, near._replace(forward=near.forward._replace(departure_s=late_s)), plans())
