"""Trainsets that are guaranteed a weaker emergency brake than the service brake they have."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.sections import section_of

from metropilot.drivers import DRIVERS
from metropilot.env import build_tables
from metropilot.physics import track_arrays
from metropilot.protection import Bounds, permitted_before_end, protect, usable_deceleration
from metropilot.railway import Actuation, Section, Trainset, load_line, load_trainset
from metropilot.sim import Outcome, Run, declared_bounds, drive

DT = 0.2


@cache
def section(name: str) -> Section:
    line = load_line("yizhuang")
    return next(s for s in (*line.sections(), *line.sections(backward=True)) if s.name == name)


@cache
def trainset(name: str) -> Trainset:
    if name != "late":
        return load_trainset(name)
    known = load_trainset("dkz32")
    return replace(
        known,
        service_deceleration_mps2=1.2,
        max_deceleration_mps2=1.2,
        actuation=replace(known.actuation, delay_s=0.4),
        safe_braking=replace(
            known.safe_braking, emergency_deceleration_mps2=0.5, service_deceleration_mps2=1.2
        ),
    )


@pytest.mark.parametrize("place", ["CQN-JHL", "WHY-WYJ"])
@pytest.mark.parametrize("driver", ["optimal", "mpc", "generalist", "eitoe", "pid", "manual"])
@pytest.mark.parametrize("name", ["ch_stadler_flirt_tpf", "late"])
def test_no_driver_is_overruled(name, driver, place):
    where = section(place)
    run = Run(section=where, trainset=trainset(name), scheduled_time_s=where.planned_time_s, dt=DT)
    done = drive(run, DRIVERS.get(driver)())
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    assert abs(done.running_time_s - where.planned_time_s) <= 3.0
    assert abs(float(done.trajectory.position_m[-1]) - where.length_m) <= 0.3


def test_a_stop_is_planned_below_the_speeds_that_protection_leaves():
    weak, where = trainset("ch_stadler_flirt_tpf"), section("CQN-JHL")
    bounds = Bounds.of(weak, DT)
    usable = usable_deceleration(where, weak, bounds)
    # between the service rates: 0.4 m/s2 that protection counts on and the 1.1 m/s2 it has
    assert 0.4 < usable < 0.7
    left = np.arange(10.0, 400.0, 10.0)
    most = permitted_before_end(
        protect(where, weak, bounds), track_arrays(where, weak), where.length_m - left
    )
    assert np.all(np.sqrt(2.0 * usable * left) < most)
    tables = build_tables([(where, weak, bounds)], 1.0, np.float64)
    assert tables.vehicle.max_deceleration_mps2[0] == usable


def test_the_stop_that_is_left_is_as_the_page_says():
    line, weak = load_line("yizhuang"), trainset("ch_stadler_flirt_tpf")
    left = [
        usable_deceleration(each, weak, declared_bounds(Run(each, weak, 300.0)))
        for each in (*line.sections(), *line.sections(backward=True))
    ]
    assert sorted(round(each, 2) for each in left)[:5] == [0.37, 0.40, 0.47, 0.49, 0.52]
    assert round(max(left), 2) == 0.56
    page = (Path(__file__).parents[2] / "docs/safety.md").read_text()
    said = "at 0.52 to 0.56 m/s² on 22 of the 26 sections of Yizhuang and at 0.37 to 0.49 m/s²"
    assert said in " ".join(page.split())


def test_who_is_guaranteed_the_service_brake_may_use_all_of_it():
    strong = load_trainset("dkz32")
    assert usable_deceleration(section("CQN-JHL"), strong, Bounds.of(strong, DT)) == 1.0


@pytest.mark.parametrize("driver", ["optimal", "generalist"])
def test_a_climb_takes_nothing_of_the_stop_that_is_left(driver):
    """The speed that a climb takes from who holds it was taken for the end's: 0.13 m/s2, 18 s late."""
    late = replace(trainset("ch_stadler_flirt_tpf"), actuation=Actuation(0.27, 0.5, 0.93))
    climb, level = (section_of(574.0, {-600.0: 72.0}, {-600.0: g}) for g in (26.0, 0.0))
    usable = [usable_deceleration(each, late, Bounds.of(late, 0.5)) for each in (climb, level)]
    assert usable[0] > 0.8 * usable[1]
    run = Run(section=climb, trainset=late, scheduled_time_s=85.0, dt=0.5)
    done = drive(run, DRIVERS.get(driver)())
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    assert abs(done.running_time_s - 85.0) <= 1.0
