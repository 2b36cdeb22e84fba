"""``metropilot fit`` on logs of ALTRIOS, the train simulator of NREL, whose parameters are known.

ALTRIOS is no dependency of metropilot. Simulate in an environment of its own, fit in this one::

    python -m venv /tmp/altrios && /tmp/altrios/bin/pip install altrios
    /tmp/altrios/bin/python benchmarks/foreign.py simulate /tmp/altrios/logs
    python -m benchmarks.foreign fit /tmp/altrios/logs --write docs/fit.md

ALTRIOS follows a given speed and says which power that takes at the wheel: mean force of a step times its
mean speed. A log has the speed (with noise, quantised), that force, and the gradient. Every train is one
locomotive and some empty wagons on its `simple_corridor_network`.
"""

from __future__ import annotations

import argparse
import csv
import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

TRAINS = {"2 wagons": (2, 0.5e-4), "4 wagons": (4, 1.5e-4), "6 wagons": (6, 3.0e-4)}
"""Wagons, and linear resistance over weight, s/m."""
RUNS, STEP_S = 8, 0.5
NOISE_MPS, QUANTUM_KMH = 0.05, 0.1
TRAINSET, LOAD = "dkz32", "AW3"
NAMES = ("mass_factor", "davis_a_n", "davis_b_n_per_mps", "davis_c_n_per_mps2")


def draw_speeds(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a run: accelerate in two steps, hold, coast, brake. Times and speeds."""
    top = rng.uniform(12.0, 20.0)
    times = np.cumsum([0.0, *rng.uniform((15, 25, 10, 40, 25, 10), (25, 40, 40, 80, 40, 11))])
    speeds = np.array([0.0, 0.5 * top, top, top, top - rng.uniform(1.0, 3.0), 0.0, 0.0])
    grid = np.arange(0.0, times[-1], STEP_S)
    return grid, np.interp(grid, times, speeds)


def simulate(folder: Path) -> None:
    """Simulate every train with ALTRIOS: its logs, and its parameters as ``truth.json``."""
    import altrios  # pyright: ignore[reportMissingImports]

    folder.mkdir(parents=True, exist_ok=True)
    resources, truth = altrios.resources_root(), {}
    network = altrios.Network.from_file(resources / "networks/simple_corridor_network.yaml")
    path = altrios.LinkPath.from_csv_file(resources / "demo_data/link_points_idx_simple_corridor.csv")
    for number, (name, (wagons, linear)) in enumerate(TRAINS.items()):
        rng = np.random.default_rng(number)
        wagon = altrios.RailVehicle.from_file(resources / "rolling_stock/Manifest_Empty.yaml").to_pydict()
        wagon["davis_b_seconds_per_meter"] = linear
        config = altrios.TrainConfig(
            rail_vehicles=[altrios.RailVehicle.from_pydict(wagon)],
            n_cars_by_type={wagon["car_type"]: wagons},
            train_length_meters=None,
            train_mass_kilograms=None,
        )
        for run in range(RUNS):
            trace = folder / "trace.csv"
            rows = zip(*draw_speeds(rng), strict=True)
            write_csv(trace, ("time_seconds", "speed_meters_per_second"), rows)
            consist = altrios.Consist([altrios.Locomotive.default_battery_electric_loco()], 1)
            builder = altrios.TrainSimBuilder(train_id="0", train_config=config, loco_con=consist)
            driven = builder.make_set_speed_train_sim(
                network=network,
                link_path=path,
                speed_trace=altrios.SpeedTrace.from_csv_file(trace),
                save_interval=1,
            )
            driven.walk()
            rows = {key: np.array(column, dtype=float) for key, column in columns_of(driven).items()}
            write_log(folder / f"{name.replace(' ', '-')}-{run}.csv", rows, rng)
            truth[name] = parameters_of(rows)
            trace.unlink()
    about = {"altrios": version("altrios"), "trains": truth}
    (folder / "truth.json").write_text(json.dumps(about, indent=1))


def columns_of(driven: Any) -> dict[str, Any]:  # noqa: ANN401 (of ALTRIOS)
    """Recorded columns of a simulation."""
    return driven.to_pydict()["history"]


def parameters_of(rows: dict[str, np.ndarray]) -> dict[str, float]:
    """Parameters that ALTRIOS has simulated with: effective mass and Davis coefficients."""
    fast = int(np.argmax(rows["speed_meters_per_second"])) + 1
    v = rows["speed_meters_per_second"][fast - 1]
    return {
        "mass_kg": rows["mass_static_kilograms"][-1] + rows["mass_rot_kilograms"][-1],
        "davis_a_n": rows["res_rolling_newtons"][fast] + rows["res_bearing_newtons"][fast],
        "davis_b_n_per_mps": rows["res_davis_b_newtons"][fast] / v,
        "davis_c_n_per_mps2": rows["res_aero_newtons"][fast] / v**2,
    }


def write_log(file: Path, rows: dict[str, np.ndarray], rng: np.random.Generator) -> None:
    """Write one log: the force of a step stands in the row at which it begins."""
    speed = rows["speed_meters_per_second"]
    mean = 0.5 * (speed[1:] + speed[:-1])
    force_n = np.append(rows["pwr_whl_out_watts"][1:] / np.maximum(mean, 1e-6), 0.0)
    force_n[np.append(mean, 0.0) <= 0.0] = 0.0
    permil = 1000.0 * rows["res_grade_newtons"] / rows["weight_static_newtons"][-1]
    permil[0] = permil[1]
    kmh = 3.6 * np.where(speed > 0, np.maximum(speed + NOISE_MPS * rng.standard_normal(speed.size), 0.0), 0.0)
    kmh = QUANTUM_KMH * np.round(kmh / QUANTUM_KMH)
    columns = (rows["time_seconds"], kmh, force_n / 1000.0, permil)
    heads = ("time [s]", "speed [km/h]", "effort [kN]", "gradient [permil]")
    write_csv(file, heads, zip(*columns, strict=True))


def write_csv(file: Path, heads: tuple[str, ...], rows: Any) -> None:  # noqa: ANN401
    """Write rows with a header."""
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(heads)
        writer.writerows([[f"{x:.6g}" for x in row] for row in rows])


def fit(folder: Path, page: Path | None) -> None:
    """Fit every train from its logs, and compare."""
    from benchmarks.report import circumstances, replace_section
    from metropilot.fit import fit_trainset, read_log
    from metropilot.railway import load_trainset

    about, nominal = circumstances(("numpy", "scipy")), load_trainset(TRAINSET, LOAD)
    told = json.loads((folder / "truth.json").read_text())
    lines = [
        "| train | quantity | nominal | ALTRIOS | fitted | 95 % interval | error |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for name, truth in told["trains"].items():
        logs = [read_log(file) for file in sorted(folder.glob(f"{name.replace(' ', '-')}-*.csv"))]
        found = fit_trainset(logs, nominal, source="effort", resistance="coefficients")
        truth["mass_factor"] = truth["mass_kg"] / nominal.effective_mass_kg
        for key in NAMES:
            got, true = found[key], truth[key]
            shown = " | ".join(f"{x:.4g}" for x in (got.nominal, true, got.value))
            error = 100 * (got.value / true - 1)
            lines.append(f"| {name} | `{key}` | {shown} | {got.low:.4g} to {got.high:.4g} | {error:+.2f} % |")
        speeds = {kmh: kmh / 3.6 for kmh in (20, 40)}
        for got in found.resistance:
            kmh = int(got.id.split("_")[1].removesuffix("kmh"))
            if kmh in speeds:
                v = speeds[kmh]
                true = truth["davis_a_n"] + v * (truth["davis_b_n_per_mps"] + v * truth["davis_c_n_per_mps2"])
                shown = " | ".join(f"{x:.4g}" for x in (got.nominal, true, got.value))
                error = 100 * (got.value / true - 1)
                lines.append(
                    f"| {name} | `{got.id}` | {shown} | {got.low:.4g} to {got.high:.4g} | {error:+.2f} % |"
                )
    lines += [
        "",
        f"{RUNS} logs a train, seeds 0 to {len(TRAINS) - 1}; altrios {told['altrios']}, "
        + ", ".join(about.values())
        + ".",
    ]
    text = "\n".join(lines)
    if page:
        page.write_text(replace_section(page.read_text(), "foreign", text))
    print(text)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("simulate", "fit"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    if options.what == "simulate":
        simulate(options.folder)
    else:
        fit(options.folder, options.write)


if __name__ == "__main__":
    main()
