"""Drives of trainsets with dead time and lag that once failed; the campaign trainsets found them."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sections import section_of

from metropilot.drivers import DRIVERS
from metropilot.evaluate import RunSpec
from metropilot.planning import minimum_running_time
from metropilot.railway import Actuation, Line, Section, Station, Steps, load_line, load_trainset
from metropilot.sim import Disturbance, Outcome, Run, drive

PLACES = {
    "falls": ("zurich-stadelhofen", "ZUE", "ZSTH", 151.018),
    "steep": ("zurich-stadelhofen", "ZAS", "ZHDB", 155.764),
    "cheng2023": ("zurich-stadelhofen", "ZHDB", "ZAS", 166.307),
    "long": ("yizhuang-ttobench", "XC", "SJZ", 208.193),
    "longer": ("yizhuang-ttobench", "TJN", "JHL", 179.305),
    "lu2023": ("lu2023", "WHY", "WYJ", 160.012),
    "short": ("yizhuang", "YZHC", "CQ", 113.119),
    "brisk": ("yizhuang-ttobench", "CQN", "CQ", 92.762),
    "slow period": ("yizhuang", "YZQ", "WHY", 91.466),
    "heavy": ("yizhuang", "RJ", "WYJ", 115.121),
    "second": ("yizhuang", "SJZ", "XC", 190.0),
    "unhurried": ("yizhuang", "SJZ", "XC", 202.9),
    "limits": ("yizhuang", "CQN", "CQ", 98.2),
}


@pytest.mark.parametrize(
    ("driver", "trainset", "load", "place", "dt"),
    [
        # neither a jerk limit nor, in part, limits of acceleration, but a lag
        ("generalist", "drawn-0-21@1,0.6", "most", "falls", 0.2),
        ("generalist", "cheng2023@1,0.6", None, "cheng2023", 0.5),
        ("optimal", "drawn-0-11@1,0.6", "least", "long", 0.2),
        ("generalist", "drawn-0-11@0.6,0.4", "least", "long", 0.2),
        ("mpc", "drawn-0-8@1,0.6", "most", "lu2023", 0.2),
        ("optimal", "cn_beijing_subway@1,0.6", None, "short", 0.1),
        # no limit of acceleration: the experts divided infinities
        ("eitoe", "drawn-0-23@0,0", "most", "longer", 0.5),
        ("eitop", "cn_beijing_subway@0.3,0.2", None, "brisk", 0.1),
        ("itor", "cn_beijing_subway@0.6,0.4", None, "brisk", 0.1),
        ("eitoe", "cn_beijing_subway@1,0.6", None, "brisk", 0.1),
        # a dead time that is no whole number of periods
        ("optimal", "dkz32@0.3,0.2", "AW3", "steep", 0.5),
        ("optimal", "drawn-0-1@0.6,0.4", "most", "slow period", 1.0),
        ("generalist", "drawn-0-5@0.3,0.2", "most", "heavy", 1.0),
        ("generalist", "drawn-0-1@0.3,0.2", "most", "slow period", 1.0),
        ("ston", "drawn-0-1@0.6,0.4", "most", "slow period", 1.0),
        ("optimal", "dkz32@0.3,0.2", None, "second", 1.0),
        ("optimal", "dkz32@0.5,0.3", None, "second", 1.0),
        ("optimal", "dkz32@0.7,0.3", None, "second", 1.0),
        ("generalist", "dkz32@0.6,0.4", None, "second", 0.5),
        ("generalist", "dkz32@0.7,0.3", None, "second", 1.0),
        ("eitoe", "dkz32@0.7,0.3", None, "second", 1.0),
        # the gains of the tracking laws are for periods of 0.2 s; the brake gives no more than 0.66 m/s2
        ("pid", "cheng2023@0.3,0.2", None, "cheng2023", 0.5),
        ("pid", "drawn-0-5@1,0.6", "most", "heavy", 1.0),
        ("pid", "drawn-0-1@0.6,0.4", "most", "slow period", 1.0),
        ("pid", "dkz32@0.6,0.4", None, "second", 0.2),
        # a command that passed was still on its way when not even full braking passed any more
        ("generalist", "drawn-7-1@1,0.6", "least", "unhurried", 0.1),
        ("optimal", "drawn-7-7@1,0.6", "most", "limits", 0.1),
        ("eitoe", "drawn-7-7@1,0.6", "most", "limits", 0.1),
    ],
)
def test_stops_at_the_mark_and_in_time(driver, trainset, load, place, dt):
    *where, time_s = PLACES[place]
    request = RunSpec(*where, time_s, trainset=trainset, load=load, driver=driver, dt_s=dt)
    done = drive(request.run(), request.make_driver())
    assert done.outcome is Outcome.ARRIVED
    assert done.max_overspeed_mps == 0.0
    assert done.interventions == 0
    assert abs(done.running_time_s - time_s) <= 2.0


@pytest.mark.parametrize(
    ("trainset", "place", "most_j_kg"),
    [
        ("de_traxx_ic2@1,0.6", ("yizhuang", "CQN", "CQ", 117.18), 151.0),
        ("ch_stadler_flirt_tpf@0.6,0.4", ("yizhuang-ttobench", "JG", "YZQ", 122.36), 372.0),
    ],
)
def test_a_learned_driver_allows_for_the_time_its_stop_takes(trainset, place, most_j_kg):
    # both were 1.0 to 2.2 s late, after a burst of full traction just before the stop
    request = RunSpec(*place, trainset=trainset, driver="generalist")
    done = drive(request.run(), request.make_driver())
    assert done.interventions == 0
    assert abs(done.running_time_s - request.time_s) <= 0.85
    assert done.trajectory.energy_wheel_j[-1] / done.run.trainset.mass_kg <= most_j_kg


@pytest.mark.parametrize(
    ("trainset", "actuation", "place", "ratio", "dt"),
    [
        ("cheng2023", Actuation(0.37, 0.51, 0.82), ("RC", "RJ"), 1.25, 0.1),
        ("cheng2023", Actuation(0.25, 0.52, 0.7), ("TJN", "RC"), 1.25, 0.1),
        ("cheng2023", Actuation(0.51, 0.22, 0.51), ("CQ", "CQN"), 1.1, 0.2),
        ("dkz32", Actuation(0.26, 0.58, 1.02), ("TJN", "RC"), 1.1, 0.1),
    ],
)
def test_traction_that_a_lag_keeps_up_is_foreseen(trainset, actuation, place, ratio, dt):
    # each was overruled once to six times: the period after the commands in flight was not looked at
    section = load_line("yizhuang").section(*place)
    late = replace(load_trainset(trainset), actuation=actuation)
    time_s = ratio * minimum_running_time(section, late)
    done = drive(Run(section, late, time_s, dt=dt), DRIVERS.make("optimal"))
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    assert abs(done.running_time_s - time_s) <= 1.0


@pytest.mark.parametrize("driver", ["optimal", "generalist", "eitoe"])
@pytest.mark.parametrize("actuation", [(0.2, 0.0), (0.25, 0.3), (0.2, 0.6)])
def test_traction_on_its_way_is_not_added_to_on_the_edge_of_protection(driver, actuation):
    section = load_line("yizhuang-ttobench").section("CQ", "YZHC")
    train = replace(load_trainset("ch_stadler_flirt_tpf"), actuation=Actuation(*actuation, np.inf))
    time_s = 1.2 * minimum_running_time(section, train)
    result = drive(Run(section, train, time_s, dt=0.1), DRIVERS.make(driver))
    assert result.interventions == 0  # the emergency brake at 77 km/h, 16 to 32 s late
    assert result.running_time_s < time_s + 6.0  # hardly more than protection leaves


@pytest.mark.parametrize("driver", ["optimal", "eitoe"])
@pytest.mark.parametrize(
    ("trainset", "actuation", "place", "ratio"),
    [
        ("drawn-21-31", Actuation(0.55, 0.49, 0.71), ("yizhuang", "YZQ", "WHY"), 1.177),
        ("drawn-21-63", Actuation(0.67, 0.3, 0.87), ("zurich-stadelhofen", "ZUE", "ZSTH"), 1.386),
        ("drawn-21-77", Actuation(0.48, 0.44, float("inf")), ("yizhuang-ttobench", "JG", "XHM"), 1.266),
    ],
)
def test_a_dead_time_of_half_a_long_period_is_reckoned_with(driver, trainset, actuation, place, ratio):
    # 0.3 to 2.3 m past the mark: the part of a period was rounded to none, or to a whole one
    where, *ends = place
    section = load_line(where).section(*ends)
    late = replace(load_trainset(trainset), actuation=actuation)
    done = drive(
        Run(section, late, ratio * minimum_running_time(section, late), dt=1.0), DRIVERS.make(driver)
    )
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    assert abs(float(done.trajectory.position_m[-1]) - section.length_m) <= 0.1


@pytest.mark.parametrize(
    ("driver", "trainset", "actuation", "length_m", "time_s"),
    [
        ("optimal", "dkz32", (0.7, 0.55, 1.3), 200.0, 39.6),
        ("mpc", "cheng2023", (0.7, 0.55, 1.3), 600.0, 67.9),
        ("generalist", "dkz32", (0.7, 0.55, 1.3), 200.0, 39.6),
        ("pid", "cn_beijing_subway", (0.88, 0.47, 0.51), 1228.0, 90.0),
        ("flat_out", "cn_beijing_subway", (0.88, 0.47, 0.51), 1228.0, 90.0),
    ],
)
def test_a_lag_leaves_no_more_of_the_brake_at_the_stand_than_the_jerk_limit_lets_go(
    driver, trainset, actuation, length_m, time_s
):
    """The jerk at the stop was 1.17, 1.19, 1.02, 1.24 and 1.37 times the limit."""
    section = even_section(length_m, 80.0, 0.0)
    late = replace(load_trainset(trainset), actuation=Actuation(*actuation))
    done = drive(Run(section, late, time_s, dt=0.1), DRIVERS.make(driver))
    assert np.abs(done.trajectory.jerk_mps3).max() <= 1.001 * actuation[2]
    assert abs(done.trajectory.position_m[-1] - length_m) <= 0.02
    assert done.interventions == 0


def even_section(length_m: float, limit_kmh: float, gradient_permil: float) -> Section:
    """A section with one limit and one gradient."""
    stations = (Station("A", "Alpha", 0.0), Station("B", "Beta", length_m))
    limit, gradient = (
        Steps(np.zeros(1), np.array([limit_kmh / 3.6])),
        Steps(np.zeros(1), np.array([gradient_permil])),
    )
    return Line("even", "even", stations, limit, gradient).section("A", "B")


@pytest.mark.parametrize(
    ("driver", "trainset", "actuation", "place", "time_s", "dt"),
    [
        # a dead time that is no whole number of periods: the command before has its part in the last one
        ("mpc", "cheng2023", (0.29, 0.36, 0.41), (238.1, 76.2, 0.0), 34.4, 0.5),
        ("optimal", "drawn-9-108", (0.52, 0.18, 0.62), (678.12, 36.54, 0.0), 100.338, 1.0),
        # foreseen to stand, they crept up a climb and were braked
        ("eitoe", "drawn-8-82", (0.12, 0.42, 0.45), (246.2, 105.6, 31.1), 35.2, 0.1),
        ("eitoe", "drawn-8-115", (0.47, 0.21, 0.58), (413.1, 83.4, 18.0), 45.8, 0.1),
    ],
)
def test_the_last_periods_of_a_late_brake_keep_the_jerk_limit(driver, trainset, actuation, place, time_s, dt):
    """The jerk at the stop was 1.1, 1.12, 1.8 and 2.4 times the limit."""
    section = even_section(*place)
    late = replace(load_trainset(trainset), actuation=Actuation(*actuation))
    done = drive(Run(section, late, time_s, dt=dt), DRIVERS.make(driver))
    assert np.abs(done.trajectory.jerk_mps3).max() <= 1.001 * actuation[2]
    assert abs(done.trajectory.position_m[-1] - section.length_m) <= 0.1
    assert done.interventions == 0


def test_a_lag_that_is_not_declared_is_allowed_for_in_the_last_brake():
    # protection's bounds hold it; the jerk was 1.6 times its limit
    section, trainset = load_line("yizhuang").section("CQ", "CQN"), load_trainset("dkz32")
    world = Disturbance(ideal=False, mass_factor=1.2, resistance_factor=1.5, delay_s=0.6, lag_s=0.4)
    run = Run(section, trainset, 1.2 * minimum_running_time(section, trainset), world)
    done = drive(run, DRIVERS.make("optimal"))
    assert done.interventions == 0
    assert np.abs(done.trajectory.jerk_mps3).max() <= 1.05 * trainset.actuation.jerk_limit_mps3


@pytest.mark.parametrize("driver", ["eitoe", "eitop", "ston"])
def test_a_trainset_that_creeps_past_the_mark_is_not_held_up_by_traction(driver):
    """On a climb traction bore all of it but what is not known: it crept on for 50 s, 1.4 m."""
    limits = {0.0: 13.42374378 * 3.6, 127.5017522: 34.61440143 * 3.6, 421.69245242: 12.14492659 * 3.6}
    section = section_of(538.60716008, limits, {0.0: 13.24992147, 537.8457493: 2.0977361})
    trainset = replace(load_trainset("drawn-26-54"), actuation=Actuation(0.02, 0.24, 0.54))
    done = drive(Run(section, trainset, 63.320262, dt=0.1), DRIVERS.make(driver))
    assert done.outcome is Outcome.ARRIVED
    assert abs(float(done.trajectory.position_m[-1]) - section.length_m) <= 0.1
