"""Plans that know when the others draw: never more energy, the same times, and no train disturbed."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.operation.lines import TRAINSET, short_line

from metropilot.operation import (
    LineOperation,
    OperationOptions,
    adapt_plans,
    best_offset,
    check_headway,
)
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import ReceivedEnergy
from metropilot.railway import Efficiency


def operation(**given):
    return LineOperation(
        short_line(4), TRAINSET, OperationOptions(**({"zones": 3, "headway_s": 200} | given))
    )


@cache
def profiles():
    return operation().profiles()


@pytest.mark.parametrize(("headway_s", "zones"), [(90, 3), (200, 3), (200, 1), (450, 3)])
def test_adapted_plans_take_less_in_the_same_times_and_disturb_nobody(headway_s, zones):
    line = operation(headway_s=headway_s, zones=zones)
    timetable = best_offset(line, profiles())
    adapted = adapt_plans(line, timetable, profiles())
    before, after = (line.energy(timetable, each) for each in (profiles(), adapted))
    assert after.supplied_j <= before.supplied_j
    if (headway_s, zones) == (200, 3):
        assert after.supplied_j < 0.995 * before.supplied_j
    for trip, each in zip(line.trips, adapted, strict=True):
        ((time_s, profile),) = each.items()
        assert time_s == trip.planned_s == pytest.approx(profile.running_time_s, abs=0.05)
        assert profile.position_m[-1] == pytest.approx(trip.section.length_m)
        assert (profile.drawn_j, profile.returned_j) > (0.0, 0.0)
    check_headway(line, timetable, adapted)


def test_a_train_alone_is_driven_to_draw_least():
    line = operation(headway_s=7200)
    alone = line.plain_timetable(3600.0)
    adapted = line.energy(alone, adapt_plans(line, alone, profiles())).supplied_j
    own = line.profiles(received_w=line.trainset.auxiliary_w)
    assert adapted == pytest.approx(line.energy(alone, own).supplied_j, rel=2e-4)


def test_efficiencies_that_depend_on_effort_leave_the_plans_as_they_are():
    mapped = Efficiency(np.array([5.0, 15.0]), np.array([0.5, 1.0]), np.array([[0.8, 0.9], [0.85, 0.9]]))
    line = LineOperation(
        short_line(3), replace(TRAINSET, efficiency_traction=mapped), OperationOptions(zones=2)
    )
    driven = line.profiles()
    timetable = line.plain_timetable(40.0)
    assert adapt_plans(line, timetable, driven) == driven


def test_a_plan_beside_others_uses_what_they_take_and_what_they_give():
    line = operation()
    section = line.trips[0].section
    vehicle, track = vehicle_arrays(line.silent), track_arrays(section, line.silent)
    energy = ReceivedEnergy(vehicle, track, float(line.trips[0].planned_s))
    free = energy.plan(np.inf)
    count = free.time_s.size - 1
    plenty, none = (energy.plan_beside(np.full(count, w), free.speed_mps) for w in (1e9, 0.0))
    assert plenty.energy_j == pytest.approx(free.energy_j, rel=1e-4)

    def drawn_j(plan, between_m=(0.0, np.inf)):
        drawn = plan.traction_n * np.diff(plan.position_m)
        return float(
            np.sum(drawn[(plan.position_m[1:] > between_m[0]) & (plan.position_m[1:] <= between_m[1])])
        )

    # where nothing is received the plan draws least
    assert drawn_j(none) < 0.99 * drawn_j(free)
    # others give plenty on a stretch in the middle, where it would coast: it draws there, and elsewhere less
    middle_m = 0.4 * section.length_m, 0.6 * section.length_m
    inside = (free.position_m[1:] > middle_m[0]) & (free.position_m[1:] <= middle_m[1])
    given = energy.plan_beside(np.where(inside, -1e9, 0.0), free.speed_mps)
    assert drawn_j(given, middle_m) > drawn_j(none, middle_m) + 1e6
    assert drawn_j(given) - drawn_j(given, middle_m) < drawn_j(none) - drawn_j(none, middle_m) - 1e6
    assert given.time_s[-1] <= line.trips[0].planned_s + 0.05
