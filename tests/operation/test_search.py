"""The search for a timetable: within its windows, never below the floor, better than the plain timetable."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.operation.lines import TRAINSET, short_line

from metropilot.operation import (
    LineOperation,
    OperationOptions,
    best_offset,
    choose_plans,
    find_timetable,
    operation_energy,
)
from metropilot.operation.search import _find_shortest, _plain, _Score, timetable_of


def operation(**given):
    options = {"zones": 2, "headway_s": 240, "time_window_s": 2} | given
    return LineOperation(short_line(5), TRAINSET, OperationOptions(**options))


@cache
def profiles():
    return operation().profiles(windows=True)


def test_cells_add_up_to_the_exact_energy_of_a_moved_timetable():
    line = operation(headway_s=100)
    score, state = _Score(line, [profiles()]), _plain(line)
    state.offset = 37
    state.running[[0, 1]] += 2, -2
    state.dwell[[4, 6]] += 7, -7
    exact_j = line.energy(timetable_of(line, state), profiles()).supplied_j
    # means of a cell hide what crosses zero within it, and nothing else
    assert score(state) == pytest.approx(exact_j, rel=2e-3)
    assert score(state) <= exact_j * (1.0 + 1e-9)


@pytest.mark.parametrize(("headway_s", "zones"), [(120, 4), (150, 4)])
def test_the_best_offset_is_that_of_trying_every_second(headway_s, zones):
    line = operation(headway_s=headway_s, zones=zones)
    planned = [{t.planned_s: p[t.planned_s]} for t, p in zip(line.trips, profiles(), strict=True)]
    exact = [line.energy(line.plain_timetable(float(k)), planned).supplied_j for k in range(headway_s)]
    found = line.energy(best_offset(line, planned), planned).supplied_j
    assert found == pytest.approx(min(exact), rel=2e-9)
    assert max(exact) > 1.002 * min(exact)


def test_of_offsets_that_are_as_good_the_first_is_taken():
    line = operation(headway_s=90, zones=1)
    planned = [{t.planned_s: p[t.planned_s]} for t, p in zip(line.trips, profiles(), strict=True)]
    energies = [line.energy(line.plain_timetable(float(k)), planned).supplied_j for k in range(90)]
    assert energies == pytest.approx([energies[0]] * 90, rel=1e-9), "one zone receives everything"
    assert best_offset(line, planned).departure_s[line.count] == 0.0


@pytest.mark.parametrize(("headway_s", "zones"), [(90, 1), (240, 2), (600, 4)])
def test_a_timetable_found_keeps_windows_and_sums_and_stays_above_the_floor(headway_s, zones):
    line = operation(headway_s=headway_s, zones=zones)
    plain = best_offset(line, profiles())
    found, driven = find_timetable(line, [profiles()], moves=1500, restarts=1)
    assert driven == profiles()
    energy, before = (line.energy(each, profiles()).supplied_j for each in (found, plain))
    assert line.floor_j(profiles()) <= energy <= before
    assert (found.departure_s == np.round(found.departure_s)).all()
    dwell = line.dwells_s(found)
    for at in (slice(0, line.count), slice(line.count, None)):
        assert found.running_time_s[at].sum() == line.planned_s[at].sum()
        assert dwell[at].sum() == (line.count - 1) * line.options.dwell_s
        assert np.abs(dwell[at][:-1] - line.options.dwell_s).max() <= line.options.dwell_window_s
        assert np.abs(found.running_time_s[at] - line.planned_s[at]).max() <= 2


def test_a_search_is_repeated_by_its_seed():
    line = operation()
    once, again = (find_timetable(line, [profiles()], seed=3, moves=300, restarts=2)[0] for _ in range(2))
    assert (once.departure_s == again.departure_s).all()
    assert (once.running_time_s == again.running_time_s).all()


def test_a_search_at_planned_running_times_leaves_them():
    line = operation(time_window_s=0, dwell_window_s=0)
    planned = [{t.planned_s: p[t.planned_s]} for t, p in zip(line.trips, profiles(), strict=True)]
    found, _ = find_timetable(line, [planned], moves=200, restarts=1)
    assert (found.running_time_s == line.planned_s).all()
    assert np.unique(line.dwells_s(found)).tolist() == [0.0, 30.0]


def test_energies_are_in_order():
    line = LineOperation(short_line(4), TRAINSET, OperationOptions(zones=3, headway_s=240, time_window_s=0))
    found = operation_energy(line, searched=True)
    assert found.floor_kwh <= found.energy_kwh < found.driving_only_kwh < found.cruise_kwh
    assert found.energy_kwh < found.timetable_only_kwh < found.cruise_kwh
    assert found.gap_percent == pytest.approx(100 * (found.energy_kwh / found.floor_kwh - 1))


def test_the_shortest_path_is_the_best_of_all_offsets_and_dwells():
    line = LineOperation(
        short_line(3), TRAINSET, OperationOptions(zones=2, headway_s=150, dwell_window_s=2, dwell_s=30)
    )
    plans = [line.profiles(received_w=power_w) for power_w in (np.inf, 120e3)]
    score = _Score(line, plans)
    state = _find_shortest(score)
    energies = []
    for offset, *plan in np.ndindex(150, 2, 2, 2, 2):
        energies.append(score(replace(_plain(line), offset=offset, plan=np.array(plan))))
    # with one station on the way both sums fix its dwells
    assert state.dwell.tolist() == _plain(line).dwell.tolist()
    assert score(state) == pytest.approx(min(energies), rel=1e-12)


def test_the_shortest_path_keeps_the_sums_of_dwells():
    line = operation(zones=4, headway_s=300)
    plans = [line.profiles(received_w=power_w) for power_w in (np.inf, 120e3)]
    score = _Score(line, plans)
    found, plain = _find_shortest(score), _plain(line)
    changed = found.dwell - plain.dwell
    assert changed[: line.count].sum() == changed[line.count :].sum() == 0
    assert 0 < np.abs(changed).max() <= line.options.dwell_window_s
    offsets = [score(replace(plain, offset=offset, plan=found.plan)) for offset in range(300)]
    assert score(found) < 0.998 * min(offsets)


def test_a_trip_whose_energy_nobody_receives_is_driven_to_draw_least():
    quiet = replace(TRAINSET, auxiliary_w=0.0)
    line = LineOperation(short_line(3), quiet, OperationOptions(zones=2, headway_s=7200))
    plans = [line.profiles(received_w=power_w) for power_w in (np.inf, 0.0)]
    alone = line.plain_timetable(3600.0)
    chosen, energy_j = choose_plans(line, alone, plans)
    assert all(a is b for a, b in zip(chosen, plans[1], strict=True))
    assert energy_j == line.energy(alone, plans[1]).supplied_j < line.energy(alone, plans[0]).supplied_j
