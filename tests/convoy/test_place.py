"""Place of a follower in the planned motion of a convoy."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.convoy import Convoy, ConvoyRequest, Link, convoy_kpis, drive_convoy
from metropilot.convoy.manoeuvre import plan_followers
from metropilot.convoy.model import convoy_members
from metropilot.convoy.needed import NeededGap, growing_m
from metropilot.convoy.place import delay_motion, make_drivable
from metropilot.convoy.plan import MotionPlan, PlannedMotion, plan_at, plan_times, splice
from metropilot.evaluate import RunSpec
from metropilot.railway import load_line, load_trainset

DT = 0.1
SECTION = load_line("yizhuang").section("TJN", "JHL")


def motion(*pieces: tuple[float, float]) -> MotionPlan:
    """A motion of pieces of constant acceleration within a jerk limit, from standstill."""
    rates = np.concatenate([np.full(round(seconds / DT), rate) for rate, seconds in pieces])
    rates = np.convolve(np.pad(rates, (9, 9)), np.ones(10) / 10.0, "valid")
    speed = np.maximum(np.concatenate([[0.0], np.cumsum(rates * DT)]), 0.0)
    way = np.concatenate([[0.0], np.cumsum(0.5 * DT * (speed[1:] + speed[:-1]))])
    return MotionPlan(np.float64(0.0), np.float64(DT), way, speed)


@pytest.fixture(scope="module")
def convoy() -> Convoy:
    return Convoy(SECTION, (load_trainset("dkz32"),) * 8, dt=DT, link=Link(0.1))


def test_nobody_brakes_before_it_accelerates(convoy: Convoy):
    """Followers opened a gap before they needed it: the last of eight fell from 15 to 9 m/s."""
    head = motion((0.8, 15.0), (0.0, 50.0), (0.8, 4.0), (-0.05, 60.0), (-0.65, 20.0))
    plans = plan_followers(convoy_members(convoy), head, convoy.gap_m)
    for k, plan in enumerate(plans):
        moving = plan.speed_mps[200 : int(np.argmax(plan.speed_mps))]
        assert np.maximum.accumulate(moving)[-1] > 14.0
        # Each gives up more than the trainset ahead, for the delay of an acceleration (1.2 m/s before).
        assert (np.maximum.accumulate(moving) - moving).max() < 0.1 + 0.6 * k
    stands = [plan_times(plan)[np.flatnonzero(plan.speed_mps > 0.05)[-1]] for plan in plans]
    assert 0.0 < stands[-1] - stands[0] < 3.0


def test_protection_passes_what_is_planned(convoy: Convoy):
    members = convoy_members(convoy)
    head = motion((0.8, 15.0), (0.0, 40.0), (-0.05, 60.0), (-0.65, 14.0))
    plans = plan_followers(members, head, convoy.gap_m)
    for ahead, own, member in zip(plans, plans[1:], members[1:], strict=False):
        assert member.protection is not None
        length_m = float(member.length_m)
        need = NeededGap(member.protection, ahead, member, length_m, own)
        rows = range(0, ahead.position_m.size, 5)
        lacks = [needed - gap for needed, gap, _ in (need.gaps_m(k, float(k * DT)) for k in rows)]
        # There is a margin of 0.4 m.
        assert np.quantile(lacks, 0.97) < 0.4


def test_a_delay_that_grows_is_a_lower_speed():
    base = motion((0.5, 20.0), (0.0, 30.0))
    constant = delay_motion(base, np.full(base.position_m.size, 2.0))
    assert constant.position_m[120] == pytest.approx(base.position_m[100])
    assert constant.speed_mps[120] == pytest.approx(base.speed_mps[100])
    growing = delay_motion(base, 0.1 * plan_times(base))
    assert growing.speed_mps[400] == pytest.approx(10.0 / 1.1)
    assert np.diff(growing.position_m[300:400]) == pytest.approx(DT * 10.0 / 1.1)


def test_a_new_plan_goes_on_from_the_old_one_without_a_step():
    """A step of 0.4 m between two plans of the head was a kink of 4 m/s in its followers' plans."""
    before = motion((0.5, 20.0), (0.0, 30.0))
    plan = MotionPlan(
        np.float64(10.0), np.float64(DT), before.position_m[100:] + 0.4, before.speed_mps[100:] + 0.1
    )
    joined = splice(before, plan)
    assert joined.start_s == 0.0
    assert plan_at(joined, 20.0) == plan_at(plan, 20.0)
    assert abs(np.diff(joined.position_m, 2)).max() < 0.02
    assert abs(np.diff(joined.speed_mps, 2)).max() < 0.1


def test_the_needed_gap_grows_while_the_trainset_ahead_brakes(convoy: Convoy):
    late = load_trainset("dkz32")
    late = replace(late, actuation=replace(late.actuation, delay_s=0.5))
    member = convoy_members(replace(convoy, trainsets=(late,) * 2))[1]
    speed, coasts = np.float64(15.0), np.float64(0.0)
    assert growing_m(member, speed, coasts, coasts, coasts) == 0.0
    assert growing_m(member, speed, coasts, coasts, np.float64(0.5)) == 0.0
    held = float(member.bounds.held_mps2)
    assert growing_m(member, speed, coasts, coasts, np.float64(-0.5)) == pytest.approx(
        0.5 * 15.0 * 0.5 / held, rel=1e-6
    )


def test_the_head_leaves_brake_and_acceleration_to_the_weakest():
    weak = replace(load_trainset("cheng2023"), max_deceleration_mps2=0.5, max_acceleration_mps2=0.6)
    head = Convoy(SECTION, (load_trainset("dkz32"), weak), dt=DT).leader()[1]
    assert head.max_deceleration_mps2 == pytest.approx(0.85 * 0.5)
    assert head.max_acceleration_mps2 == pytest.approx(0.95 * 0.6)


def test_the_head_arrives_earlier_where_the_last_would_be_late():
    head = RunSpec("yizhuang", "RJ", "RC", time_s=120.0, trainset="dkz32", dt_s=DT)
    request = ConvoyRequest(head, count=8, link=Link(0.3, 0.0, 0.1))
    convoy = request.convoy()
    drive = drive_convoy(convoy, request.driven_head(convoy), request.make_follower())
    kpis = convoy_kpis(drive, 120.0)
    errors_s = [member.time_error_s for member in kpis.trainsets]
    assert kpis.success
    assert errors_s == sorted(errors_s)
    assert -3.0 < errors_s[0] < -2.2
    assert errors_s[-1] > 2.0


def test_waiting_for_a_trainset_that_stops_brings_no_gap():
    """A delay was sought for a place that cannot be passed at that speed: 8 s more for each of eight."""
    slow = load_trainset("dkz32")
    slow = replace(slow, actuation=replace(slow.actuation, delay_s=0.6, lag_s=0.4))
    line = Convoy(SECTION, (slow,) * 8, dt=DT, link=Link(0.3, 0.0, 0.1))
    head = motion((0.8, 15.0), (0.0, 40.0), (-0.05, 60.0), (-0.65, 14.0))
    plans = plan_followers(convoy_members(line), head, line.gap_m)
    stands = [plan_times(plan)[np.flatnonzero(plan.speed_mps > 0.05)[-1]] for plan in plans]
    assert max(np.diff(stands)) < 3.0


def test_a_lag_shapes_a_planned_motion_without_larger_commands():
    slow = load_trainset("dkz32")
    slow = replace(slow, actuation=replace(slow.actuation, lag_s=0.4))
    member = convoy_members(Convoy(SECTION, (slow,) * 2, dt=DT))[1]
    wanted = motion((0.7, 15.0), (0.0, 30.0), (-0.6, 17.5))
    own = make_drivable(member, wanted, 0, PlannedMotion(0.0, 0.0, 0.0))
    rates = np.diff(own.speed_mps) / DT
    kept = np.exp(-DT / 0.4)
    # What has to be commanded for it, all of the lag compensated.
    commanded = (rates[1:] - kept * rates[:-1]) / (1.0 - kept)
    assert commanded[: round(30.0 / DT)].max() < 1.0
    assert abs(np.diff(rates[: round(55.0 / DT)])).max() / DT <= 1.0
