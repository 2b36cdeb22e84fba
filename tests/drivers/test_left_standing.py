"""After an intervention, wherever it stops the trainset, every driver moves on and stops at the mark."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sections import fall_of, section_of

from metropilot.drivers import DRIVERS
from metropilot.evaluate import kpi_rows, kpis_of, optimum_of
from metropilot.planning import minimum_running_time
from metropilot.railway import Restriction, load_line, load_trainset
from metropilot.sim import Disturbance, Outcome, Rollout, Run, TimetableUpdate, drive

DKZ32 = load_trainset("dkz32")
LATE = replace(DKZ32, actuation=replace(DKZ32.actuation, delay_s=0.8, lag_s=0.4))
SECTION = load_line("yizhuang").section("RJ", "WYJ")
ANYWHERE = (
    *("optimal", "mpc", "generalist", "eitoe", "eitop", "itor", "ston", "stod", "flat_out", "manual"),
    *("pid", "ddpg_pid", "fuzzy_pid", "neural_pid", "ppo_scaled"),
)
"""Drivers that are offered for any line."""


def brake_once(run, driver, left_m):
    """Outcome and end of a drive whose emergency brake acts once, at a distance from the stop."""
    rollout, length_m = Rollout(run, DRIVERS.make(driver)), run.section.length_m
    braked = False
    while rollout.outcome is None:
        moment = rollout.advance()
        if not braked and length_m - moment.position_m < left_m:
            braked = True
            latched = rollout.state.supervision._replace(emergency=np.bool_(True))
            rollout.state = rollout.state._replace(supervision=latched)
    assert braked
    return rollout.outcome, moment.time_s


@pytest.mark.parametrize("driver", ANYWHERE)
@pytest.mark.parametrize(
    ("trainset", "left_m"),
    [(DKZ32, 6.0), (LATE, 300.0), (LATE, 25.0), (LATE, 6.0)],
    ids=["6 m", "late, 300 m", "late, 25 m", "late, 6 m"],
)
def test_nobody_is_left_standing_short_of_the_stop(driver, trainset, left_m):
    """An emergency brake on the way, however near to the stop, is followed by a drive to the mark."""
    outcome, time_s = brake_once(Run(SECTION, trainset, 101.0), driver, left_m)
    assert outcome is Outcome.ARRIVED
    # ddpg_pid, whose policy knows no dead time, comes late by itself
    assert time_s < (200.0 if driver == "ddpg_pid" else 135.0)


@pytest.mark.parametrize("driver", ANYWHERE)
def test_nobody_is_left_standing_on_a_fall(driver):
    """All but `ppo_scaled` asked for the brake that would be right in motion, which held the trainset."""
    section = fall_of(400.0)
    time_s = 1.4 * minimum_running_time(section, LATE)
    outcome, ended_s = brake_once(Run(section, LATE, time_s), driver, 25.0)
    assert outcome is Outcome.ARRIVED
    assert ended_s < time_s + 60.0


@pytest.mark.parametrize("driver", ["eitoe", "eitop", "itor", "ston"])
@pytest.mark.parametrize(
    ("trainset", "permil", "left_m"),
    [("nl_intercity_virm6@0.8,0.5", -20.0, 300.0), ("ch_stadler_kiss_sbb", 0.0, 100.0)],
    ids=["from traction", "from a crawl"],
)
def test_an_expert_stops_at_the_mark_after_an_intervention(driver, trainset, permil, left_m):
    """Traction under a lag took it up to 2.5 m beyond; at 1 cm/s the stop's curve kept it at that."""
    section, known = section_of(1200.0, {-500.0: 70.0}, {-500.0: permil}), load_trainset(trainset)
    time_s = 1.2 * minimum_running_time(section, known)
    outcome, ended_s = brake_once(Run(section, known, time_s, dt=0.2), driver, left_m)
    assert outcome is Outcome.ARRIVED
    assert ended_s < time_s + 30.0


def test_an_emergency_brake_on_the_way_is_not_counted_on_at_the_stop():
    """`optimal` took the emergency brake for a service brake of 1.2 of nominal, and stood 0.67 m beyond."""
    section = section_of(1200.0, {-500.0: 70.0}, {-500.0: 0.0})
    known = load_trainset("cn_beijing_subway@0.6,0.4")
    time_s = 1.15 * minimum_running_time(section, known)
    late = TimetableUpdate(0.5 * time_s, restriction=Restriction(480.0, 1200.0, 40.0 / 3.6))
    driven = drive(Run(section, known, time_s, Disturbance(updates=(late,)), dt=0.2), DRIVERS.make("optimal"))
    assert driven.interventions == 1
    assert abs(driven.trajectory.position_m[-1] - section.length_m) < 0.1


@pytest.mark.parametrize("driver", ["optimal", "mpc", "generalist"])
@pytest.mark.parametrize("trainset", [DKZ32, load_trainset("cheng2023@0.5,0.3")], ids=["dkz32", "late"])
def test_a_drive_that_a_fall_does_alone_begins(driver, trainset):
    """They braked from the first moment, and never left. A drive that needs nothing has no excess over it."""
    section = fall_of(600.0)
    run = Run(section, trainset, 1.7 * minimum_running_time(section, trainset))
    driven = drive(run, DRIVERS.make(driver))
    assert driven.outcome is Outcome.ARRIVED
    # `generalist` does not brake to be slower, and arrives early
    late_s = driven.running_time_s - driven.scheduled_time_s
    assert late_s < 1.0
    assert late_s > -1.0 or driver == "generalist"
    assert driven.interventions == 0
    kpis = kpis_of(driven, optimum_of(driven))
    assert kpis.optimal_energy_kwh < 0.005
    assert kpis.optimality_gap_percent is kpis.trainset_gap_percent is kpis.driver_gap_percent is None
    assert not [row for row in kpi_rows(kpis.as_dict()) if row.value.startswith("-0.00")]
