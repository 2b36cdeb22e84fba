"""The DC network against pandapower's solutions of 20 drawn networks."""

import json
from pathlib import Path

import numpy as np
import pytest

from metropilot.operation import TrainLoads, solve_network
from metropilot.railway import Feeding, Substation

DRAWN = json.loads((Path(__file__).parents[1] / "reference" / "pandapower_networks.json").read_text())


def feeding(of):
    names = ("conductor_ohm_per_m", "running_ohm_per_m", "squeezed_above_v", "max_v")
    # the limits of drawing trains are out of the way
    return Feeding(
        id="drawn",
        name="drawn",
        line_id="none",
        substations=tuple(Substation(**each) for each in of["substations"]),
        **{name: of[name] for name in names},
        cut_off_v=300.0,
        reduced_below_v=320.0,
        max_current_a=1e5,
    )


def loads(of):
    count = len(of["trains"])
    names = ("backward", "position_m", "power_w")
    values = (np.array([each[name] for each in of["trains"]]) for name in names)
    backward, position_m, power_w = values
    return TrainLoads(np.zeros(count, dtype=int), np.arange(count), backward, position_m, power_w * 1.0)


@pytest.mark.parametrize("of", DRAWN["networks"])
def test_voltages_are_pandapowers(of):
    flow = solve_network(feeding(of), loads(of), 1)
    assert np.abs(flow.train_v - of["train_v"]).max() < 1e-4
    assert np.abs(flow.substation_v[0] - of["substation_v"]).max() < 1e-4
    assert abs(flow.imbalance) < 1e-9


def test_the_drawn_networks_have_every_kind_of_element_at_work():
    networks = DRAWN["networks"]
    assert len(networks) == 20
    blocked = inverting = squeezed = 0
    for of in networks:
        for voltage_v, each in zip(of["substation_v"], of["substations"], strict=True):
            blocked += voltage_v > each["no_load_v"]
            inverting += each["inverter_v"] is not None and voltage_v > each["inverter_v"]
        for voltage_v, each in zip(of["train_v"], of["trains"], strict=True):
            squeezed += voltage_v > of["squeezed_above_v"] and each["power_w"] < 0.0
    assert min(blocked, inverting, squeezed) >= 2
