"""Storages of a network: closed forms, room and energy, balances, and what they are worth."""

from dataclasses import replace

import numpy as np
import pytest
from tests.operation.test_feeding import network, operation, profiles
from tests.operation.test_network import feeding, substation

from metropilot.errors import InputError
from metropilot.operation import TrainLoads, feed_line, solve_network, train_loads
from metropilot.railway import Storage, load_feeding, load_line

KWH = 3.6e6


def storage(position_m=0.0, **more):
    usual = {"charge_above_v": 870.0, "discharge_below_v": 840.0, "resistance_ohm": 0.01}
    return Storage(position_m=position_m, name="S", **(usual | more))


def trains(*powers, place=500.0):
    """One train that stands, with a power every second."""
    count = len(powers)
    none = np.zeros(count, int)
    return TrainLoads(np.arange(count), none, none == 1, np.full(count, place), np.array(powers, float))


def test_a_storage_that_discharges_is_a_second_source():
    # alone at the train: (850 - v) / r + (840 - v) / 0.01 = p / v
    net = replace(feeding(substation(0)), storages=(storage(500.0, power_w=1e7),))
    flow = solve_network(net, trains(2e6), 1)
    ohm, v = 0.02 + 500.0 * 1.25e-5, flow.train_v[0]
    # at 500 m both tracks are tied: two tracks beside each other; nodes are half a metre apart at least
    assert (850.0 - v) / ohm + (840.0 - v) / 0.01 == pytest.approx(2e6 / v, rel=5e-3)
    assert flow.storage_w[0, 0] == pytest.approx(-v * (840.0 - v) / 0.01, rel=5e-3)


def test_it_takes_what_is_returned_up_to_its_power():
    net = replace(feeding(substation(0), squeezed_above_v=890.0), storages=(storage(500.0),))
    flow = solve_network(net, trains(-1e6), 1)
    assert flow.returned_j == pytest.approx(1e6)
    assert flow.storage_w[0, 0] == pytest.approx(1e6, rel=1e-4)
    assert flow.train_v[0] == pytest.approx(870.0 + 0.01 * 1e6 / flow.train_v[0], abs=0.05)
    small = solve_network(replace(net, storages=(storage(500.0, power_w=3e5),)), trains(-1e6), 1)
    assert small.storage_w[0, 0] == pytest.approx(3e5, rel=1e-9)
    assert small.train_v[0] > 890.0


def test_it_gives_no_more_than_it_has_and_takes_no_more_than_it_holds():
    full = storage(500.0, capacity_j=2e6, efficiency=0.9)
    net = replace(feeding(substation(0), squeezed_above_v=890.0), storages=(full,))
    powers = [-1e6] * 4 + [3e6] * 6
    flow = solve_network(net, trains(*powers), len(powers))
    energy, power = flow.storage_j[:, 0], flow.storage_w[:, 0]
    # half full at first: a megajoule of room
    assert energy[0] == 1e6
    assert energy.max() == pytest.approx(2e6)
    assert power[:4].sum() == pytest.approx(1e6 / 0.9, rel=1e-5)
    assert -power[4:].sum() == pytest.approx(0.9 * 2e6, rel=1e-5)
    gain = np.where(power > 0.0, 0.9 * power, power / 0.9)
    assert np.diff(energy) == pytest.approx(gain, abs=1.5)
    assert abs(flow.imbalance) < 1e-9


@pytest.mark.parametrize("aboard", [False, True])
def test_over_a_period_it_ends_as_it_begins(aboard):
    kept = storage(500.0, capacity_j=5e6)
    base = feeding(substation(0), squeezed_above_v=890.0)
    net = replace(base, onboard=kept) if aboard else replace(base, storages=(kept,))
    powers = [-1.5e6] * 5 + [0.0] * 3 + [2e6] * 9
    flow = solve_network(net, trains(*powers), len(powers), periodic=True)
    assert abs(flow.stored_j) < 1.0
    into = flow.onboard_w if aboard else flow.storage_w[:, 0]
    assert into.max() > 1e5
    assert -into[into < 0].sum() == pytest.approx(0.95**2 * into[into > 0].sum(), rel=1e-5)
    assert abs(flow.imbalance) < 1e-9
    assert flow.supplied_j < solve_network(base, trains(*powers), len(powers)).supplied_j


def test_storage_aboard_stays_with_its_train():
    # two trains in turn: what the first has stored is of no use to the second
    net = replace(feeding(substation(0), squeezed_above_v=890.0), onboard=storage(capacity_j=4e6))
    none, count = np.zeros(8, int), 8
    powers = np.array([-1e6] * 4 + [2.5e6] * 4)
    place = np.full(count, 500.0)
    alone = TrainLoads(np.arange(count), none, none == 1, place, powers)
    two = alone._replace(train=np.repeat([0, 1], 4))
    one_flow, two_flow = (solve_network(net, each, count) for each in (alone, two))
    assert -one_flow.onboard_w[4:].sum() == pytest.approx(0.95 * 4e6, rel=1e-5)
    assert -two_flow.onboard_w[4:].sum() == pytest.approx(0.95 * 2e6, rel=1e-5)


def line_and_loads():
    line = operation()
    return line, line.plain_timetable(31.0)


def test_a_line_with_storages_takes_less_and_balances():
    line, timetable = line_and_loads()
    plain = feed_line(line, timetable, profiles(), network())
    kept = storage(3000.0, charge_above_v=855.0, discharge_below_v=845.0, capacity_j=5 * KWH)
    beside = feed_line(line, timetable, profiles(), replace(network(), storages=(kept,)))
    aboard = feed_line(line, timetable, profiles(), replace(network(), onboard=kept))
    for found in (beside, aboard):
        assert abs(found.flow.imbalance) < 1e-9
        assert abs(found.flow.stored_j) < 1e-6 * found.flow.supplied_j
        assert found.energy_kwh < plain.energy_kwh
        told = found.as_dict()
        assert told["squeezed_kwh"] < plain.as_dict()["squeezed_kwh"]
        assert abs(told["storage_change_kwh"]) < 1e-3
    (one,) = beside.as_dict()["storages"]
    assert one["discharged_kwh"] == pytest.approx(0.95**2 * one["charged_kwh"], rel=1e-4)
    assert 0.0 <= one["lowest_kwh"] < one["highest_kwh"] <= 5.0 + 1e-9
    assert "storages" not in plain.as_dict()


def test_useless_storages_change_nothing():
    line, timetable = line_and_loads()
    never = storage(3000.0, charge_above_v=899.9, discharge_below_v=500.1)
    both = replace(network(), storages=(replace(never, position_m=6272.0),), onboard=never)
    at_v = [feed_line(line, timetable, profiles(), each).flow.train_v for each in (network(), both)]
    assert at_v[0] == pytest.approx(at_v[1], abs=1e-6)


def test_a_day_accounts_for_what_is_left_in_storages():
    line, timetable = line_and_loads()
    aboard = replace(network(), onboard=storage(charge_above_v=855.0, discharge_below_v=845.0))
    starts = range(0, 300, 100), range(31, 300, 100)
    flow = solve_network(aboard, *train_loads(line, timetable, profiles(), starts))
    assert abs(flow.stored_j) > 1e3
    assert abs(flow.imbalance) < 1e-9


TEXT = """
[storage]
units = { position = "m", capacity = "kWh", power = "kW", efficiency = "%", charge_above = "V" }
capacity = 10
power = 1500
efficiency = 95
charge_above = 865
list = [{ name = "S1", position = 3906 }, { name = "S2", position = 8254, power = 500 }]

[onboard_storage]
units = { capacity = "kWh", power = "kW" }
capacity = 2
power = 600
"""


def written(tmp_path, **changes):
    from importlib import resources

    text = (resources.files("metropilot.railway") / "catalogue/feedings/yizhuang.toml").read_text() + TEXT
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "mine.toml").write_text(text)
    return tmp_path / "mine.toml"


def test_a_file_has_storages_with_units(tmp_path):
    found = load_feeding(written(tmp_path))
    first, second = found.storages
    assert (first.name, first.position_m, first.capacity_j, first.power_w) == ("S1", 3906.0, 10 * KWH, 1.5e6)
    assert (second.power_w, second.charge_above_v, second.efficiency) == (5e5, 865.0, 0.95)
    assert (found.onboard.capacity_j, found.onboard.power_w) == (2 * KWH, 6e5)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("capacity = 10", "capacity = -10", r"storage\.capacity: .*-10 kWh"),
        (
            "charge_above = 865",
            "charge_above = 800",
            r"storage\.charge_above: .*above discharge_below, 820 V",
        ),
        ('capacity = "kWh", power = "kW" }', 'capacity = "kW", power = "kW" }', "onboard_storage"),
        ("power = 600", "pover = 600", "pover"),
        ("position = 3906 }", "position = 9906 }", r"must increase"),
    ],
)
def test_a_bad_storage_is_named(tmp_path, old, new, told):
    with pytest.raises(InputError, match=told) as error:
        load_feeding(written(tmp_path, change=(old, new)))
    assert "\n" not in str(error.value)


def test_a_storage_off_the_line_is_named(tmp_path):
    found = load_feeding(written(tmp_path, change=("position = 8254, power", "position = 98254, power")))
    with pytest.raises(InputError, match="storage off the line: S2"):
        found.check_line(load_line("yizhuang"))


def test_every_journey_of_a_day_has_a_storage_of_its_own():
    line, timetable = line_and_loads()
    loads, _ = train_loads(line, timetable, profiles(), (range(0, 300, 100), range(31, 300, 100)))
    parts = loads.journeys()
    assert len(parts) == 6
    for rows in parts:
        assert len(set(zip(loads.train[rows].tolist(), loads.backward[rows].tolist(), strict=True))) == 1
        assert (np.diff(loads.second[rows]) == 1).all()
