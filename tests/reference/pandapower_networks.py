"""Draw DC networks with trains and solve them with pandapower: the goldens of the network solver.

    python tests/reference/pandapower_networks.py tests/reference/pandapower_networks.json

needs NumPy, SciPy and pandapower, in an environment of its own, and nothing of metropilot. A network of
resistances and constant powers has the same equations as a three-phase one without reactance and reactive
power: pandapower's Newton-Raphson solves it. What it does not have is found around it: how much a braking
train returns at its voltage, by SciPy's root finding, and which rectifiers and inverters work.
"""

import json
import sys
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandapower as pp
from scipy.optimize import root

SEED, COUNT = 21, 20
NOMINAL_KV = 0.75
MOST_RUNS = 60


def draw(random):
    """Draw a network: substations, rails, limits, trains."""
    count = int(random.integers(2, 7))
    place = np.cumsum(random.uniform(900.0, 2900.0, count))
    stations = [
        {
            "position_m": round(float(x), 1),
            "no_load_v": round(float(random.uniform(820.0, 860.0)), 1),
            "resistance_ohm": round(float(random.uniform(0.008, 0.03)), 5),
            "inverter_v": round(float(random.uniform(861.0, 866.0)), 1) if random.random() < 0.5 else None,
            "inverter_ohm": round(float(random.uniform(0.02, 0.05)), 5),
        }
        for x in place
    ]
    # trains stand at least 5 m from each other and from substations, some beyond the last substations
    ground = np.arange(place[0] - 800.0, place[-1] + 800.0, 5.0) + 2.3
    ground = ground[np.abs(ground[:, None] - place).min(axis=1) > 3.0]
    trains = [
        {
            "position_m": round(float(x), 1),
            "backward": bool(random.random() < 0.5),
            "power_w": round(float(random.uniform(-3e6, 3e6))),
        }
        for x in random.choice(ground, int(random.integers(2, 2 * count + 2)), replace=False)
    ]
    return {
        "substations": stations,
        "conductor_ohm_per_m": round(float(random.uniform(6e-6, 12e-6)), 8),
        "running_ohm_per_m": round(float(random.uniform(8e-6, 2e-5)), 8),
        "squeezed_above_v": round(float(random.uniform(862.0, 880.0)), 1),
        "max_v": round(float(random.uniform(890.0, 920.0)), 1),
        "trains": trains,
    }


def build(network):
    """Build the pandapower network; all substations can conduct and invert, no train is squeezed."""
    net = pp.create_empty_network(sn_mva=1.0)
    stations, trains = network["substations"], network["trains"]
    count = len(stations) + len(trains)
    # buses: substations, trains, sources behind the inner resistances of rectifiers and inverters
    buses = pp.create_buses(net, count + 2 * len(stations), vn_kv=NOMINAL_KV)
    station_bus, train_bus, sources = np.split(buses, [len(stations), count])
    inner = [("no_load_v", "resistance_ohm"), ("inverter_v", "inverter_ohm")]
    links = []
    for k, (volt, ohm) in enumerate((s[v], s[r]) for v, r in inner for s in stations):
        pp.create_ext_grid(net, sources[k], vm_pu=(volt or 1.0) / (1000.0 * NOMINAL_KV))
        links.append((sources[k], station_bus[k % len(stations)], 1.0, ohm))
    ohm_per_km = 1000.0 * (network["conductor_ohm_per_m"] + network["running_ohm_per_m"])
    for backward in (False, True):
        nodes = [(s["position_m"], station_bus[k]) for k, s in enumerate(stations)]
        nodes += [(t["position_m"], train_bus[k]) for k, t in enumerate(trains) if t["backward"] == backward]
        nodes.sort()
        links += [(a, b, (y - x) / 1000.0, ohm_per_km) for (x, a), (y, b) in pairwise(nodes)]
    begin, end, km, ohm = zip(*links, strict=True)
    pp.create_lines_from_parameters(
        net, begin, end, length_km=km, r_ohm_per_km=ohm, x_ohm_per_km=0.0, c_nf_per_km=0.0, max_i_ka=100.0
    )
    pp.create_loads(net, train_bus, p_mw=0.0)
    return net, station_bus, train_bus


def solve(network):
    """Voltages of substations and trains; None where the iteration finds none."""
    stations, trains = network["substations"], network["trains"]
    low, high = network["squeezed_above_v"], network["max_v"]
    power_mw = np.array([t["power_w"] / 1e6 for t in trains])
    no_load_v = np.array([s["no_load_v"] for s in stations])
    inverter_v = np.array([s["inverter_v"] or np.inf for s in stations])
    net, station_bus, train_bus = build(network)
    count, returns = len(stations), power_mw < 0.0
    working = np.repeat([True, False], count)
    returned_mw = power_mw[returns]

    runs = 0

    def voltages(returned_mw):
        nonlocal runs
        runs += 1
        if runs > MOST_RUNS:
            raise pp.LoadflowNotConverged
        net.load.loc[returns, "p_mw"] = returned_mw
        pp.runpp(net, algorithm="nr", init="flat", tolerance_mva=1e-10, max_iteration=40, numba=False)
        return 1000.0 * NOMINAL_KV * net.res_bus.vm_pu.to_numpy()

    def contradiction(returned_mw):
        share = np.clip((high - voltages(returned_mw)[train_bus][returns]) / (high - low), 0.0, 1.0)
        return share * power_mw[returns] - returned_mw

    for _ in range(20):
        if not working.any():
            return None
        net.ext_grid["in_service"] = working
        net.line.loc[np.arange(2 * count), "in_service"] = working
        net.bus.loc[net.ext_grid.bus.to_numpy(), "in_service"] = working
        net.load["p_mw"] = power_mw
        try:
            if np.abs(contradiction(returned_mw)).max(initial=0.0) > 1e-9:
                returned_mw = root(contradiction, returned_mw, tol=1e-12, options={"maxfev": 60}).x
            if np.abs(contradiction(returned_mw)).max(initial=0.0) > 1e-8:
                return None
            at_v = voltages(returned_mw)
        except pp.LoadflowNotConverged:
            return None
        station_v, train_v = at_v[station_bus], at_v[train_bus]
        # by how much the voltage contradicts each state: the worst one changes
        over = np.concatenate([no_load_v - station_v, station_v - inverter_v])
        wrong = np.where(working, -over, over)
        worst = int(np.argmax(wrong))
        if wrong[worst] <= 0.0:
            return station_v, train_v
        working[worst] = not working[worst]
    return None


def main(path):
    """Write the networks that could be solved; go on where a file ends."""
    about = {
        "command": "python tests/reference/pandapower_networks.py tests/reference/pandapower_networks.json",
        "pandapower": version("pandapower"),
        "numpy": version("numpy"),
        "seed": SEED,
        "left out": "networks that the iteration does not solve, or with a voltage below 560 V",
    }
    kept = (
        json.loads(path.read_text()) if path.exists() else {"made_with": about | {"drawn": 0}, "networks": []}
    )
    while len(kept["networks"]) < COUNT:
        network = draw(np.random.default_rng([SEED, kept["made_with"]["drawn"]]))
        kept["made_with"]["drawn"] += 1
        solution = solve(network)
        if solution is not None and min(each.min() for each in solution) > 560.0:
            station_v, train_v = (each.tolist() for each in solution)
            kept["networks"].append(network | {"substation_v": station_v, "train_v": train_v})
        path.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
