"""A line fed by a network: its trains second by second, and the network's energy beside that of zones."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.operation.lines import TRAINSET, short_line

from metropilot.errors import Infeasible, InputError
from metropilot.operation import LineOperation, OperationOptions, feed_line, solve_network, train_loads
from metropilot.railway import Substation, load_feeding


def operation(**given):
    options = {"zones": 1, "headway_s": 100, "transfer_loss": 0.0} | given
    return LineOperation(short_line(4), TRAINSET, OperationOptions(**options))


@cache
def profiles():
    return operation().profiles("cruise")


@cache
def network():
    """Substations of the first four stations of Yizhuang."""
    feeding = load_feeding("yizhuang")
    return replace(feeding, substations=feeding.substations[:4])


@pytest.mark.parametrize("offset_s", [31.0, 44.25])
def test_the_loads_have_the_energy_of_the_trips(offset_s):
    line = operation()
    timetable = line.plain_timetable(offset_s)
    loads, seconds = train_loads(line, timetable, profiles())
    balance = line.energy(timetable, profiles())
    assert seconds == 100
    assert loads.power_w.sum() == pytest.approx(balance.drawn_j - balance.returned_j, rel=1e-9)
    # auxiliaries take from the train's own brake first
    assert np.maximum(loads.power_w, 0.0).sum() < balance.drawn_j
    assert set(loads.second.tolist()) == set(range(100))


def test_trains_are_where_their_trips_are():
    line = operation()
    timetable = line.plain_timetable(0.0)
    loads, _ = train_loads(line, timetable, profiles(), ((0,), (0,)))
    stations = [each.position_m for each in line.line.stations]
    for backward in (False, True):
        rows = loads.backward == backward
        place_m = loads.position_m[rows]
        moved_m = np.diff(place_m) * (-1.0 if backward else 1.0)
        assert moved_m.min() >= 0.0
        assert moved_m.max() < 80.0 / 3.6
        assert place_m[[0, -1]] == pytest.approx(sorted(stations)[:: 3 * (-1 if backward else 1)], abs=1.0)
        first = line.count * backward
        arrival_s = int(timetable.arrival_s[first])
        standing = loads.position_m[rows][arrival_s : arrival_s + 29]
        assert standing == pytest.approx(stations[2 if backward else 1], abs=0.5)
        assert loads.power_w[rows][arrival_s + 1 : arrival_s + 29] == pytest.approx(TRAINSET.auxiliary_w)


def test_a_day_of_even_departures_repeats_the_headway():
    line = operation()
    timetable = line.plain_timetable(31.0)
    periodic = feed_line(line, timetable, profiles(), network()).flow
    # seconds of a day count from its first departure, at 0; after 700 s every train of a headway is there
    starts = range(0, 2000, 100), range(31, 2000, 100)
    loads, seconds = train_loads(line, timetable, profiles(), starts)
    day = solve_network(network(), loads, seconds)
    assert day.rectifier_w[900:1000].sum() == pytest.approx(periodic.supplied_j, rel=1e-9)
    assert day.rail_loss_w[1000:1100] == pytest.approx(day.rail_loss_w[900:1000], rel=1e-6)
    assert day.rail_loss_w[900:1000] == pytest.approx(periodic.rail_loss_w, rel=1e-6)


def test_a_network_without_losses_is_one_zone():
    line = operation()
    timetable = line.plain_timetable(31.0)
    ideal = replace(
        network(),
        substations=(Substation(position_m=0.0, no_load_v=850.0, resistance_ohm=1e-5),),
        conductor_ohm_per_m=1e-9,
        running_ohm_per_m=0.0,
        max_current_a=1e5,
    )
    found = feed_line(line, timetable, profiles(), ideal)
    assert found.energy_kwh == pytest.approx(line.energy(timetable, profiles()).supplied_kwh, rel=2e-3)
    assert found.energy_kwh < feed_line(line, timetable, profiles(), network()).energy_kwh


def test_the_parts_of_the_report_add_up():
    line = operation()
    told = feed_line(line, line.plain_timetable(31.0), profiles(), network()).as_dict()
    losses = told["rail_loss_kwh"] + told["substation_loss_kwh"]
    assert told["supplied_kwh"] + told["returned_kwh"] == pytest.approx(told["drawn_kwh"] + losses, rel=1e-9)
    assert sum(each["supplied_kwh"] for each in told["substations"]) == pytest.approx(told["supplied_kwh"])
    assert told["peak_w"] < sum(each["peak_w"] for each in told["substations"])
    assert 500.0 < told["lowest_v"] < min(each["lowest_v"] for each in told["substations"])
    assert told["highest_v"] <= network().max_v


def test_an_inverter_takes_what_is_squeezed():
    line = operation()
    timetable = line.plain_timetable(31.0)
    plain = feed_line(line, timetable, profiles(), network()).as_dict()
    each = {"inverter_v": 851.0, "inverter_ohm": 0.01}
    with_them = replace(network(), substations=tuple(replace(s, **each) for s in network().substations))
    told = feed_line(line, timetable, profiles(), with_them).as_dict()
    assert plain["squeezed_kwh"] > 0.0
    assert told["squeezed_kwh"] < 0.5 * plain["squeezed_kwh"]
    assert told["inverted_kwh"] > 0.0
    assert told["energy_kwh"] < plain["energy_kwh"]


def test_a_weak_network_names_train_second_and_voltage():
    line = operation()
    weak = replace(network(), substations=(replace(network().substations[0], resistance_ohm=0.2),))
    with pytest.raises(Infeasible, match=r"(for|back)ward train \d+ at \d+ m in second \d+") as error:
        feed_line(line, line.plain_timetable(31.0), profiles(), weak)
    assert error.value.unit == "V"
    assert weak.cut_off_v <= error.value.value < 850.0


def test_a_substation_off_the_line_is_named():
    line = operation()
    with pytest.raises(InputError, match=r"substation off the line: YZQ.*8254 m \(allowed: 0 to 6272 m\)"):
        feed_line(line, line.plain_timetable(0.0), profiles(), load_feeding("yizhuang"))
