"""The DC network: closed forms, root finding, a balance, diodes, inverters, limits of trains."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import root

from metropilot.errors import Infeasible, InputError
from metropilot.operation import TrainLoads, solve_network
from metropilot.railway import Feeding, Substation, load_feeding


def feeding(*substations, **more):
    given = {"conductor_ohm_per_m": 1e-5, "running_ohm_per_m": 1.5e-5} | more
    return Feeding(id="drawn", name="drawn", line_id="none", substations=substations, **given)


def substation(position_m, **more):
    return Substation(position_m=float(position_m), **({"no_load_v": 850.0, "resistance_ohm": 0.02} | more))


def loads(*trains, second=0):
    """Trains of one second by place, power, and direction where it is backward."""
    place, power, backward = zip(*((*t, False)[:3] for t in trains), strict=True)
    count = len(trains)
    return TrainLoads(
        np.full(count, second),
        np.arange(count),
        np.array(backward),
        np.array(place, dtype=float),
        np.array(power, dtype=float),
    )


def test_one_train_is_the_root_of_a_quadratic():
    network = feeding(substation(0))
    flow = solve_network(network, loads((1200.0, 2e6)), 1)
    ohm = 0.02 + 1200.0 * 2.5e-5
    at_v = (850.0 + np.sqrt(850.0**2 - 4.0 * ohm * 2e6)) / 2.0
    assert flow.train_v == pytest.approx([at_v], abs=1e-6)
    amps = 2e6 / at_v
    assert flow.rectifier_w[0] == pytest.approx([850.0 * amps], rel=1e-9)
    assert flow.rail_loss_w == pytest.approx([0.03 * amps**2], rel=1e-9)
    assert flow.substation_loss_w[0] == pytest.approx([0.02 * amps**2], rel=1e-9)


def test_a_train_between_two_substations_is_fed_over_both_tracks():
    # by symmetry each half: own track 500 m to each side; the other track joins the two equal voltages
    network = feeding(substation(0), substation(1000.0))
    flow = solve_network(network, loads((500.0, 2e6)), 1)
    ohm = (0.02 + 500.0 * 2.5e-5) / 2.0
    assert flow.train_v == pytest.approx([(850.0 + np.sqrt(850.0**2 - 8e6 * ohm)) / 2.0], abs=1e-6)
    # at a quarter of the way the current of the own track divides as over a wheatstone bridge
    flow = solve_network(network, loads((250.0, 2e6)), 1)
    other, near, far = 1000.0 * 2.5e-5, 250.0 * 2.5e-5, 750.0 * 2.5e-5
    # delta of the rails (near, far, other) as a star, its arms behind the two inner resistances
    total = other + near + far
    left, right = 0.02 + near * other / total, 0.02 + far * other / total
    ohm = near * far / total + left * right / (left + right)
    assert flow.train_v == pytest.approx([(850.0 + np.sqrt(850.0**2 - 8e6 * ohm)) / 2.0], abs=1e-6)


def test_a_ladder_of_equal_steps_obeys_its_recurrence():
    # trains every 400 m on a stub, currents added up from the far end: v[k+1] = v[k] - r i[k]
    count, step_ohm = 7, 400.0 * 2.5e-5
    network = feeding(substation(0))
    trains = [(400.0 * (k + 1), 1.5e5 + 2e4 * k) for k in range(count)]
    flow = solve_network(network, loads(*trains), 1)
    amps = flow.train_w / flow.train_v
    assert flow.train_w == pytest.approx([power for _, power in trains], rel=1e-12)
    beyond = np.cumsum(amps[::-1])[::-1]
    expected = 850.0 - 0.02 * beyond[0] - np.cumsum(step_ohm * beyond)
    assert flow.train_v == pytest.approx(expected, abs=1e-7)


def test_a_diode_takes_no_current_back():
    # a braking train next to the first substation feeds a drawing one next to the second
    network = feeding(substation(0), substation(1000.0, no_load_v=830.0), squeezed_above_v=880.0)
    flow = solve_network(network, loads((10.0, -1.5e6), (990.0, 1.2e6)), 1)
    assert flow.substation_v[0, 0] > 850.0
    assert flow.rectifier_w[0, 0] == 0.0
    assert (flow.rectifier_w >= 0.0).all()
    assert flow.train_v[0] > flow.train_v[1]
    alone = solve_network(network, loads((10.0, -1.5e6)), 1)
    assert alone.supplied_j == 0.0
    assert alone.returned_j == pytest.approx(0.0, abs=1e-3)
    assert alone.train_v == pytest.approx([network.max_v])


def test_a_braking_train_is_squeezed_linearly_between_two_voltages():
    network = feeding(substation(0), squeezed_above_v=860.0, max_v=900.0)
    flow = solve_network(network, loads((500.0, -2e6), (900.0, 1.5e6)), 1)
    at_v = flow.train_v[0]
    assert 860.0 < at_v < 900.0
    assert flow.train_w[0] == pytest.approx(-2e6 * (900.0 - at_v) / 40.0, rel=1e-9)
    # what it returns is drawn by the other one or lost on the 400 m between them
    amps = -flow.train_w[0] / at_v
    assert flow.train_v[1] == pytest.approx(at_v - 400.0 * 2.5e-5 * amps, abs=1e-6)
    assert flow.train_w[1] == pytest.approx(1.5e6)
    assert flow.offered_j == 2e6


def test_no_voltage_is_above_that_at_which_nothing_is_returned():
    # all trains brake and nobody draws: any voltage from 900 V on is balanced
    network = feeding(substation(0), substation(2000.0))
    trains = [(400.0 * k, -1e6 * k, bool(k % 2)) for k in range(1, 5)]
    flow = solve_network(network, loads(*trains), 1)
    assert flow.train_v.max() <= 900.0
    assert flow.substation_v.max() <= 900.0
    assert flow.returned_j == pytest.approx(0.0, abs=1.0)


def test_an_inverter_returns_power_to_the_grid():
    with_one = feeding(substation(0, inverter_v=855.0, inverter_ohm=0.05), squeezed_above_v=890.0)
    flow = solve_network(with_one, loads((300.0, -5e5)), 1)
    ohm = 0.05 + 300.0 * 2.5e-5
    # the train is a source of constant power behind this resistance: v = E + r P / v
    at_v = (855.0 + np.sqrt(855.0**2 + 4.0 * ohm * 5e5)) / 2.0
    assert flow.train_v == pytest.approx([at_v], abs=1e-6)
    assert flow.inverted_j == pytest.approx(855.0 * 5e5 / at_v, rel=1e-9)
    assert flow.supplied_j == 0.0
    assert abs(flow.imbalance) < 1e-9


def test_a_train_at_its_current_limit_lacks_power():
    network = feeding(substation(0), max_current_a=3000.0)
    flow = solve_network(network, loads((1000.0, 4e6)), 1)
    at_v = 850.0 - 3000.0 * (0.02 + 0.025)
    assert flow.train_v == pytest.approx([at_v], abs=1e-6)
    assert flow.lacking_w == pytest.approx([4e6 - 3000.0 * at_v], rel=1e-9)
    with pytest.raises(Infeasible, match=r"forward train 0 at 1000 m in second 0.*4000 kW"):
        flow.check_served()


def test_a_train_below_its_voltage_draws_on_the_reduced_limit():
    # 850 V behind 0.13 ohm cannot carry 3 MW: the limit falls from 6000 A at 550 V to 0 at 500 V
    network = feeding(substation(0))
    flow = solve_network(network, loads((4400.0, 3e6)), 1)
    at_v = flow.train_v[0]
    assert 500.0 < at_v < 550.0
    assert (850.0 - at_v) / 0.13 == pytest.approx(6000.0 * (at_v - 500.0) / 50.0, rel=1e-9)
    with pytest.raises(Infeasible) as error:
        flow.check_served()
    assert error.value.value == round(at_v, 1)


def many(seconds, trains, random, scale=1.0):
    count = seconds * trains
    return TrainLoads(
        np.repeat(np.arange(seconds), trains),
        np.tile(np.arange(trains), seconds),
        random.random(count) < 0.5,
        random.uniform(0.0, 22728.0, count),
        scale * random.uniform(-2.5e6, 2.5e6, count),
    )


def test_energy_is_neither_made_nor_lost():
    network = load_feeding("yizhuang")
    inverters = tuple(replace(s, inverter_v=865.0) for s in network.substations[::3])
    for of in (network, replace(network, substations=inverters)):
        flow = solve_network(of, many(300, 9, np.random.default_rng(2), 1.5), 300)
        assert abs(flow.imbalance) < 1e-9
        for part in (flow.rectifier_w, flow.inverter_w, flow.substation_loss_w, flow.rail_loss_w):
            assert part.min() >= 0.0
        assert flow.train_v.max() <= of.max_v + 1e-6
        assert (np.abs(flow.train_w) <= np.abs(flow.loads.power_w) * (1.0 + 1e-12)).all()
        into = flow.rectifier_w.sum(axis=1) - flow.inverter_w.sum(axis=1) - flow.substation_loss_w.sum(axis=1)
        trains_w = np.bincount(flow.loads.second, flow.train_w, 300)
        assert into - flow.rail_loss_w == pytest.approx(trains_w, abs=1.0)


@pytest.mark.parametrize(
    ("steep", "near"),
    [
        ({"resistance_ohm": 1e-8}, {"resistance_ohm": 1e-6}),
        ({"inverter_v": 865.0, "inverter_ohm": 1e-8}, {"inverter_v": 865.0, "inverter_ohm": 1e-6}),
        ({"squeezed_above_v": 899.999}, {"squeezed_above_v": 899.99}),
    ],
)
def test_steep_elements_turn_the_rounding_of_voltages_into_current(steep, near):
    among, flows = many(60, 9, np.random.default_rng(2)), []
    for change in (steep, near):
        network = load_feeding("yizhuang")
        if "squeezed_above_v" in change:
            network = replace(network, **change)
        else:
            network = replace(network, substations=tuple(replace(s, **change) for s in network.substations))
        flows.append(solve_network(network, among, 60))
    found, other = flows
    assert abs(found.imbalance) < 1e-7
    assert found.is_served.all()
    assert found.train_v == pytest.approx(other.train_v, abs=0.05)


def test_a_second_does_not_depend_on_its_neighbours():
    network, among = load_feeding("yizhuang"), many(40, 6, np.random.default_rng(3))
    together = solve_network(network, among, 40)
    for second in (0, 17, 39):
        rows = among.second == second
        alone = among.part(np.flatnonzero(rows))._replace(second=np.zeros(6, dtype=int))
        assert solve_network(network, alone, 1).train_v == pytest.approx(together.train_v[rows], abs=1e-5)
    mixed = np.random.default_rng(4).permutation(among.second.size)
    again = solve_network(network, among.part(mixed), 40)
    assert again.train_v == pytest.approx(together.train_v[mixed], abs=1e-5)


def test_seconds_beyond_one_chunk_and_without_trains_are_solved(monkeypatch):
    from metropilot.operation import network as module

    among = many(30, 5, np.random.default_rng(5))
    among = among._replace(second=2 * among.second + 3)
    whole = solve_network(load_feeding("yizhuang"), among, 70)
    monkeypatch.setattr(module, "CHUNK", 7)
    parts = solve_network(load_feeding("yizhuang"), among, 70)
    assert parts.train_v == pytest.approx(whole.train_v, abs=1e-5)
    assert parts.rectifier_w.shape == (70, 11)
    assert parts.rectifier_w[0].sum() == 0.0


def test_a_second_without_solution_names_its_train(monkeypatch):
    from metropilot.operation import network as module

    monkeypatch.setattr(module, "MOST_STEPS", 1)
    among = many(3, 4, np.random.default_rng(6), 0.0)._replace(power_w=np.repeat([0.0, 2e6, 0.0], 4))
    with pytest.raises(Infeasible, match=r"train \d at \d+ m in second 1,") as error:
        solve_network(load_feeding("yizhuang"), among, 3)
    assert error.value.unit == "V"


def test_a_heavy_load_has_the_voltages_that_root_finding_finds():
    # currents of the elements written again, one network of three substations with the limits at work
    network = feeding(*(substation(x) for x in (0.0, 2000.0, 4000.0)), max_current_a=5000.0)
    trains = [(900.0, 4e6, False), (1400.0, 3e6, True), (2600.0, -2e6, False), (3300.0, 3.5e6, True)]
    flow = solve_network(network, loads(*trains), 1)
    ohm = 2.5e-5
    links = [(0, 3, 900), (3, 1, 1100), (0, 4, 1400), (4, 1, 600)]
    links += [(1, 5, 600), (5, 2, 1400), (1, 6, 1300), (6, 2, 700)]

    def draw(power_w, v):
        if power_w < 0.0:
            return power_w / v * min(max((900.0 - v) / 30.0, 0.0), 1.0)
        return min(power_w / v, 5000.0 * min(max((v - 500.0) / 50.0, 0.0), 1.0))

    def currents(v):
        out = [-max(850.0 - each, 0.0) / 0.02 for each in v[:3]]
        out += [draw(power_w, each) for (_, power_w, _), each in zip(trains, v[3:], strict=True)]
        for a, b, metres in links:
            out[a] += (v[a] - v[b]) / (ohm * metres)
            out[b] += (v[b] - v[a]) / (ohm * metres)
        return out

    found = root(currents, np.full(7, 800.0), tol=1e-12)
    assert found.success
    assert np.concatenate([flow.substation_v[0], flow.train_v]) == pytest.approx(found.x, abs=1e-5)
    assert flow.lacking_w.max() > 0.0


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"resistance_ohm": -0.01}, "resistance_ohm"),
        ({"resistance_ohm": 0.0}, "resistance_ohm"),
        ({"no_load_v": -1.0}, "no_load_v"),
        ({"inverter_v": 800.0}, "inverter_v"),
    ],
)
def test_a_bad_substation_is_named(change, field):
    with pytest.raises(InputError) as error:
        substation(0, **change)
    assert error.value.field == field


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"substations": ()}, "substations"),
        ({"substations": (substation(5), substation(5))}, "substations[1].position"),
        ({"conductor_ohm_per_m": -1e-5}, "conductor_ohm_per_m"),
        ({"reduced_below_v": 450.0}, "reduced_below_v"),
        ({"squeezed_above_v": 849.0}, "squeezed_above_v"),
        ({"max_v": 860.0}, "squeezed_above_v"),
    ],
)
def test_a_bad_feeding_is_named(change, field):
    with pytest.raises(InputError) as error:
        replace(load_feeding("yizhuang"), **change)
    assert error.value.field == field


def test_the_balance_of_a_network_where_all_is_squeezed_is_rounding():
    flow = solve_network(feeding(substation(0)), loads((500.0, -1e6)), 1)
    assert flow.returned_j < 1e-3
    assert abs(flow.imbalance) < 1e-9


def test_the_least_resistances_balance():
    least = {"resistance_ohm": 1e-8, "inverter_v": 860.0, "inverter_ohm": 1e-8}
    network = feeding(
        substation(0, **least),
        substation(1000.0, **least),
        conductor_ohm_per_m=1e-9,
        running_ohm_per_m=0.0,
    )
    flow = solve_network(network, loads((200.0, 3e6), (200.2, 3e6, True), (700.0, -2e6)), 1)
    assert abs(flow.imbalance) < 1e-7
    assert flow.train_v == pytest.approx([850.0] * 3, abs=0.1)
