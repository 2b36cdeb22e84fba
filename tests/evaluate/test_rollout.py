"""The host loop: outcomes, news, noise, and protection's last word."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from metropilot.errors import InputError
from metropilot.evaluate import checks, kpis_of
from metropilot.physics import at_rest, track_arrays, vehicle_arrays
from metropilot.railway import Line, Restriction, Station, Steps, load_trainset
from metropilot.sim import (
    AbstractDriver,
    Disturbance,
    Outcome,
    Rollout,
    Run,
    TimetableUpdate,
    drive,
    overspeed_in_period,
    train_limit_at,
)


def test_flat_out_arrives(request_rj):
    driven = drive(request_rj.run(), request_rj.make_driver())
    assert driven.outcome is Outcome.ARRIVED
    assert abs(driven.trajectory.position_m[-1] - driven.section.length_m) <= 0.3
    assert driven.running_time_s == driven.trajectory.time_s[-1]
    assert driven.decision_us.size == driven.overruled.size == len(driven.trajectory) - 1


def test_who_never_departs_stalls(request_rj, scripted):
    driven = drive(request_rj.run(), scripted(lambda _: 0.0))
    assert driven.outcome is Outcome.STALLED
    assert driven.trajectory.position_m[-1] == 0.0
    assert 20 < driven.trajectory.time_s[-1] < 21


def test_who_never_departs_is_not_early(request_rj, scripted):
    on_time = checks(kpis_of(drive(request_rj.run(), scripted(lambda _: 0.0)), None))[1]
    assert (on_time.name, on_time.value, on_time.passed) == ("on time", "stalled", False)


@pytest.mark.parametrize(
    ("given", "told"),
    [(None, "None"), ("a", "'a'"), (10**400, "too large an integer"), (np.complex128(1j), "1j")],
    ids=["none", "text", "integer", "complex"],
)
def test_a_command_that_is_no_number_names_the_driver(request_rj, given, told):
    class Wordy(AbstractDriver):
        id = "wordy"

        def init(self, run):
            return None

        def act(self, memory, observation):
            return given, None

    with pytest.raises(InputError, match=rf"driver: a command that is no number: .wordy: {told}") as found:
        drive(request_rj.run(), Wordy())
    assert found.value.allowed == "a number from -1 to 1"


def test_who_never_brakes_overshoots_and_is_kept_under_the_limit(request_rj, scripted):
    driven = drive(request_rj.run(), scripted(lambda _: 1.0))
    assert driven.outcome is Outcome.OVERSHOT
    assert driven.max_overspeed_mps == 0.0
    assert driven.interventions > 0
    assert driven.overruled.any()


@pytest.mark.parametrize(("share", "kept"), [(0.3, True), (1.0, False)])
def test_a_gradient_jerks_only_a_trainset_with_nothing_to_spare(scripted, share, kept):
    stations = (Station("A", "Alpha", 0.0), Station("B", "Beta", 2000.0))
    limit, gradient = (
        Steps(np.zeros(1), np.array([25.0])),
        Steps(np.array([0.0, 250.0]), np.array([-20.0, 39.0])),
    )
    section = Line("step", "step", stations, limit, gradient).section("A", "B")
    trainset = replace(load_trainset("dkz32"), length_m=0.0)
    way = drive(Run(section, trainset, 200.0), scripted(lambda _: share)).trajectory
    over = (way.position_m > 200.0) & (way.position_m < 300.0)
    assert (np.abs(way.jerk_mps3[over]).max() <= 1.0 + 1e-9) == kept


def test_who_creeps_runs_out_of_time(request_rj, scripted):
    driven = drive(request_rj.run(), scripted(lambda o: 0.3 if o.speed_mps < 0.5 else 0.0))
    assert driven.outcome is Outcome.OUT_OF_TIME
    assert driven.trajectory.time_s[-1] == pytest.approx(322, abs=0.5)


def test_a_driver_that_says_nan_is_braked(request_rj, scripted):
    driven = drive(request_rj.run(), scripted(lambda o: 1.0 if o.time_s < 10 else float("nan")))
    t = driven.trajectory
    assert t.command[t.time_s >= 10].max() == -1.0
    assert driven.interventions == 1
    assert driven.outcome is Outcome.STALLED


def test_speed_noise_is_cut_and_repeats_itself(request_rj, scripted):
    run = replace(request_rj.run(), disturbance=Disturbance(speed_noise_mps=0.05), seed=3)
    seen = []
    for _ in range(2):
        driver = scripted(lambda o: 0.5 if o.time_s < 15 else -0.3)
        driven = drive(run, driver)
        true = driven.trajectory.speed_mps[:-1]
        measured = np.array([o.speed_mps for o in driver.seen])
        moving = true > 0.2
        assert np.abs(measured - true)[moving].max() <= 0.15 + 1e-12
        assert np.std((measured - true)[moving]) == pytest.approx(0.05, rel=0.3)
        assert (measured[true == 0] == 0).all()
        seen.append(measured)
    assert np.array_equal(*seen)


def test_news_reach_driver_and_plant(request_rj, scripted):
    restriction = Restriction(600.0, 800.0, 10.0)
    news = (TimetableUpdate(30.0, scheduled_time_s=116.0), TimetableUpdate(10.0, restriction=restriction))
    run = replace(request_rj.run(), disturbance=Disturbance(updates=news))
    driver = scripted(lambda o: 1.0)
    driven = drive(run, driver)
    t = driven.trajectory
    assert {o.scheduled_time_s for o in driver.seen if o.time_s < 30} == {101.0}
    assert {o.scheduled_time_s for o in driver.seen if o.time_s >= 30} == {116.0}
    assert driven.scheduled_time_s == 116.0
    assert driver.seen[0].section.restrictions == ()
    assert driver.seen[-1].section.restrictions == (restriction,)
    inside = (t.position_m > 600) & (t.position_m < 800)
    assert (t.limit_mps[inside] == 10.0).all()
    assert (t.speed_mps[inside] <= 10.0).all()
    assert driven.max_overspeed_mps == 0.0


def test_overspeed_is_found_between_two_rows(request_rj):
    run = request_rj.run()
    track = track_arrays(run.section, run.trainset)
    vehicle = vehicle_arrays(run.trainset)
    at = float(track.limit_from_m[np.searchsorted(track.limit_from_m, 1.0) - 1])
    low, high = train_limit_at(track, at), train_limit_at(track, at - 0.01)
    assert low < high, "the platform's limit begins at the origin"
    before = at_rest(vehicle, position_m=at - 1.0, speed_mps=low + 1.0)
    after = at_rest(vehicle, position_m=at + 1.0, speed_mps=low - 1.0)
    # v^2 falls from (low + 1)^2 to (low - 1)^2 over 2 m: halfway it is low^2 + 1.
    assert overspeed_in_period(track, before, after) == pytest.approx(np.hypot(low, 1.0) - low)


def test_driving_never_imports_jax():
    code = (
        "import sys; from metropilot.evaluate import *; from metropilot.sim import drive\n"
        "r = RunSpec('yizhuang', 'RJ', 'WYJ', 101.0, driver='flat_out')\n"
        "d = drive(r.run(), r.make_driver()); kpis_of(d, optimum_of(d))\n"
        "assert 'jax' not in sys.modules and 'matplotlib' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_run_stepped_by_hand_gives_the_same_bits(request_rj):
    whole = drive(request_rj.run(), request_rj.make_driver())
    rollout = Rollout(request_rj.run(), request_rj.make_driver())
    seen = []
    while rollout.outcome is None:
        seen.append(rollout.advance())
    stepped = rollout.drive()
    np.testing.assert_array_equal(stepped.trajectory.speed_mps, whole.trajectory.speed_mps)
    np.testing.assert_array_equal([m.speed_mps for m in seen], whole.trajectory.speed_mps[1:])
    assert seen[-1].energy_wheel_j == whole.trajectory.energy_wheel_j[-1]


def test_no_drive_before_the_end(request_rj):
    rollout = Rollout(request_rj.run(), request_rj.make_driver())
    rollout.advance()
    with pytest.raises(ValueError, match="not over"):
        rollout.drive()


def test_a_slow_restriction_told_on_the_way_has_its_time(request_rj):
    restriction = Restriction(300.0, 900.0, 5.0 / 3.6)
    news = (TimetableUpdate(10.0, restriction=restriction),)
    run = replace(request_rj.run(), disturbance=Disturbance(updates=news), dt=0.5)
    driven = drive(run, request_rj.make_driver())
    # the limit of time without it is 322 s
    assert driven.running_time_s > restriction.passing_time_s(driven.trainset.length_m) > 500.0
    assert driven.outcome is Outcome.ARRIVED
    assert driven.interventions == 0


def test_told_on_the_way_is_as_told_beforehand(request_rj):
    news = TimetableUpdate(30.2, scheduled_time_s=125.0)
    before = replace(request_rj, driver="optimal")
    run = before.run()
    told = replace(run, disturbance=replace(run.disturbance, updates=(news,)))
    planned = drive(told, before.make_driver())
    rollout = Rollout(before.run(), before.make_driver())
    while rollout.outcome is None:
        if rollout.moment().time_s >= 30.1 and not rollout.pending and rollout.scheduled_time_s != 125.0:
            rollout.tell(news)
        rollout.advance()
    told = rollout.drive()
    np.testing.assert_array_equal(told.trajectory.speed_mps, planned.trajectory.speed_mps)
    assert told.running_time_s == pytest.approx(125.0, abs=3.0)


def test_a_hand_on_the_lever_is_supervised_and_gives_it_back(request_rj):
    request = replace(request_rj, driver="optimal")
    rollout = Rollout(request.run(), request.make_driver())
    while rollout.outcome is None:
        now = rollout.moment().time_s
        if abs(now - 20.0) < 0.1:
            rollout.take(1.0)
        if abs(now - 40.0) < 0.1:
            rollout.take(None)
        seen = rollout.advance()
        if 20.2 < now < 39.8:
            assert seen.wanted == 1.0
    driven = rollout.drive()
    assert driven.interventions > 0
    assert driven.max_overspeed_mps == 0.0
    assert driven.outcome is Outcome.ARRIVED
