"""A timetable sought on the network: it takes less, keeps windows, sums and headway, and repeats."""

from dataclasses import replace
from functools import cache
from math import inf

import numpy as np
import pytest
from tests.operation.lines import TRAINSET, short_line
from tests.operation.test_feeding import network
from tests.operation.test_storage import storage

from metropilot.operation import (
    LineOperation,
    OperationOptions,
    feed_line,
    find_timetable,
    line_headways,
    refine_timetable,
)
from metropilot.operation.network_search import _energies_j


@cache
def start():
    line = LineOperation(short_line(4), TRAINSET, OperationOptions(zones=1, headway_s=150, time_window_s=0))
    plans = [line.profiles(), line.profiles(received_w=TRAINSET.auxiliary_w)]
    return line, plans, *find_timetable(line, plans, moves=300, restarts=1)


def energy_kwh(timetable, profiles, feeding):
    return feed_line(start()[0], timetable, profiles, feeding).energy_kwh


def test_it_takes_less_from_the_network_and_keeps_the_windows():
    line, plans, timetable, profiles = start()
    found, driven = refine_timetable(line, timetable, profiles, plans, network(), rounds=12)
    assert energy_kwh(found, driven, network()) < energy_kwh(timetable, profiles, network()) - 0.05
    dwell = line.dwells_s(found)
    assert np.abs(dwell[[0, 1, 3, 4]] - line.options.dwell_s).max() <= line.options.dwell_window_s
    assert [dwell[:3].sum(), dwell[3:].sum()] == [60.0, 60.0]
    assert found.running_time_s.tolist() == line.planned_s.tolist()
    assert max(each.headway_s for each in line_headways(line, found, driven)) <= line.options.headway_s
    again, _ = refine_timetable(line, timetable, profiles, plans, network(), rounds=12)
    assert again.departure_s.tolist() == found.departure_s.tolist()


@pytest.mark.parametrize("stored", [False, True])
def test_many_timetables_solved_together_take_what_each_takes_alone(stored):
    line, plans, timetable, profiles = start()
    feeding = replace(network(), storages=(storage(3000.0),)) if stored else network()
    tried = [(line.plain_timetable(offset), plans[0]) for offset in (0.0, 40.0)] + [(timetable, profiles)]
    together = _energies_j(line, tried, feeding) / 3.6e6
    assert together == pytest.approx([energy_kwh(*each, feeding) for each in tried], rel=1e-6)


def test_what_the_network_does_not_carry_is_not_taken():
    line, _, timetable, profiles = start()
    weak = replace(network(), substations=(replace(network().substations[0], resistance_ohm=0.2),))
    assert _energies_j(line, [(timetable, profiles)], weak).tolist() == [inf]
