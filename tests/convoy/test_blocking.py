"""Blocking times: closed forms at constant speed and one block; trains disturb each other or not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from metropilot.convoy import (
    Convoy,
    ServiceOptions,
    ServiceRun,
    blocking_times,
    line_capacity,
    needed_gap_m,
    needed_m,
    reach_m,
    trainset_behind,
)
from metropilot.convoy.blocking import command_of
from metropilot.errors import InputError
from metropilot.physics import Command
from metropilot.protection import TrainAhead, at_start, supervise
from metropilot.railway import Steps, load_line, load_trainset

TRAINSET = load_trainset("dkz32", "AW2")
LENGTH_M, AGE_S, SPEED_MPS = 118.0, 2.4, 15.0


def sections():
    line = load_line("yizhuang")
    return line.section("WYJ", "RJ"), line.section("RJ", "RC"), line.section("RC", "TJN")


def level():
    flat = Steps(np.array([0.0]), np.array([0.0]))
    section = replace(sections()[2], gradient_permil=flat, curves=(), tunnels=())
    return replace(section, limit_mps=Steps(np.array([0.0]), np.array([40.0])))


@cache
def cruise():
    """A train at constant speed over a level section, and a trainset behind it."""
    time_s = np.arange(0.0, 120.0, 0.5)
    same = np.full(time_s.size, SPEED_MPS)
    run = ServiceRun(
        time_s, SPEED_MPS * time_s, same, 0.0 * same, np.zeros(time_s.size, int), np.array([0.0])
    )
    return run, [trainset_behind(level(), TRAINSET)], Convoy(section=level(), trainsets=(TRAINSET,) * 2)


def test_at_constant_speed_a_moving_block_is_length_and_gap_over_speed_and_the_age_of_the_message():
    run, members, convoy = cruise()
    need_m = needed_m(members[0], 700.0, SPEED_MPS, 0.0)
    # under power a train needs a little more than coasting
    assert 0.0 < need_m - needed_gap_m(convoy, "moving_block", SPEED_MPS) < 4.0
    for age_s in (0.0, 0.36, AGE_S):
        found = blocking_times(run, reach_m(run, members), [level()], LENGTH_M, age_s)
        assert found.headway_s == pytest.approx((LENGTH_M + need_m) / SPEED_MPS + age_s, abs=0.02)


@pytest.mark.parametrize("block_m", [100.0, 150.0, 300.0])
def test_at_constant_speed_a_fixed_block_adds_its_own_length(block_m):
    run, members, _ = cruise()
    need_m = needed_m(members[0], 700.0, SPEED_MPS, 0.0)
    whole = replace(level(), length_m=float(run.position_m[-1]))
    found = blocking_times(run, reach_m(run, members), [whole], LENGTH_M, AGE_S, [block_m])
    own_m = np.ptp(run.position_m) / np.ceil(np.ptp(run.position_m) / block_m)
    assert found.headway_s == pytest.approx((LENGTH_M + own_m + need_m) / SPEED_MPS + AGE_S, abs=0.02)


@cache
def rows():
    options = ServiceOptions(age_s=AGE_S, blocks=1)
    return {row.guard: row for row in line_capacity(sections(), TRAINSET, (1,), options=options)}


def test_one_block_in_each_section_is_run_dwell_clearing_and_message():
    found = rows()["fixed_block"].blocking
    stop_m = found.run.from_m[1]
    clears = found.run.time_s[np.searchsorted(found.run.position_m, stop_m + LENGTH_M)]
    assert [each.kind for each in found.places] == ["station", "station", "section"]
    # it is asked for at the departure and given back when the rear has left the platform
    assert found.places[0].headway_s == pytest.approx(clears + AGE_S, abs=0.5)
    assert found.places[0].from_m == 0.0
    assert found.places[0].to_m == pytest.approx(stop_m)


def test_the_shorter_the_blocks_the_nearer_to_a_moving_one():
    moving = rows()["moving_block"].headway_s
    found = [rows()["fixed_block"].headway_s]
    for given in ({"blocks": 2}, {"block_m": 200.0}, {"block_m": 20.0}):
        *_, row = line_capacity(sections(), TRAINSET, (1,), ("moving_block",), ServiceOptions(**given))
        found.append(row.headway_s)
    assert found == sorted(found, reverse=True)
    assert moving < found[-1] < moving + 3.0
    assert found[0] > 2.0 * moving


def test_the_age_of_the_message_is_a_longer_headway():
    fresh = line_capacity(sections(), TRAINSET, (1,), options=ServiceOptions(age_s=0.0))
    for row in fresh:
        late = rows()[row.guard]
        assert late.headway_s - row.headway_s == pytest.approx(AGE_S, abs=0.15)
    assert late.headway_s < rows()["moving_block"].headway_s


def count_interventions(found, members, headway_s):
    """Moments at which the second of two trains is overruled on account of the first."""
    run, times = found.run, found.run.time_s
    then = times + headway_s - AGE_S
    rear_m = np.where(then <= times[-1], np.interp(then, times, run.position_m) - LENGTH_M, np.inf)
    speed_mps = np.interp(then, times, run.speed_mps)
    count = 0
    for k in range(1, times.size):
        at, x, v, a = run.state(k)
        own = members[at]
        if not np.isfinite(rear_m[k]) or v <= 0.0:
            continue
        share = command_of(own, x, v, a)
        seen = TrainAhead(
            np.float64(rear_m[k] - run.from_m[at]),
            np.float64(speed_mps[k]),
            np.float64(0.0),
            np.float64(AGE_S),
            own.bounds,
        )
        memory = at_start(own.protection, share=share, acceleration_mps2=a)
        state = np.float64(x), np.float64(v), Command(np.float64(share), np.bool_(0))
        alone = supervise(own.protection, memory, *state)[2].level
        behind = supervise(own.protection, memory, *state, seen)[2].level
        count += int(behind > alone)
    return count


def test_two_trains_at_the_least_headway_do_not_disturb_each_other_and_a_second_less_they_do():
    row = rows()["moving_block"]
    members = [trainset_behind(each, TRAINSET) for each in sections()]
    assert count_interventions(row.blocking, members, row.headway_s + 0.1) == 0
    assert count_interventions(row.blocking, members, row.headway_s - 1.0) > 0


def test_a_faster_train_needs_more_room():
    _, members, _ = cruise()
    need = [needed_m(members[0], 800.0, speed, 0.0) for speed in (0.0, 5.0, 10.0, 20.0)]
    assert need == sorted(need)
    assert need[3] - need[2] > 20.0**2 / 2.0 / 1.3 - 10.0**2 / 2.0 / 0.8


def test_blocks_are_a_number_or_a_length():
    with pytest.raises(InputError, match="block_m"):
        ServiceOptions(blocks=2, block_m=100.0)
    with pytest.raises(InputError, match="blocks"):
        ServiceOptions(blocks=0)
