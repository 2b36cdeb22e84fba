"""Estimates of the plant on the way: ``python -m benchmarks.estimation --cases 200 --write docs/fit.md``.

Each case draws a section of the Yizhuang line, a load and a plant (mass, resistance, brake, dead time, lag,
speed noise), lets a driver drive it, and reads its estimate some time after departure and at the stop.
With ``--told`` the plants are driven twice, the second time declared, and the gaps to the optimum compared.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report import circumstances, replace_section
from metropilot.control import Estimate, StateEstimate, initial_estimate, model_of, update_estimate
from metropilot.drivers import DRIVERS
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Outcome, Rollout, Run, drive

LINE, TRAINSET, LOADS = "yizhuang", "dkz32", ("AW0", "AW3")
RANGES = {
    "mass_factor": (0.8, 1.2),
    "resistance_factor": (0.7, 1.3),
    "brake_factor": (0.85, 1.0),
    "delay_s": (0.0, 0.6),
    "lag_s": (0.0, 0.4),
    "speed_noise_mps": (0.0, 0.05),
}
"""Ranges of the draws; the robustness campaign's noise, dead time, lag and mass."""
WANTED = {"mass_factor": 0.02, "resistance_factor": 0.1, "delay_s": 0.2}
"""Largest errors wanted: relative, dead time in s."""
QUANTITIES = ("mass_factor", "resistance_factor", "delay_s", "lag_s", "brake_factor")
AT_STOP = "at the stop"
EXACT = 1e-6
"""Slack of an interval's end, for plants without noise."""


@dataclass(frozen=True)
class Reading:
    """Estimate of one quantity in one case, and the truth."""

    at: str
    name: str
    estimate: Estimate
    true: float

    @property
    def error(self) -> float:
        """Error, relative; of a time in s."""
        off = self.estimate.value - self.true
        return off if self.name.endswith("_s") else off / self.true

    @property
    def is_covered(self) -> bool:
        """If the interval covers the truth."""
        return self.estimate.low - EXACT <= self.true <= self.estimate.high + EXACT


def draw_run(rng: np.random.Generator, seed: int, period_s: float) -> Run:
    """Draw a section, a load and a plant."""
    line = load_line(LINE)
    sections = [*line.sections(), *line.sections(backward=True)]
    section = sections[int(rng.integers(len(sections)))]
    trainset = load_trainset(TRAINSET, LOADS[int(rng.integers(len(LOADS)))])
    drawn = {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}
    plant = Disturbance(**drawn)  # pyright: ignore[reportArgumentType]
    fastest_s = max(minimum_running_time(section, each) for each in (trainset, plant.true_plant(trainset)))
    time_s = fastest_s * float(rng.uniform(1.1, 1.3))
    return Run(section, trainset, time_s, plant, dt=period_s, seed=seed)


def estimate_of(memory: Any) -> StateEstimate:  # noqa: ANN401 (a driver's)
    """Estimate in a driver's memory."""
    return memory.estimate if hasattr(memory, "estimate") else memory.monitor.estimate


def readings_of(run: Run, driver: str, seconds: Sequence[float]) -> list[Reading]:
    """Drive a run and read the estimates."""
    rollout = Rollout(run, DRIVERS.make(driver))
    true = {name: getattr(run.disturbance, name) for name in QUANTITIES}
    found: list[Reading] = []

    def read(at: str) -> None:
        plant = estimate_of(rollout.memory).plant(run.dt)
        # Before the first braking nothing is known of the brake.
        names = QUANTITIES if at == AT_STOP else QUANTITIES[:-1]
        found.extend(Reading(at, name, getattr(plant, name), true[name]) for name in names)

    left = sorted(seconds)
    while rollout.outcome is None:
        rollout.advance()
        if left and rollout.moment().time_s >= left[0] - 1e-6:
            read(f"{left.pop(0):g} s after departure")
    read(AT_STOP)
    return found


def table(readings: Sequence[Reading]) -> list[str]:
    """Rows of the table."""
    lines = [
        "| estimate | quantity | error, median | 95th percentile | worst | within | interval covers |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for at in dict.fromkeys(reading.at for reading in readings):
        for name in QUANTITIES:
            mine = [reading for reading in readings if (reading.at, reading.name) == (at, name)]
            if not mine:
                continue
            errors = np.abs([reading.error for reading in mine])
            scale, unit, digits = (1.0, " s", 3) if name.endswith("_s") else (100.0, " %", 2)
            shown = " | ".join(
                f"{scale * x:.{digits}f}{unit}"
                for x in (np.median(errors), np.quantile(errors, 0.95), errors.max())
            )
            most = WANTED.get(name)
            within = (
                "–" if most is None else f"{100 * np.mean(errors <= most):.0f} % in {scale * most:g}{unit}"
            )
            covered = np.mean([reading.is_covered for reading in mine])
            lines.append(f"| {at} | `{name}` | {shown} | {within} | {100 * covered:.0f} % of {len(mine)} |")
    return lines


def gap_percent(run: Run, driver: str) -> float:
    """Gap of a drive to the optimum of the true plant for the running time achieved, %; NaN: not arrived."""
    done = drive(run, DRIVERS.make(driver))
    if done.outcome is not Outcome.ARRIVED:
        return float("nan")
    achieved_s = max(done.running_time_s, 1.0001 * minimum_running_time(run.section, done.trainset))
    best = optimal_plan(run.section, done.trainset, achieved_s, PlanOptions(spacing_m=5.0))
    return 100.0 * (float(done.trajectory.energy_wheel_j[-1]) / best.bound_j - 1.0)


def gaps_of(run: Run, driver: str) -> tuple[float, float]:
    """Gaps of a driver that is not told the plant, and of one that is, %."""
    told = replace(run, trainset=run.disturbance.true_plant(run.trainset), disturbance=Disturbance())
    return gap_percent(run, driver), gap_percent(told, driver)


def table_of_gaps(gaps: dict[str, list[tuple[float, float]]]) -> list[str]:
    """Rows of the table of drives that are told the plant and that are not."""
    lines = [
        "| driver | runs | gap not told, median | told, median | difference, mean | median | largest |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for driver, pairs in gaps.items():
        blind, told = np.array(pairs).T
        off = blind - told
        numbers = (np.median(blind), np.median(told), off.mean(), np.median(off), off.max())
        lines.append(f"| `{driver}` | {len(pairs)} | " + " | ".join(f"{x:.2f} %" for x in numbers) + " |")
    return lines


def median_us(update: Callable[[], object], repeats: int = 2000) -> float:
    """Median time of a call, us."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter_ns()
        update()
        times.append((time.perf_counter_ns() - began) / 1e3)
    return float(np.median(times))


def update_us(run: Run) -> float:
    """Median time of an update of the estimate, us."""
    model = model_of(run, run.section)
    estimate = update_estimate(model, initial_estimate(model, 100.0, 10.0), 100.0, 10.0, 0.0)
    return median_us(lambda: update_estimate(model, estimate, 102.0, 10.0, 0.02))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1, help="seed of the first case")
    parser.add_argument("--seconds", type=float, nargs="+", default=[30.0], help="time of a reading")
    parser.add_argument("--drivers", nargs="+", default=["optimal"], help="drivers that plan")
    parser.add_argument("--period", type=float, default=0.2, help="control period, s")
    parser.add_argument("--told", action="store_true", help="compare with drivers that are told the plant")
    parser.add_argument("--minutes", type=float, default=10.0, help="no case begins later")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    about, began = circumstances(("numpy",)), time.monotonic()
    readings: list[Reading] = []
    gaps: dict[str, list[tuple[float, float]]] = {driver: [] for driver in options.drivers}
    last = options.seed
    for seed in range(options.seed, options.seed + options.cases):
        if time.monotonic() - began > 60.0 * options.minutes:
            break
        run = draw_run(np.random.default_rng(seed), seed, options.period)
        for driver in options.drivers:
            if options.told:
                # A weaker brake and noise are no secrets of the mass, the resistance and the actuation.
                plain = replace(run.disturbance, brake_factor=1.0, speed_noise_mps=0.0)
                gaps[driver].append(gaps_of(replace(run, disturbance=plain), driver))
                print(seed, driver, gaps[driver][-1], flush=True)
            else:
                readings += readings_of(run, driver, options.seconds)
        last = seed
    rows = table_of_gaps(gaps) if options.told else table(readings)
    cost_us = update_us(draw_run(np.random.default_rng(0), 0, options.period))
    drivers = ", ".join(f"`{driver}`" for driver in options.drivers)
    text = "\n".join(
        [
            *rows,
            "",
            f"Driven by {drivers}, seeds {options.seed} to {last}, period {options.period:g} s; an "
            f"update takes {cost_us:.0f} us; {(time.monotonic() - began) / 60:.1f} minutes by one process; "
            + ", ".join(about.values())
            + ".",
        ]
    )
    if options.write:
        name = "told" if options.told else "estimation"
        options.write.write_text(replace_section(options.write.read_text(), name, text))
    print(text)


if __name__ == "__main__":
    main()
