"""Every trainset of the catalogue, and random ones, drive a section to the mark under the optimal driver."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.errors import Infeasible
from metropilot.evaluate import RunSpec, make_driver
from metropilot.planning import minimum_running_time
from metropilot.railway import Line, Station, Steps, list_trainsets, load_line, load_trainset
from metropilot.sim import Outcome, Run, drive

SECTIONS = {"metro": ("yizhuang", "RJ", "WYJ"), "steep": ("zurich-stadelhofen", "ZSTH", "ZUE")}


@pytest.mark.parametrize("place", SECTIONS)
@pytest.mark.parametrize("key", [*list_trainsets(), "drawn-0-3:least", "drawn-0-4:most"])
def test_a_trainset_drives_a_section_to_the_mark(key, place):
    line, origin, destination = SECTIONS[place]
    section = load_line(line).section(origin, destination)
    time_s = round(1.25 * minimum_running_time(section, load_trainset(key)), 1)
    request = RunSpec(line, origin, destination, time_s, trainset=key, driver="optimal")
    driven = drive(request.run(), request.make_driver())
    assert driven.outcome is Outcome.ARRIVED
    assert driven.max_overspeed_mps == 0.0
    assert abs(float(driven.trajectory.position_m[-1]) - section.length_m) <= 0.3
    # de_traxx_ic2 brakes with 0.35 m/s^2 and falls 2.6 s behind on the fall of 38 permil
    assert abs(driven.running_time_s - time_s) <= (3.0 if place == "steep" else 1.0)
    assert driven.interventions == 0


def on_a_fall(service_mps2):
    """A section whose last 600 m fall by 40 permil, and a trainset with so much service brake."""
    line = Line(
        id="fall",
        name="fall",
        stations=(Station("A", "Alpha", 0.0), Station("B", "Beta", 1200.0)),
        limit_mps=Steps(np.array([-400.0]), np.array([22.0])),
        gradient_permil=Steps(np.array([-400.0, 600.0]), np.array([0.0, -40.0])),
    )
    trainset = replace(
        load_trainset("dkz32"), service_deceleration_mps2=service_mps2, max_deceleration_mps2=1.0
    )
    braking = replace(trainset.safe_braking, service_deceleration_mps2=service_mps2)
    return line.section("A", "B"), replace(trainset, safe_braking=braking)


@pytest.mark.parametrize("name", ["optimal", "generalist", "ppo", "eitoe", "eitop", "pid", "flat_out"])
def test_a_brake_that_barely_outdoes_the_fall_stops_at_the_mark(name):
    section, trainset = on_a_fall(0.55)
    run = Run(section, trainset, 1.26 * minimum_running_time(section, trainset))
    driven = drive(run, make_driver(name))
    assert driven.outcome is Outcome.ARRIVED
    assert abs(float(driven.trajectory.position_m[-1]) - section.length_m) <= 0.05
    assert driven.interventions == 0


def test_a_stop_that_the_service_brake_hardly_holds_is_refused():
    with pytest.raises(Infeasible, match="hardly holds the trainset at the stop"):
        minimum_running_time(*on_a_fall(0.5))
