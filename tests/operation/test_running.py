"""A line while it runs: undisturbed it is its timetable; delays die away, and no train meets another."""

import pytest
from tests.operation.lines import TRAINSET, short_line

from metropilot.errors import InputError
from metropilot.operation import (
    LineOperation,
    OperationOptions,
    RunningLine,
    SlowSection,
    TrainHold,
    operation_energy,
)
from metropilot.railway import load_line, load_trainset
from metropilot.units import J_PER_KWH


@pytest.fixture(scope="module")
def found():
    return operation_energy(LineOperation(short_line(6), TRAINSET, OperationOptions(headway_s=180)))


def run(line, seconds):
    """Let time pass; return the smallest gap between two trains."""
    least_m = 1e9
    for _ in range(seconds):
        line.advance()
        least_m = min([least_m, *line.gaps_m()])
    return least_m


def test_undisturbed_it_is_its_timetable(found):
    line = RunningLine(found)
    assert len(line.trains) == found.operation.fleet(found.timetable)
    before = sorted(line.positions_m)
    assert run(line, 180) > 500.0
    # after a headway every train is where the one ahead of it was
    assert sorted(line.positions_m) == pytest.approx(before, abs=1e-3)
    told = line.as_dict()
    assert (told["waits"], told["stops"], line.pop_news()) == (0, 0, [])
    assert told["largest_delay_s"] == pytest.approx(0.0, abs=1e-3)
    assert told["energy_kwh"] == pytest.approx(found.energy_kwh, rel=2e-3)
    assert line.floor_j == pytest.approx(found.floor_kwh * J_PER_KWH)
    assert told["gap_percent"] == pytest.approx(100.0 * (found.energy_kwh / found.floor_kwh - 1.0), abs=0.2)


def test_the_gap_is_that_of_whole_headways(found):
    """Within a headway the power swings: a minute may draw less than its share of the floor."""
    line = RunningLine(found)
    shown = []
    for _ in range(400):
        line.advance()
        shown.append(line.as_dict()["gap_percent"])
    assert shown[:179] == [None] * 179
    assert len(set(shown[179:359])) == len(set(shown[359:])) == 1
    assert shown[359] == pytest.approx(shown[179], abs=0.2)
    assert shown[179] > 0.0


@pytest.mark.parametrize("headway_s", [120, 180])
def test_where_all_is_received_energy_is_exactly_that_of_the_timetable(headway_s):
    """No second of a trip is left out, and auxiliaries are off in the turn-round alone."""
    options = OperationOptions(headway_s=headway_s, zones=1)
    found = operation_energy(LineOperation(short_line(6), TRAINSET, options))
    line = RunningLine(found)
    run(line, 2 * headway_s)
    assert found.energy_kwh == pytest.approx(found.floor_kwh, rel=1e-7), "one zone receives everything"
    assert line.as_dict()["energy_kwh"] == pytest.approx(2.0 * found.energy_kwh, rel=1e-9)


def test_a_train_that_is_held_delays_the_next_ones_and_all_recover(found):
    line = RunningLine(found)
    run(line, 100)
    words = line.hold(TrainHold(station="JG", hold_s=240.0))
    assert words.endswith("is held at Jiugong for 240 s")
    held = int(words.split()[1])
    assert run(line, 600) > 0.0
    assert max(line.delays_s) > 60.0
    late = [train.number for train in line.trains if train.delay_s > 5.0]
    assert held in late
    assert set(late) <= {(held - 1 + k) % line.fleet + 1 for k in range(4)}, "only those behind it"
    assert line.recovered_s is None
    assert run(line, 3000) > 0.0
    told = line.as_dict()
    assert told["recovered_s"] is not None
    assert told["recovered_s"] - told["disturbed_s"] < 3000.0
    assert 200.0 < told["largest_delay_s"] <= 245.0
    assert max(line.delays_s) < 5.0
    assert told["waits"] + told["stops"] > 0
    assert line.hardest_mps2 < 1.3
    words = [text for _, text in line.pop_news()]
    assert any("waits at" in text or "is stopped before" in text for text in words)
    assert words[-1].startswith("every train is on time again")
    assert told["energy_kwh"] > told["floor_kwh"]


def test_a_slow_section_delays_those_who_depart_meanwhile(found):
    line = RunningLine(found)
    trip = next(k for k, each in enumerate(found.operation.trips) if each.section.origin.code == "XHM")
    assert (
        line.slow(SlowSection(station="XHM", limit_mps=6.0, lasts_s=400.0))
        == f"{found.operation.trips[trip].section.name}: 22 km/h for 400 s"
    )
    fastest, seen = 0.0, []
    for _ in range(1500):
        line.advance()
        for train in line.trains:
            driven = train.motion is not None and train.trip == trip
            if driven and 5.0 < train.set_out_s < 395.0:
                _, speed = line._state(train, line.time_s)
                fastest = max(fastest, speed)
                seen.append(train.number)
    assert len(set(seen)) >= 2
    assert 5.0 < fastest <= 6.01
    assert line.largest_delay_s > 30.0


@pytest.mark.parametrize("headway_s", [100, 180])
def test_no_train_meets_another_whatever_is_held(headway_s):
    line, trainset = load_line("yizhuang"), load_trainset("dkz32")
    blocks = None if headway_s == 100 else 3
    options = OperationOptions(headway_s=headway_s, blocks=blocks)
    running = RunningLine(operation_energy(LineOperation(line, trainset, options)))
    least = run(running, 200)
    for code, seconds, backward in (("JHL", 240.0, False), ("RJ", 120.0, True), ("JG", 300.0, True)):
        running.hold(TrainHold(station=code, hold_s=seconds, backward=backward))
        least = min(least, run(running, 150))
    least = min(least, run(running, 900))
    assert least > 1.0
    assert running.hardest_mps2 < 1.3
    if blocks is None:
        assert running.stops > 0


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda line: line.hold(TrainHold(station="nowhere")), "station"),
        (lambda line: line.hold(TrainHold(station="WHY")), "station"),
        (lambda line: line.hold(TrainHold(station="JG", hold_s=0.0)), "hold_s"),
        (lambda line: line.slow(SlowSection(station="JG", limit_mps=0.1)), "limit_mps"),
        (lambda line: line.slow(SlowSection(station="JG", lasts_s=0.0)), "lasts_s"),
        (lambda line: line.slow(SlowSection(station="JG", limit_mps=80.0 / 3.6)), "limit_mps"),
    ],
)
def test_what_cannot_be_is_refused(found, call, field):
    line = RunningLine(found)
    with pytest.raises(InputError) as told:
        call(line)
    assert told.value.field == field
    assert line.disturbed_s is None
