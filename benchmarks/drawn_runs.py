"""Random runs of every driver, and what knowing the plant is worth to those that estimate it.

``python -m benchmarks.drawn_runs --seed 26 --cases 60 --write docs/benchmarks.md``. A case draws a line, a
section, a trainset of the catalogue or a drawn one, dead time, lag and jerk limit, a running time and a
control period; nothing of it was tuned on. The second table draws the section, too: limits and gradients that
no line has. The third tells the driver the plant (mass, resistance, dead time and lag as declared) or leaves
it to the estimator.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.report import circumstances, write_section
from metropilot.drivers import DRIVERS
from metropilot.planning import minimum_running_time
from metropilot.railway import Actuation, Line, Section, Station, Steps, load_line, load_trainset
from metropilot.sim import Disturbance, Run, drive
from metropilot.units import J_PER_KWH, KMH_PER_MPS

LINES = ("yizhuang", "zurich-stadelhofen", "lu2023", "yizhuang-ttobench")
TRAINSETS = (
    "dkz32",
    "cheng2023",
    "lu2023",
    "cn_beijing_subway",
    "ch_stadler_flirt_tpf",
    "ch_stadler_kiss_sbb",
    "nl_intercity_virm6",
    "de_traxx_ic2",
    "de_desiro_classic",
)
PERIODS_S = (0.1, 0.2, 0.5, 1.0)
DRIVEN = (
    "optimal",
    "mpc",
    "generalist",
    "eitoe",
    "eitop",
    "itor",
    "ston",
    "stod",
    "pid",
    "manual",
    "flat_out",
)
ESTIMATING = ("optimal", "mpc", "generalist")
MARK_M, LATE_S, JERK = 0.3, 1.0, 1.05
"""At the mark within this, on time within that, and the jerk at most this much of its limit."""
SPARE_S = 0.5
"""A running time that leaves `flat_out` this much can be kept."""
LENGTH_M, LONGEST_M, SLOWEST_KMH, FASTEST_KMH = (200.0, 9000.0), 40000.0, 25.0, 160.0
PIECE_M, STEEP_PERMIL, GRADIENT_M = (300.0, 700.0, 1500.0), (5.0, 12.0, 20.0), 400.0
"""Drawn sections: mean distance between limits, steepest gradients, mean distance between gradients."""
PLANTS = {"more resistance": 1.5, "less resistance": 0.5}
MASS, DELAY_S, LAG_S, NOISE_MPS = 1.2, 0.6, 0.4, 0.05


@dataclass(frozen=True)
class DrawnRun:
    """One run.

    Attributes:
        driver: Driver.
        past_m: Distance beyond the mark at the end, negative short of it.
        late_s: Arrival after the scheduled one.
        jerk: Largest jerk over the limit, that of the stop included; zero without one.
        interventions: Interventions of protection.
        overspeed_mps: Largest excess over a limit.
        stood: True if it stood between departure and mark.
        can_be_kept: True if the running time can be kept.
    """

    driver: str
    past_m: float
    late_s: float
    jerk: float
    interventions: int
    overspeed_mps: float
    stood: bool
    can_be_kept: bool


def draw_line_section(random: np.random.Generator) -> Section:
    """Draw a section of a line of the catalogue, either way."""
    line = load_line(LINES[random.integers(len(LINES))])
    ends = list(pairwise(line.stations))[random.integers(len(line.stations) - 1)]
    return line.section(*(each.code for each in (ends if random.random() < 0.5 else ends[::-1])))


def draw_free_section(random: np.random.Generator) -> Section:
    """Draw length, limits and gradients of a section."""
    longest = LENGTH_M[1] if random.random() < 0.9 else LONGEST_M
    length_m = float(np.exp(random.uniform(np.log(LENGTH_M[0]), np.log(longest))))

    def pieces(distance_m: float, low: float, high: float) -> Steps:
        at = np.sort(random.uniform(0.0, length_m, random.poisson(length_m / distance_m)))
        return Steps(np.append(0.0, at), random.uniform(low, high, at.size + 1))

    limits = pieces(float(random.choice(PIECE_M)), SLOWEST_KMH / KMH_PER_MPS, FASTEST_KMH / KMH_PER_MPS)
    steepest = float(random.choice(STEEP_PERMIL))
    stations = (Station("A", "Alpha", 0.0), Station("B", "Beta", length_m))
    gradients = pieces(GRADIENT_M, -steepest, steepest)
    line = Line(id="drawn", name="drawn", stations=stations, limit_mps=limits, gradient_permil=gradients)
    return line.section("A", "B")


def draw_runs(
    seed: int, cases: int, draw_section: Callable[[np.random.Generator], Section] = draw_line_section
) -> Iterator[Run]:
    """Draw runs; the same seed gives the same ones."""
    random = np.random.default_rng(seed)
    for number in range(cases):
        section = draw_section(random)
        catalogued = random.random() < 0.5
        name = TRAINSETS[random.integers(len(TRAINSETS))]
        trainset = load_trainset(name if catalogued else f"drawn-{seed}-{number}")
        if random.random() < 0.75:
            limit = trainset.actuation.jerk_limit_mps3
            if random.random() < 0.5:
                limit = round(random.uniform(0.5, 1.3), 2)
            late = round(random.uniform(0.0, 1.0), 2), round(random.uniform(0.0, 0.6), 2)
            trainset = replace(trainset, actuation=Actuation(*late, limit))
        time_s = random.uniform(1.05, 1.4) * minimum_running_time(section, trainset)
        yield Run(section, trainset, time_s, dt=float(random.choice(PERIODS_S)))


def drive_run(run: Run, drivers: Sequence[str]) -> Iterator[DrawnRun]:
    """Drive a run with each driver and measure it."""
    fastest = drive(run, DRIVERS.make("flat_out"))
    can_be_kept = fastest.running_time_s <= run.scheduled_time_s - SPARE_S
    mass_kg, limit = run.trainset.effective_mass_kg, run.trainset.actuation.jerk_limit_mps3
    for driver in drivers:
        done = fastest if driver == "flat_out" else drive(run, DRIVERS.make(driver))
        way, length_m = done.trajectory, run.section.length_m
        # a gradient that changes under the trainset is not the driver's doing
        own = np.diff(way.acceleration_mps2 + way.gradient_n / mass_kg)[1:-1] / run.dt
        jerk, stop = np.abs(way.jerk_mps3[:-1]).max(), abs(way.jerk_mps3[-1])
        on_the_way = (way.position_m > 1.0) & (way.position_m < length_m - MARK_M)
        yield DrawnRun(
            driver=driver,
            past_m=float(way.position_m[-1]) - length_m,
            late_s=done.running_time_s - run.scheduled_time_s,
            jerk=float(max(min(np.abs(own).max(), jerk), stop)) / limit,
            interventions=done.interventions,
            overspeed_mps=float(done.max_overspeed_mps),
            stood=bool((way.speed_mps[on_the_way] <= 0.0).any()),
            can_be_kept=can_be_kept,
        )


def format_drawn(runs: Sequence[DrawnRun]) -> list[str]:
    """Rows of the table, one for each driver."""
    head = "| driver | runs | beyond the mark | short of it | stood before it | overruled | "
    lines = [
        head + "above a limit | later | earlier | jerk above its limit | worst m |",
        "|---|" + "---:|" * 10,
    ]
    for driver in dict.fromkeys(run.driver for run in runs):
        mine = [run for run in runs if run.driver == driver]
        counts = (
            sum(run.past_m > MARK_M for run in mine),
            sum(run.past_m < -MARK_M for run in mine),
            sum(run.stood for run in mine),
            sum(run.interventions > 0 for run in mine),
            sum(run.overspeed_mps > 0.0 for run in mine),
            sum(run.late_s > LATE_S and run.can_be_kept for run in mine),
            sum(run.late_s < -LATE_S for run in mine),
            sum(run.jerk > JERK for run in mine),
        )
        worst = max(mine, key=lambda run: abs(run.past_m)).past_m
        lines.append(f"| `{driver}` | {len(mine)} | {' | '.join(map(str, counts))} | {worst:+.2f} |")
    return lines


def compare_told() -> list[str]:
    """Rows of energy without being told the plant, over the same drive told, percent."""
    line, nominal = load_line("yizhuang"), load_trainset("dkz32", "AW2")
    sections = [line.section(a.code, b.code) for a, b in pairwise(line.stations)]
    lines = ["| driver | plant | runs | median % | mean % | worst % |", "|---|---|---:|---:|---:|---:|"]
    for driver in ESTIMATING:
        for plant, factor in PLANTS.items():
            world = Disturbance(
                ideal=False,
                mass_factor=MASS,
                resistance_factor=factor,
                delay_s=DELAY_S,
                lag_s=LAG_S,
                speed_noise_mps=NOISE_MPS,
            )
            true, noisy = world.true_plant(nominal), Disturbance(ideal=False, speed_noise_mps=NOISE_MPS)
            more = []
            for section in sections:
                time_s = 1.1 * minimum_running_time(section, true)
                spent = [
                    float(drive(run, DRIVERS.make(driver)).trajectory.energy_wheel_j[-1]) / J_PER_KWH
                    for run in (Run(section, nominal, time_s, world), Run(section, true, time_s, noisy))
                ]
                more.append(100.0 * (spent[0] / spent[1] - 1.0))
            found = (np.median(more), np.mean(more), max(more))
            lines.append(f"| `{driver}` | {plant} | {len(more)} | {' | '.join(f'{x:+.1f}' for x in found)} |")
    return lines


def main() -> None:
    """Drive, and write or print the section."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=26)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--drivers", default=",".join(DRIVEN))
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    drivers = options.drivers.split(",")
    on_lines, on_sections = (
        [each for run in draw_runs(options.seed, options.cases, draw) for each in drive_run(run, drivers)]
        for draw in (draw_line_section, draw_free_section)
    )
    about = circumstances(("metropilot", "numpy"))
    periods = ", ".join(f"{period:g}" for period in PERIODS_S)
    drawn = (
        f"{options.cases} cases of seed {options.seed}: a section of {', '.join(LINES)}; a trainset of the "
        "catalogue or a drawn one; its own actuation, or a dead time up to 1 s, a lag up to 0.6 s and a jerk "
        "limit of 0.5 to 1.3 m/s³; 1.05 to 1.4 times the minimum running time, which knows neither "
        f"protection nor actuation; control periods of {periods} s. Beyond and short of the mark count from "
        f"{MARK_M} m on, later and earlier from {LATE_S:g} s on, later only where `flat_out` is at least "
        f"{SPARE_S} s early, the jerk, also at the stop, without that of a gradient, from {JERK} times "
        "its limit on."
    )
    every, steep = (", ".join(f"{x:g}" for x in values) for values in (PIECE_M, STEEP_PERMIL))
    free = (
        f"**Drawn sections.** As many cases on sections of {LENGTH_M[0]:g} m to {LONGEST_M / 1000:g} km with "
        f"limits of {SLOWEST_KMH:g} to {FASTEST_KMH:g} km/h every {every} m and gradients up to {steep} "
        f"permil every {GRADIENT_M:g} m, in the mean."
    )
    told = (
        f"**Told or not.** All sections of yizhuang with dkz32 AW2, {MASS} times the mass, {DELAY_S} s dead "
        f"time and {LAG_S} s lag, 1.1 times the minimum of that plant: energy of a driver that is told "
        "nothing of it, above that of the same driver to whom all of it is declared."
    )
    where = "; ".join(f"{key}: {value}" for key, value in about.items())
    measured = f"Written by `python -m benchmarks.drawn_runs`. Measured on {where}."
    rows = format_drawn(on_lines), format_drawn(on_sections), compare_told()
    tables = ["\n".join(each) for each in rows]
    text = ["## Drawn runs", drawn, tables[0], free, tables[1], told, tables[2], measured]
    write_section(options.write, "drawn runs", "\n\n".join(text))


if __name__ == "__main__":
    main()
