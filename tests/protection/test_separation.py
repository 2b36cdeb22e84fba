"""Relative-distance protection: closed forms against small steps, and each guard removed in turn."""

import numpy as np
import pytest

from metropilot.convoy import Convoy, convoy_members
from metropilot.errors import InputError
from metropilot.physics import Command
from metropilot.protection import PairBounds, TrainAhead, at_start, separate, spare_gap, supervise
from metropilot.protection.separation import brake_motion, distance_at, leader_motion, least_gap
from metropilot.railway import load_line, load_trainset

H = 1e-3


def walked(speed, steady, reaction, jerk, rate, seconds):
    """The same motion by small steps."""
    found, x, stopped = [], 0.0, False
    for k in range(int(seconds / H)):
        t = (k + 0.5) * H
        a = steady if t < reaction else max(steady - jerk * (t - reaction), -rate)
        after = 0.0 if stopped else max(speed + a * H, 0.0)
        x += 0.5 * (speed + after) * H
        speed, stopped = after, stopped or after <= 0
        found.append(x)
    return np.array(found)


@pytest.mark.parametrize(
    ("speed", "steady", "reaction", "jerk", "rate"),
    [(20, 0.9, 0.6, 1.5, 1.1), (0.3, -0.4, 0.6, 0.7, 0.9), (8, -0.9, 0.2, 1e4, 0.9), (1, 0.2, 0.0, 0.3, 0.8)],
)
def test_braking_is_the_motion_it_says(speed, steady, reaction, jerk, rate):
    motion = brake_motion(*map(np.float64, (speed, steady, reaction, jerk, rate)))
    t = H * np.arange(1, 25_001)
    assert np.abs(distance_at(motion, t) - walked(speed, steady, reaction, jerk, rate, 25.0)).max() < 0.02


def test_least_gap_is_never_more_than_the_smallest_on_the_way():
    random = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.004)
    for _ in range(150):
        pair = PairBounds(random.uniform(0.5, 1.3), random.choice([0.7, 1.5, np.inf]))
        bounds = separate(pair, 0.2, random.uniform(0.5, 1.3))
        state = (
            random.uniform(0, 60),
            random.uniform(0, 22),
            random.uniform(-1, 1),
            random.choice([0, 0.2, 2]),
        )
        ahead = TrainAhead(*map(np.float64, state), bounds)
        own = map(np.float64, (random.uniform(0, 22), random.uniform(-1.2, 1.2), 0.6, 1.5, bounds.held_mps2))
        motion = brake_motion(*own)
        gaps = ahead.rear_m + distance_at(leader_motion(ahead), t + ahead.age_s) - distance_at(motion, t)
        found = least_gap(ahead, np.float64(0.0), motion)
        assert gaps.min() - 0.1 < found <= gaps.min() + 1e-6


def two(guard="coupled"):
    section, trainset = load_line("yizhuang").section("YZQ", "WHY"), load_trainset("cheng2023")
    return convoy_members(Convoy(section, (trainset, trainset), guard=guard))[1]


def told(member, gap, speed, age=0.0):
    numbers = (400.0 + gap, speed, 0.0, age)
    return TrainAhead(*map(np.float64, numbers), member.bounds)


@pytest.mark.parametrize("speed", [5.0, 12.0, 20.0])
def test_a_moving_block_needs_the_braking_distance_and_coupling_hardly_anything(speed):
    needed = {}
    for guard in ("moving_block", "independent", "coupled"):
        member = two(guard)
        ahead = told(member, 1e3, speed)
        spare = spare_gap(
            member.protection,
            at_start(member.protection),
            np.float64(400.0),
            np.float64(speed),
            np.float64(0.0),
            ahead,
        )
        needed[guard] = 1e3 - spare
    assert needed["moving_block"] > 0.95 * speed**2 / 2 / 1.2
    assert needed["coupled"] < needed["independent"] < needed["moving_block"]
    assert needed["coupled"] < 5.92


def test_a_trainset_ahead_that_is_no_number_brings_the_emergency_brake():
    member = two()
    ahead = told(member, float("nan"), 10.0)
    command, _, verdict = supervise(
        member.protection,
        at_start(member.protection),
        np.float64(400.0),
        np.float64(10.0),
        Command(np.float64(0.0), False),
        ahead,
    )
    assert command.emergency
    assert verdict.level == 3


@pytest.mark.parametrize(
    "wrong", [{"leader_mps2": 0.0}, {"margin_m": -1.0}, {"leader_jerk_mps3": float("nan")}]
)
def test_impossible_bounds_are_refused(wrong):
    with pytest.raises(InputError, match="out of range"):
        PairBounds(**wrong)


def test_a_brake_that_does_not_hold_is_refused():
    with pytest.raises(InputError, match="does not hold"):
        separate(PairBounds(), 0.2, 0.01)


def test_nobody_ahead_stops_shorter_than_assumed():
    """A trainset that lowers its acceleration by the declared jerk every period, holding it in between."""
    for a, jerk, rate, period in ((0.6, 1.5, 1.0, 0.2), (-0.4, 0.7, 0.8, 0.5), (0.9, 1e4, 1.1, 0.2)):
        bounds = separate(PairBounds(rate, jerk), period, 1.0)
        ahead = TrainAhead(*map(np.float64, (0.0, 15.0, a, 0.0)), bounds)
        x, v, walked_m = 0.0, 15.0, []
        for k in range(int(25.0 / H)):
            held = max(a - jerk * period * (1 + int(k * H / period + 1e-9)), -rate)
            after = max(v + held * H, 0.0)
            x, v = x + 0.5 * (v + after) * H, after
            walked_m.append(x)
        t = H * np.arange(1, len(walked_m) + 1)
        assert (distance_at(leader_motion(ahead), t) <= np.array(walked_m) + 1e-3).all()


def test_what_the_brake_may_miss_is_taken_off():
    assert separate(PairBounds(scatter_mps2=0.05), 0.2, 1.0).held_mps2 == pytest.approx(0.95)


def test_the_trainset_ahead_may_be_slower_than_it_measured():
    bounds = separate(PairBounds(1.0, 1.5, speed_error_mps=0.3), 0.2, 1.0)
    fast, slow = (TrainAhead(*map(np.float64, (0.0, v, 0.0, 0.0)), bounds) for v in (15.0, 0.2))
    assert leader_motion(fast).speed_mps == pytest.approx(14.7)
    assert leader_motion(slow).speed_mps == 0.0
    assert np.isnan(leader_motion(fast._replace(speed_mps=np.float64("nan"))).speed_mps)


def test_the_margin_is_never_used_up():
    member = two()

    def nearest_without_emergency(margin_m):
        bounds = member.bounds._replace(margin_m=np.float64(margin_m))
        low, high = 0.0, 100.0
        for _ in range(30):
            gap = 0.5 * (low + high)
            _, _, verdict = supervise(
                member.protection,
                at_start(member.protection),
                np.float64(400.0),
                np.float64(12.0),
                Command(np.float64(-1.0), False),
                told(member, gap, 12.0)._replace(bounds=bounds),
            )
            low, high = (gap, high) if verdict.level == 3 else (low, gap)
        return high

    assert nearest_without_emergency(2.1) - nearest_without_emergency(0.1) == pytest.approx(2.0, abs=0.01)


def test_between_two_moments_the_gap_may_dip():
    """With slow build-ups the moments are far apart; what is found is still below the smallest gap."""
    t = np.arange(0.0, 40.0, 0.002)
    for closing in np.linspace(0.1, 2.0, 39):
        bounds = separate(PairBounds(0.5, 0.05), 0.2, 1.2)
        ahead = TrainAhead(*map(np.float64, (20.0, 12.0 - closing, 0.0, 0.0)), bounds)
        motion = brake_motion(*map(np.float64, (12.0, -0.3, 0.3, 0.2, 1.2)))
        gaps = ahead.rear_m + distance_at(leader_motion(ahead), t) - distance_at(motion, t)
        assert least_gap(ahead, np.float64(0.0), motion) <= gaps.min() + 1e-9
