"""Sections that random drawing found: stops on a climb and before a fall, limits that weak brakes come to."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sections import section_of

from metropilot.control import STOP_OPTIONS, build_up, curve_for, lasting_deceleration, reachable_deceleration
from metropilot.drivers import optimal
from metropilot.evaluate import make_driver
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import minimum_running_time
from metropilot.railway import Actuation, load_trainset
from metropilot.sim import Disturbance, Outcome, Run, drive


def slow(jerk_mps3=0.43, **late):
    """DKZ32 with a low jerk limit."""
    trainset = load_trainset("dkz32")
    actuation = replace(trainset.actuation, jerk_limit_mps3=jerk_mps3, **late)
    return replace(trainset, actuation=actuation)


def driven(section, trainset, ratio, name, dt=0.2):
    """A drive in a multiple of the least running time."""
    run = Run(section, trainset, ratio * minimum_running_time(section, trainset), dt=dt)
    return drive(run, make_driver(name))


CLIMB = section_of(2500.0, {0.0: 29.0}, {0.0: 0.0, 900.0: 30.0})


@pytest.mark.parametrize("name", ["generalist", "eitoe", "eitop", "optimal"])
def test_a_stop_on_a_climb_is_reached_without_standing_before_it(name):
    """The experts took a trainset that cannot coast to the stop for one in time, and braked it to a stand."""
    done = driven(CLIMB, slow(), 1.25, name, dt=0.1)
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    way = done.trajectory
    assert abs(float(way.position_m[-1]) - CLIMB.length_m) < 0.2
    moving = (way.position_m > 1.0) & (way.position_m < CLIMB.length_m - 0.3)
    assert way.speed_mps[moving].min() > 0.0


FALL = section_of(2523.0, {0.0: 86.0, 1411.0: 67.0}, {0.0: -2.0, 2352.0: 5.1, 2517.0: -1.7, 2521.0: -11.4})


@pytest.mark.parametrize("name", ["optimal", "mpc"])
def test_a_plan_brakes_no_harder_than_the_stop_keeps_up(name):
    """They were 1.4 s late: the fall of the last metres leaves less than the brake gives before it."""
    done = driven(FALL, load_trainset("nl_intercity_virm6"), 1.16, name, dt=1.0)
    assert done.outcome is Outcome.ARRIVED
    assert done.running_time_s - done.scheduled_time_s < 0.5


DROP = section_of(2600.0, {0.0: 100.0, 1700.0: 32.0, 1780.0: 90.0}, {0.0: 0.0, 700.0: -9.0, 2000.0: 3.0})


@pytest.mark.parametrize("name", ["eitoe", "eitop", "flat_out", "optimal"])
def test_a_weak_brake_on_a_fall_begins_in_time_for_a_lower_limit(name):
    """`flat_out` and the experts counted on the brake that metros have, and were overruled."""
    done = driven(DROP, load_trainset("de_desiro_classic"), 1.15, name)
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0


def test_a_plan_that_holds_is_not_made_again(monkeypatch):
    """A low jerk limit under a lag had a plan made every two seconds: 82 on this section."""
    made = []
    plan_arrays = optimal.plan_arrays
    monkeypatch.setattr(optimal, "plan_arrays", lambda *args: made.append(1) or plan_arrays(*args))
    level = section_of(2500.0, {0.0: 60.0}, {0.0: 0.0})
    done = driven(level, slow(delay_s=0.04, lag_s=0.29), 1.15, "optimal")
    assert done.running_time_s - done.scheduled_time_s < 0.5
    assert len(made) < 10


def test_reachable_deceleration_is_built_up_and_released_before_the_stand():
    vehicle = vehicle_arrays(slow())
    curve = curve_for(vehicle, 0.2, 0.9, STOP_OPTIONS)
    for speed, rate in ((0.8, 0.0), (1.5, -0.3), (2.0, 0.4)):
        reached = float(reachable_deceleration(speed, rate, curve))
        then, _, _ = build_up(speed, rate, reached, curve.build_jerk_mps3)
        left = (reached**2 - curve.end_mps2**2) / (2 * curve.release_jerk_mps3)
        assert float(then) == pytest.approx(left, abs=1e-6)


def test_lasting_deceleration_is_the_least_mean_up_to_the_stop():
    trainset = load_trainset("nl_intercity_virm6")
    vehicle, track = vehicle_arrays(trainset), track_arrays(FALL, trainset)
    whole = lasting_deceleration(vehicle, track, 2360.0, 2516.0, 14.0)
    fall = lasting_deceleration(vehicle, track, 2360.0, 2523.0, 14.0)
    assert 0.5 < fall < whole
    weaker = lasting_deceleration(vehicle, track, 2360.0, 2523.0, 14.0, brake_gain=0.8)
    assert weaker == pytest.approx(fall - 0.2 * 0.66, abs=0.02)


@pytest.mark.parametrize("length_m", [270.0, 275.6])
@pytest.mark.parametrize("name", ["flat_out", "optimal", "eitoe", "manual"])
def test_what_a_long_period_of_traction_adds_is_braked_away_before_the_mark(name, length_m):
    """Without a jerk limit `flat_out` counted the way of one more period, not its speed: 7 m beyond."""
    trainset = load_trainset("ch_stadler_kiss_sbb")
    at_once = replace(trainset, actuation=Actuation(0.0, 0.0, np.inf))
    done = driven(section_of(length_m, {0.0: 130.0}, {0.0: 0.0}), at_once, 1.16, name, dt=1.0)
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0


def test_a_brake_that_fades_brakes_as_late_at_low_speed_as_it_can():
    """A limit of 26 km/h was approached with what the brake gives at 80: 2.7 s late."""
    limits = {0.0: 68.0, 3000.0: 26.0, 4000.0: 43.0}
    section = section_of(6000.0, limits, {0.0: -15.0, 4000.0: 0.0})
    done = driven(section, load_trainset("cheng2023"), 1.08, "generalist", dt=0.2)
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    assert abs(done.running_time_s - done.scheduled_time_s) < 0.5


def test_a_fall_at_the_limit_takes_the_time_of_the_speed_that_is_held():
    """Coasting was forecast at the limit itself, which the train is kept 0.05 m/s below: 1.1 s late."""
    section = section_of(4500.0, {0.0: 34.0}, {0.0: 0.0, 300.0: 10.0, 700.0: -14.0})
    done = driven(section, load_trainset("dkz32"), 1.33, "generalist")
    assert done.outcome is Outcome.ARRIVED
    assert abs(done.running_time_s - done.scheduled_time_s) < 0.5


@pytest.mark.parametrize(("length_m", "ratio"), [(250.0, 1.25), (260.0, 1.25), (300.0, 1.4)])
def test_a_hand_on_its_way_to_power_counts_before_the_stop(length_m, ratio):
    """`manual` looked at the stop as if it coasted while its hand moved to full power: 5 to 7 m beyond."""
    trainset = load_trainset("dkz32-contest")
    slow_to_build = replace(trainset, actuation=Actuation(0.0, 0.0, 0.68))
    done = driven(section_of(length_m, {0.0: 80.0}, {0.0: 8.0}), slow_to_build, ratio, "manual", dt=1.0)
    assert done.outcome is Outcome.ARRIVED


@pytest.mark.parametrize("name", ["eitoe", "eitop"])
def test_past_the_mark_a_fall_is_braked_not_only_balanced(name):
    """A train 3 cm past the mark crept on at 3 cm/s for 80 s, until the end of its authority."""
    trainset = load_trainset("de_desiro_classic")
    quick = replace(trainset, actuation=Actuation(0.0, 0.0, 1.18))
    section = section_of(461.3, {0.0: 99.0, 152.0: 60.0}, {0.0: -13.9})
    done = driven(section, quick, 1.1, name, dt=0.1)
    assert done.outcome is Outcome.ARRIVED
    assert done.running_time_s - done.scheduled_time_s < 1.0


@pytest.mark.parametrize(
    ("trainset", "ratio", "permil", "way_m"),
    [("dkz32", 1.35, -36.0, 400.0), ("nl_intercity_virm6", 1.35, 30.0, 40.0)],
)
def test_a_policy_starts_however_little_it_asks_for(trainset, ratio, permil, way_m):
    """Coasting sufficed on the fall, and no brake was let go; on the climb some traction did not move it."""
    section = section_of(1800.0, {0.0: 27.0}, {0.0: permil, way_m: -permil, way_m + 200.0: -3.0})
    done = driven(section, load_trainset(trainset), ratio, "generalist")
    assert done.outcome is Outcome.ARRIVED
    assert done.running_time_s - done.scheduled_time_s < 1.5


@pytest.mark.parametrize(("limit_kmh", "permil", "ratio"), [(20.0, -15.0, 1.3), (70.0, -25.0, 2.0)])
def test_a_policy_brakes_where_coasting_down_a_fall_would_be_early(limit_kmh, permil, ratio):
    """It only ever coasted, up to the limit: 23 and 26 s early."""
    section = section_of(1200.0, {0.0: limit_kmh}, {0.0: permil})
    done = driven(section, load_trainset("dkz32"), ratio, "generalist")
    assert done.outcome is Outcome.ARRIVED
    assert abs(done.running_time_s - done.scheduled_time_s) < 1.0
    assert done.trajectory.energy_wheel_j[-1] < 0.1 * 3.6e6


@pytest.mark.parametrize("name", ["eitoe", "eitop"])
def test_a_crawl_to_the_mark_takes_no_turns_of_full_power_and_brake(name):
    """Far too late below 1 m/s, early above it: full power and the brake took turns up to the mark."""
    late = replace(load_trainset("dkz32-contest"), actuation=Actuation(0.02, 0.55, np.inf))
    section = section_of(1500.0, {0.0: 40.0}, {0.0: 0.0, 750.0: 7.0})
    done = driven(section, late, 1.5, name, dt=0.5)
    assert done.outcome is Outcome.ARRIVED
    given = done.trajectory.command
    left_m = section.length_m - done.trajectory.position_m[: given.size]
    crawl = given[(left_m > 3.0) & (left_m < 12.0)]
    assert crawl.max() < 0.7
    assert crawl.min() > -0.5


def test_a_line_of_many_limits_is_driven_in_time_for_what_they_cost():
    """Before each lower limit a late trainset loses time; a reserve of 3 % left this one 2.7 s late."""
    random = np.random.default_rng(0)
    count = int(random.integers(6, 16))
    limits = random.uniform(25.0, 80.0, count)
    length_m = count * random.uniform(150.0, 350.0)
    at_m, permil = length_m / count * np.arange(count), random.uniform(-12.0, 12.0, 4)
    gradients = dict(zip(length_m / 4.0 * np.arange(4), permil, strict=True))
    section = section_of(length_m, dict(zip(at_m, limits, strict=True)), gradients)
    done = driven(section, slow(0.6, delay_s=0.9, lag_s=0.2), 1.08, "generalist")
    assert done.outcome is Outcome.ARRIVED
    assert done.running_time_s - done.scheduled_time_s < 1.0


@pytest.mark.parametrize("name", ["eitoe", "eitop"])
def test_the_way_that_a_lag_takes_counts_before_a_stop_on_a_fall(name):
    """They began to brake a period late, and `eitoe` went beyond the mark."""
    trainset = load_trainset("ch_stadler_kiss_sbb")
    trainset = replace(trainset, actuation=Actuation(0.9, 0.59, trainset.actuation.jerk_limit_mps3))
    done = driven(section_of(600.0, {0.0: 27.6}, {0.0: 0.0, 150.0: -21.5}), trainset, 1.15, name, dt=0.5)
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    assert abs(float(done.trajectory.position_m[-1]) - 600.0) < 0.1


@pytest.mark.parametrize("name", ["optimal", "generalist", "eitoe", "flat_out"])
def test_what_a_lag_lets_go_of_late_counts_before_a_fall(name):
    """A point mass at its limit on a climb: traction that still acts when the fall begins is overruled."""
    trainset = load_trainset("cn_beijing_subway")
    trainset = replace(trainset, actuation=Actuation(0.15, 0.56, 0.74))
    steps = {place: 28.0 if place % 600 else -40.0 for place in range(0, 2400, 300)}
    done = driven(section_of(2400.0, {0.0: 80.0}, steps), trainset, 1.05, name, dt=0.1)
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0


PROMPT = Actuation(0.0, 0.0, np.inf)


@pytest.mark.parametrize(
    ("trainset", "actuation", "section", "ratio"),
    [
        (
            "nl_intercity_virm6",
            PROMPT,
            section_of(2500.0, {0.0: 51.0, 600.0: 124.0, 1550.0: 33.0}, {0.0: -34.0, 2100.0: 0.0}),
            1.05,
        ),
        (
            "de_desiro_classic",
            Actuation(0.13, 0.52, 1.07),
            section_of(
                2476.0,
                {0.0: 58.0, 1300.0: 39.0, 2270.0: 80.0},
                {
                    0.0: -9.0,
                    350.0: -35.0,
                    630.0: 24.0,
                    850.0: -30.0,
                    1185.0: 0.0,
                    1300.0: -30.0,
                    2300.0: 18.0,
                },
            ),
            1.1,
        ),
    ],
)
def test_braking_for_a_lower_limit_on_a_fall_counts_in_the_time(trainset, actuation, section, ratio):
    """The forecast of coasting was under the permitted speed, above what brakes keep: 5.7 and 1.7 s late."""
    trainset = replace(load_trainset(trainset), actuation=actuation)
    done = driven(section, trainset, ratio, "generalist", dt=0.5)
    assert done.outcome is Outcome.ARRIVED
    assert done.running_time_s - done.scheduled_time_s < 0.5


def test_coasting_that_comes_a_little_late_is_not_left_at_that():
    """For 95 s its forecast was 0.5 to 3 s late, and it asked for no traction: 1.3 s late."""
    trainset = replace(load_trainset("lu2023"), actuation=PROMPT)
    falls = {0.0: -24.0, 500.0: -32.0, 1500.0: 20.0, 1700.0: -8.0, 3000.0: -5.0, 3380.0: -13.0}
    section = section_of(3500.0, {0.0: 80.0}, {**falls, 3400.0: 28.0, 3485.0: -31.0})
    done = driven(section, trainset, 1.29, "generalist", dt=0.1)
    assert done.outcome is Outcome.ARRIVED
    assert done.running_time_s - done.scheduled_time_s < 0.6


@pytest.mark.parametrize("left_m", [18.0, 20.0, 22.0])
def test_a_fall_that_turns_into_a_climb_just_before_the_mark_is_felt_a_period_longer(left_m):
    """A point mass at full braking: it went 1.0 to 1.5 m beyond."""
    trainset = replace(load_trainset("cn_beijing_subway"), actuation=PROMPT)
    section = section_of(1200.0, {0.0: 60.0}, {0.0: 0.0, 600.0: -27.0, 1200.0 - left_m: 35.0})
    done = driven(section, trainset, 1.15, "generalist", dt=0.5)
    assert done.outcome is Outcome.ARRIVED
    assert abs(float(done.trajectory.position_m[-1]) - section.length_m) < 0.3


def test_a_stop_at_the_deceleration_that_a_fall_leaves_at_its_end_takes_its_time():
    """The time of a stop as late as possible was reckoned with: 4.6 s after `flat_out`, and 0.5 m beyond."""
    trainset = replace(load_trainset("drawn-7203-43"), actuation=Actuation(0.72, 0.24, 1.48))
    section = section_of(1500.0, {0.0: 140.0}, {0.0: -25.0, 900.0: 20.0, 1470.0: -36.0})
    done = driven(section, trainset, 1.15, "generalist")
    fastest = driven(section, trainset, 1.15, "flat_out")
    assert done.outcome is Outcome.ARRIVED
    assert done.running_time_s - fastest.running_time_s < 2.0


def test_what_protection_takes_below_the_limits_counts_in_the_time():
    """Its emergency brake is guaranteed weak: 8.7 s after `flat_out`, with a reserve for limits alone."""
    trainset = replace(load_trainset("ch_stadler_flirt_tpf"), actuation=PROMPT)
    limits = {
        0.0: 157.0,
        1900.0: 140.0,
        2111.0: 72.0,
        2581.0: 113.0,
        3612.0: 41.0,
        4177.0: 135.0,
        4629.0: 36.0,
    }
    hills = {0.0: 0.0, 704.0: 14.0, 2495.0: -15.0, 2882.0: -35.0, 3059.0: 36.0, 3249.0: 2.0, 3263.0: -36.0}
    section = section_of(4650.0, limits, {**hills, 3472.0: 19.0, 4431.0: 30.0})
    done = driven(section, trainset, 1.18, "generalist", dt=0.5)
    fastest = driven(section, trainset, 1.18, "flat_out", dt=0.5)
    assert done.outcome is Outcome.ARRIVED
    assert done.running_time_s - fastest.running_time_s < 1.0


@pytest.mark.parametrize("name", ["eitoe", "eitop"])
def test_an_expert_stops_a_trainset_heavier_than_told_at_its_mark(name):
    """It was 8.5 m beyond: the brake is no stronger for the mass, which the traction tells beforehand."""
    section = section_of(1200.0, {0.0: 60.0}, {0.0: 0.0})
    trainset = load_trainset("cn_beijing_subway@0.6,0.4")
    time_s = 1.15 * minimum_running_time(section, trainset)
    done = drive(Run(section, trainset, time_s, disturbance=Disturbance(mass_factor=1.2)), make_driver(name))
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    assert float(done.trajectory.position_m[-1]) - section.length_m == pytest.approx(0.0, abs=0.1)
    assert done.running_time_s == pytest.approx(time_s, abs=1.0)


@pytest.mark.parametrize("ratio", [1.02, 1.05])
def test_a_policy_with_plenty_of_traction_comes_up_to_a_limit_without_an_intervention(ratio):
    """An empty DKZ32 was overruled 10 and 12 times: protection expects the traction of a lower speed."""
    section = section_of(1200.0, {0.0: 60.0}, {0.0: 0.0})
    done = driven(section, load_trainset("dkz32", "AW0"), ratio, "generalist")
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    assert done.running_time_s - done.scheduled_time_s == pytest.approx(0.0, abs=0.5)
