"""Accuracy and coverage of ``metropilot fit``: ``python -m benchmarks.fit --cases 200 --write docs/fit.md``.

Each case draws a plant about DKZ32, drives it over sections of the Yizhuang line by hand-written programs
(traction, cruising, coasting, braking), and spoils the logs: speed with noise, quantised, times on a grid of
0.1 s, and samples lost in gaps. The plant is stepped by `physics.step`, the fit never sees it.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy import ndarray

from benchmarks.report import circumstances, replace_section
from metropilot.errors import InputError
from metropilot.fit import Calibration, Log, fit_trainset
from metropilot.physics import Command, Forces, State, Track, Vehicle, step, track_arrays, vehicle_arrays
from metropilot.railway import Actuation, Davis, Trainset, load_line, load_trainset
from metropilot.sim import Disturbance

PERIOD_S = 0.2
SECTIONS = (("SJZ", "XC"), ("XC", "XHM"), ("YZQ", "WHY"), ("RJ", "WYJ"), ("TJN", "JHL"))
NOISE_MPS, QUANTUM_KMH, LOST = 0.05, 0.1, 0.03
MOST_S = 260.0
WANTED = {
    "mass_factor": "2 %",
    "brake_factor": "–",
    "davis_a_n": "–",
    "davis_b_n_per_mps": "–",
    "davis_c_n_per_mps2": "–",
    "resistance_20kmh_n": "3 %",
    "resistance_40kmh_n": "3 %",
    "resistance_60kmh_n": "3 %",
    "delay_s": "0.05 s",
    "lag_s": "0.05 s",
}
"""Quantities of the table with the largest error wanted."""


@dataclass(frozen=True)
class Program:
    """Programs of several runs: what a driver by hand does. All arrays of shape (runs,).

    Attributes:
        traction: Command while accelerating.
        cruise_mps: Speed at which it ends.
        cruise_s: Time for which the speed is held.
        coast_to_mps: Speed at which coasting ends.
        brake: Command while braking.
    """

    traction: ndarray
    cruise_mps: ndarray
    cruise_s: ndarray
    coast_to_mps: ndarray
    brake: ndarray


def draw_program(rng: np.random.Generator, runs: int, top_mps: float) -> Program:
    """Draw the programs of so many runs."""
    cruise = rng.uniform(0.5, 0.9, runs) * top_mps
    return Program(
        rng.uniform(0.5, 1.0, runs),
        cruise,
        rng.uniform(0.0, 15.0, runs),
        cruise * rng.uniform(0.55, 0.9, runs),
        -rng.uniform(0.35, 0.9, runs),
    )


def draw_truth(rng: np.random.Generator, nominal: Trainset) -> Trainset:
    """Draw a true plant: mass, brake, each Davis coefficient, dead time and lag."""
    world = Disturbance(mass_factor=rng.uniform(0.85, 1.25), brake_factor=rng.uniform(0.85, 1.1))
    plant = world.true_plant(nominal)
    a, b, c = (x * rng.uniform(0.8, 1.3) for x in nominal.davis.newtons(nominal.mass_kg))
    actuation = Actuation(rng.uniform(0.0, 1.0), rng.uniform(0.05, 0.6), nominal.actuation.jerk_limit_mps3)
    return replace(plant, davis=Davis(a, b, c), actuation=actuation)


def states_at_rest(runs: int) -> State:
    """State of so many runs at rest."""
    zero = np.zeros(runs)
    forces = Forces(zero, zero, zero, zero, zero)
    return State(zero, zero, zero, zero, zero, np.zeros((1, runs)), zero, forces, zero, zero, zero, zero)


def drive(
    vehicle: Vehicle, track: Track, program: Program, rng: np.random.Generator
) -> tuple[ndarray, ndarray, ndarray]:
    """Drive the programs: position, speed and command at the start of every period, (periods, runs)."""
    runs = program.traction.size
    state, phase, held_s = states_at_rest(runs), np.zeros(runs, int), np.zeros(runs)
    rows = []
    share, acting = np.zeros(runs), np.zeros(runs)
    # dead time and lag of many runs at once; the plant has the rest
    delay, lag = float(vehicle.delay_s) / PERIOD_S, float(vehicle.lag_s)
    whole, part = int(delay), delay % 1.0
    keep = np.exp(-PERIOD_S / lag) if lag > 0 else 0.0
    given = [np.zeros(runs)] * (whole + 2)
    answering = vehicle._replace(delay_s=0.0, lag_s=0.0)
    for _ in range(round(MOST_S / PERIOD_S)):
        v = np.maximum(state.speed_mps + NOISE_MPS * rng.standard_normal(runs), 0.0)
        braking_m = v * v / 2.0 / (0.8 * -program.brake) + 40.0
        phase = np.where((phase == 0) & (v >= program.cruise_mps), 1, phase)
        held_s = held_s + PERIOD_S * (phase == 1)
        phase = np.where((phase == 1) & (held_s > program.cruise_s), 2, phase)
        phase = np.where((phase == 2) & (v < program.coast_to_mps), 3, phase)
        phase = np.where(state.position_m + braking_m > track.length_m, 3, phase)
        hold = np.clip(0.15 + 0.25 * (program.cruise_mps - v), -0.3, 1.0)
        wanted = np.choose(phase, [program.traction, hold, np.zeros(runs), program.brake])
        share = share + np.clip(wanted - share, -0.15, 0.15)
        rows.append((state.position_m, state.speed_mps, share))
        if ((phase == 3) & (state.speed_mps <= 0.0)).all():
            break
        given = [share, *given[:-1]]
        target = given[whole] * (1.0 - part) + given[whole + 1] * part
        acting = target + (acting - target) * keep
        state = step(answering, track, state, Command(acting), PERIOD_S)
    position, speed, command = (np.array(column) for column in zip(*rows, strict=True))
    return position, speed, command


def spoil(rng: np.random.Generator, position: ndarray, speed: ndarray, command: ndarray, name: str) -> Log:
    """Spoil one run: noise, quantisation, times rounded to 0.1 s, and samples lost one to five at a time."""
    end = np.flatnonzero(speed > 0.0)[-1] + 2
    position, speed, command = position[:end], speed[:end], command[:end]
    noisy = np.where(speed > 0, np.maximum(speed + NOISE_MPS * rng.standard_normal(speed.size), 0.0), 0.0)
    quantum = QUANTUM_KMH / 3.6
    noisy = quantum * np.round(noisy / quantum)
    kept = np.ones(speed.size, bool)
    for at in np.flatnonzero(rng.random(speed.size) < LOST / 3.0):
        kept[at : at + rng.integers(1, 6)] = False
    kept[0] = True
    times = np.round(PERIOD_S * np.arange(speed.size), 1)
    return Log(name, times[kept], noisy[kept], command[kept], None, position[kept])


def case(seed: int, nominal: Trainset, logs: int) -> tuple[Trainset, Calibration]:
    """One case: the truth and the fit."""
    rng = np.random.default_rng(seed)
    truth = draw_truth(rng, nominal)
    line, vehicle = load_line("yizhuang"), vehicle_arrays(truth)
    found, sections = [], []
    each = max(logs // len(SECTIONS), 1)
    for ends in SECTIONS:
        section = line.section(*ends)
        program = draw_program(rng, each, 80 / 3.6)
        position, speed, command = drive(vehicle, track_arrays(section, truth), program, rng)
        for k in range(each):
            found.append(spoil(rng, position[:, k], speed[:, k], command[:, k], f"{ends[0]}-{k}"))
            sections.append(section)
    return truth, fit_trainset(found, nominal, sections=sections)


def true_values(truth: Trainset, nominal: Trainset) -> dict[str, float]:
    """True value of each quantity of the table."""
    a, b, c = truth.davis.newtons(truth.mass_kg)
    values = {
        "mass_factor": truth.mass_kg / nominal.mass_kg,
        "brake_factor": truth.service_deceleration_mps2 / nominal.service_deceleration_mps2,
        "davis_a_n": a,
        "davis_b_n_per_mps": b,
        "davis_c_n_per_mps2": c,
        "delay_s": truth.actuation.delay_s,
        "lag_s": truth.actuation.lag_s,
    }
    speeds = {kmh: kmh / 3.6 for kmh in (20, 40, 60)}
    return values | {f"resistance_{kmh}kmh_n": a + b * v + c * v * v for kmh, v in speeds.items()}


def errors_of(seed: int, nominal: Trainset, logs: int) -> dict[str, tuple[float, bool]]:
    """Error of each quantity in its unit (relative, or s), and if its interval covers the truth."""
    truth, found = case(seed, nominal, logs)
    estimates = {p.id: p for p in (*found.parameters, *found.resistance)}
    values = true_values(truth, nominal)
    return {
        name: (
            abs(estimates[name].value - true) / (1.0 if name.endswith("_s") else true),
            estimates[name].low <= true <= estimates[name].high,
        )
        for name, true in values.items()
        if name in estimates
    }


def table(cases: list[dict[str, tuple[float, bool]]]) -> list[str]:
    """Rows of the table of the page."""
    lines = [
        "| quantity | error, median | 95th percentile | worst | wanted | interval covers the truth |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, wanted in WANTED.items():
        rows = [case[name] for case in cases if name in case]
        if not rows:
            continue
        errors = np.array([error for error, _ in rows])
        covered = np.mean([inside for _, inside in rows])
        scale, unit = (1.0, " s") if name.endswith("_s") else (100.0, " %")
        digits = 3 if unit == " s" else 2
        shown = (
            f"{scale * x:.{digits}f}{unit}"
            for x in (np.median(errors), np.quantile(errors, 0.95), errors.max())
        )
        lines.append(f"| `{name}` | {' | '.join(shown)} | {wanted} | {100 * covered:.0f} % of {len(rows)} |")
    inside = np.mean([covered for case in cases for _, covered in case.values()])
    lines += ["", f"Over all quantities the intervals cover the truth in {100 * inside:.1f} % of the cases."]
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--logs", type=int, default=20, help="logs of a case")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first case")
    parser.add_argument("--minutes", type=float, default=60.0, help="no case begins later")
    parser.add_argument("--rows", type=Path, metavar="JSONL", help="add each case here; those there are kept")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    parser.add_argument("--trainset", default="dkz32")
    options = parser.parse_args()
    about, nominal, began = (
        circumstances(("numpy", "scipy")),
        load_trainset(options.trainset),
        time.monotonic(),
    )
    seeds = range(options.seed, options.seed + options.cases)
    known = options.rows.read_text().splitlines() if options.rows and options.rows.exists() else []
    rows = {row["seed"]: row for row in map(json.loads, known) if row["seed"] in seeds}
    for seed in seeds:
        if seed in rows:
            continue
        if time.monotonic() - began > 60.0 * options.minutes:
            break
        started = time.monotonic()
        try:
            found = {"errors": errors_of(seed, nominal, options.logs)}
        except InputError as error:
            found = {"refused": str(error)}
        rows[seed] = {"seed": seed, "seconds": round(time.monotonic() - started, 1), **found}
        line = json.dumps(rows[seed], default=float)
        print(line, flush=True)
        if options.rows:
            with options.rows.open("a") as stream:
                stream.write(line + "\n")
    cases = [row["errors"] for row in rows.values() if "errors" in row]
    seconds = np.array([row["seconds"] for row in rows.values()])
    text = "\n".join(
        [
            *table(cases),
            "",
            f"{len(cases)} cases of {options.logs} logs, {len(rows) - len(cases)} refused; seeds "
            f"{min(rows)} to {max(rows)}, {seconds.sum() / 60:.0f} minutes of one processor, "
            f"{np.median(seconds):.1f} s a case; " + ", ".join(about.values()) + ".",
        ]
    )
    if options.write:
        options.write.write_text(replace_section(options.write.read_text(), "fit", text))
    print(text)


if __name__ == "__main__":
    main()
