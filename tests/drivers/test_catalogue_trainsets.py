"""Every trainset of the catalogue, and random ones, drive a section to the mark under the optimal driver."""

import pytest

from metropilot.evaluate import RunSpec
from metropilot.planning import minimum_running_time
from metropilot.railway import list_trainsets, load_line, load_trainset
from metropilot.sim import Outcome, drive

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
