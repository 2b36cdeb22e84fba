"""The attainable optimum beside whole drives: in order, split in two, below every good drive."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.drivers import DRIVERS
from metropilot.evaluate import driving_limits, kpis_of, optimum_of
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import Actuation, load_line, load_trainset
from metropilot.sim import Disturbance, Outcome, Run, drive

SLOW = Actuation(0.6, 0.4, 1.0)
ENDS = (("RJ", "WYJ"), ("XC", "XHM"), ("CQN", "CQ"))


def run_on(ends, actuation=None, **given):
    trainset = load_trainset("dkz32")
    if actuation is not None:
        trainset = replace(trainset, actuation=actuation)
    section = load_line("yizhuang").section(*ends)
    return Run(section, trainset, section.planned_time_s, **given)


@pytest.mark.parametrize("driver", ["optimal", "generalist", "flat_out"])
@pytest.mark.parametrize("actuation", [None, SLOW])
@pytest.mark.parametrize("ends", ENDS)
def test_no_drive_within_its_limits_needs_less_than_the_bound(ends, actuation, driver):
    driven = drive(run_on(ends, actuation), DRIVERS.make(driver))
    optimum = optimum_of(driven)
    kpis = kpis_of(driven, optimum)
    assert (kpis.outcome, kpis.interventions) == ("arrived", 0)
    assert driven.trajectory.speed_mps.max() <= driven.trajectory.permitted_mps.max()
    assert kpis.bound_energy_kwh <= kpis.attainable_bound_kwh <= kpis.attainable_energy_kwh
    assert kpis.attainable_bound_kwh <= kpis.energy_wheel_kwh
    assert kpis.attainable_energy_kwh <= 1.015 * kpis.attainable_bound_kwh
    gaps = (1 + kpis.trainset_gap_percent / 100) * (1 + kpis.driver_gap_percent / 100)
    assert gaps == pytest.approx(1 + kpis.optimality_gap_percent / 100)


def test_an_ideal_trainset_attains_the_optimum_under_the_permitted_speed():
    run = run_on(ENDS[0], disturbance=Disturbance(ideal=True))
    driven = drive(run, DRIVERS.make("optimal"))
    limits = driving_limits(driven.run, driven.section)
    options = PlanOptions(spacing_m=5.0, cap_m=limits.position_m, cap_mps=limits.permitted_mps)
    capped = optimal_plan(driven.section, driven.trainset, driven.running_time_s, options)
    found = optimum_of(driven).attainable
    assert found.energy_j == pytest.approx(capped.energy_j, rel=1e-5)
    assert found.departure_s == found.stop_s == 0.0


def test_the_permitted_speed_of_the_limits_is_the_one_of_the_run():
    driven = drive(run_on(ENDS[0], SLOW), DRIVERS.make("optimal"))
    limits, t = driving_limits(driven.run, driven.section), driven.trajectory
    before = t.position_m < driven.section.length_m - 150.0
    at = np.interp(t.position_m[before], limits.position_m, limits.permitted_mps)
    assert np.max(np.abs(at - t.permitted_mps[before])) < 0.2


def test_a_brake_that_protection_does_not_trust_is_the_trainsets_gap():
    trainset = load_trainset("ch_stadler_flirt_tpf")
    section = load_line("yizhuang-ttobench").section("JG", "YZQ")
    driven = drive(Run(section, trainset, 122.0), DRIVERS.make("optimal"))
    limits = driving_limits(driven.run, driven.section)
    assert limits.deceleration_mps2 < 0.6 * trainset.max_deceleration_mps2
    kpis = kpis_of(driven, optimum_of(driven))
    assert kpis.trainset_gap_percent > 10.0
    assert 0.0 <= kpis.driver_gap_percent < 2.0
    assert kpis.bound_energy_kwh <= kpis.attainable_bound_kwh <= kpis.attainable_energy_kwh


def test_what_did_not_arrive_has_no_attainable_optimum():
    driven = drive(run_on(ENDS[0]), DRIVERS.make("flat_out"))
    lost = replace(driven, outcome=Outcome.OUT_OF_TIME)
    kpis = kpis_of(lost, optimum_of(lost))
    names = ("attainable_energy_kwh", "attainable_bound_kwh", "trainset_gap_percent", "driver_gap_percent")
    assert [getattr(kpis, name) for name in names] == [None] * 4


@pytest.mark.parametrize(("trainset", "least_ratio"), [("ch_stadler_flirt_tpf", 1.1), ("dkz32", 1.0)])
def test_no_drive_under_protection_is_faster_than_its_least_time(trainset, least_ratio):
    # the guaranteed brake of a FLIRT is weaker than its service brake: no driver keeps its minimum time
    section, train = load_line("yizhuang-ttobench").section("CQ", "YZHC"), load_trainset(trainset)
    time_s = 1.02 * minimum_running_time(section, train)
    for name in ("optimal", "flat_out"):
        driven = drive(Run(section, train, time_s), DRIVERS.make(name))
        kpis = kpis_of(driven, optimum_of(driven))
        assert least_ratio * kpis.minimum_running_time_s < kpis.protected_running_time_s < kpis.running_time_s
    assert kpis.protected_running_time_s > 0.92 * kpis.running_time_s
