"""The driver `optimal` on every section, load and running time of the Yizhuang line: the table of the docs.

python -m benchmarks.closed_loop --write docs/optimal-driver.md
"""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from benchmarks.report import circumstances, hand_out, page_options
from metropilot.drivers import DRIVERS
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import Section, load_line, load_trainset
from metropilot.sim import Disturbance, Run, drive

LINE, TRAINSET, LOADS = "yizhuang", "dkz32", ("AW0", "AW2", "AW3")
RATIOS = (1.05, 1.1, 1.2, 1.6)
PLAN_RATIOS = (1.02, 1.05, 1.1, 1.2, 1.4, 1.6)
LATE = {"delay_s": 0.6, "lag_s": 0.4, "speed_noise_mps": 0.05}
SCENARIOS = {
    "ideal actuation": Disturbance(ideal=True),
    "jerk limit": Disturbance(),
    "mass +20 %, Davis +50 %": Disturbance(mass_factor=1.2, resistance_factor=1.5, **LATE),
    "mass +20 %, Davis -50 %": Disturbance(mass_factor=1.2, resistance_factor=0.5, **LATE),
    "mass -20 %, Davis +50 %": Disturbance(mass_factor=0.8, resistance_factor=1.5, **LATE),
    "mass -20 %, Davis -50 %": Disturbance(mass_factor=0.8, resistance_factor=0.5, **LATE),
}
KNOWN = ("ideal actuation", "jerk limit")


PAGE = """# The driver `optimal` on every section

This page measures the driver `optimal` on every section, with the nominal plant and with plant mismatch.
Line `{line}`, both directions, trainset `{trainset}` with {loads}, under protection. Every run is
compared with the optimal plan for the running time it achieved, under the same limits (wheel traction
energy). That optimum includes neither the jerk limit nor protection. Written by `python -m
benchmarks.closed_loop --write`: {about}. Only the speed noise is random (seed 0).

## Nominal plant

{known}

Largest jerk with the jerk limit (1 m/s3): {jerk} m/s3.

The last two columns are the optimum of the same convex problem with the jerk limit and without protection:
the cost of the jerk limit alone. At 1.05 of the minimum running time, which has no jerk limit, it
is several percent above the bound on the short sections: the ramps take about one second of a reserve of
four, and a second there costs 4 to 6 %. (The plant changes its effort once per period of 0.2 s and so
gains a tenth of a second on a continuous ramp.)

## Plant mismatch

Mass and Davis resistance differ as named, with 0.6 s of additional dead time, 0.4 s of additional lag and
0.05 m/s of speed noise, all unknown to the driver. The scheduled time is 1.1 of the nominal minimum.

{unknown}

## Plans

{plans} plans at {ratios} of the minimum: all solved; largest certificate gap {certificate} %, loosest
cone {cone}.

## Gap to the optimum, section by section

Ideal actuation / with the jerk limit, in percent, over the running time divided by the minimum.

{sections}
"""


@dataclass(frozen=True)
class Case:
    """One run to drive: a section by its stations, a load, a running time over the minimum, a scenario."""

    origin: str
    destination: str
    load: str
    ratio: float
    scenario: str

    @property
    def section(self) -> Section:
        """The section itself."""
        return load_line(LINE).section(self.origin, self.destination)


@dataclass(frozen=True)
class Result:
    """Result of a drive; gaps in percent, ``floor`` is the optimum that knows the jerk limit."""

    case: Case
    outcome: str
    time_error_s: float
    stop_error_m: float
    gap: float
    floor: float
    overspeed_mps: float
    interventions: int
    jerk_mps3: float
    certificate: float


def drive_case(case: Case) -> Result:
    """Drive one case and compare it with the optimum for the running time it achieved."""
    trainset, section = load_trainset(TRAINSET, case.load), case.section
    time_s = minimum_running_time(section, trainset) * case.ratio
    run = Run(section, trainset, time_s, SCENARIOS[case.scenario])
    done = drive(run, DRIVERS.make("optimal"))
    rows = done.trajectory
    achieved = max(done.running_time_s, minimum_running_time(section, done.trainset) * 1.0001)
    best = optimal_plan(section, done.trainset, achieved, PlanOptions(spacing_m=5.0))
    jerk = trainset.actuation.jerk_limit_mps3
    floor = 0.0
    if case.scenario == "jerk limit":
        limited = optimal_plan(
            section, done.trainset, achieved, PlanOptions(jerk_mps3=jerk, late_w=500.0, spacing_m=5.0)
        )
        floor = 100 * (limited.energy_wheel_j / best.bound_j - 1)
    return Result(
        case=case,
        outcome=done.outcome.value,
        time_error_s=done.running_time_s - time_s,
        stop_error_m=float(rows.position_m[-1]) - section.length_m,
        gap=100 * (float(rows.energy_wheel_j[-1]) / best.bound_j - 1),
        floor=floor,
        overspeed_mps=done.max_overspeed_mps,
        interventions=done.interventions,
        jerk_mps3=float(np.max(np.abs(rows.jerk_mps3))),
        certificate=best.gap,
    )


def check_plan(case: Case) -> tuple[float, float]:
    """Certificate gap and cone tightness of the plan of one case."""
    trainset, section = load_trainset(TRAINSET, case.load), case.section
    plan = optimal_plan(section, trainset, minimum_running_time(section, trainset) * case.ratio)
    return plan.gap, plan.tightness


def sections() -> list[tuple[str, str]]:
    """Every section, both directions."""
    line = load_line(LINE)
    both = (*line.sections(), *line.sections(backward=True))
    return [(s.origin.code, s.destination.code) for s in both]


def cases(scenarios: tuple[str, ...], ratios: tuple[float, ...]) -> list[Case]:
    """Sections x loads x ratios x scenarios."""
    return [
        Case(*ends, load, r, s) for s in scenarios for ends in sections() for load in LOADS for r in ratios
    ]


def worst(values: list[float]) -> float:
    """The value farthest from zero."""
    return max(values, key=abs)


def summary(results: list[Result], by_ratio: bool) -> list[str]:
    """One line for each scenario (and ratio)."""
    heads = ("scenario", "time / minimum", "runs", "arrived", "worst time error s", "worst stop error m")
    heads = (*heads, "overspeed m/s", "interventions", "gap median %", "95th %", "worst %")
    heads = (*heads, "jerk-limited optimum: median %", "worst %")
    lines = ["| " + " | ".join(heads) + " |", "|---|---|" + "---:|" * (len(heads) - 2)]
    keys = sorted(
        {(list(SCENARIOS).index(r.case.scenario), r.case.ratio if by_ratio else 0.0) for r in results}
    )
    for index, ratio in keys:
        name = list(SCENARIOS)[index]
        some = [r for r in results if r.case.scenario == name and (not by_ratio or r.case.ratio == ratio)]
        gaps = np.array([r.gap for r in some])
        floor = np.array([r.floor for r in some])
        floors = f"{np.median(floor):.2f} | {floor.max():.2f}" if name == "jerk limit" else " | "
        lines.append(
            f"| {name} | {ratio if by_ratio else some[0].case.ratio:g} | {len(some)} "
            f"| {sum(r.outcome == 'arrived' for r in some)} | {worst([r.time_error_s for r in some]):+.2f} "
            f"| {worst([r.stop_error_m for r in some]):+.3f} | {max(r.overspeed_mps for r in some):.3f} "
            f"| {sum(r.interventions for r in some)} | {np.median(gaps):.2f} | {np.percentile(gaps, 95):.2f} "
            f"| {gaps.max():.2f} | {floors} |"
        )
    return lines


def by_section(results: list[Result]) -> list[str]:
    """Gap of each section, load and ratio: ideal / jerk limit."""
    lines = [
        "| section | load | " + " | ".join(f"{r:g}" for r in RATIOS) + " |",
        "|---|---|" + "---|" * len(RATIOS),
    ]
    found = {
        (r.case.origin, r.case.destination, r.case.load, r.case.ratio, r.case.scenario): r for r in results
    }
    for ends in sections():
        for load in LOADS:
            pairs = [[found[(*ends, load, ratio, s)].gap for s in KNOWN] for ratio in RATIOS]
            cells = " | ".join(f"{a:.2f} / {b:.2f}" for a, b in pairs)
            lines.append(f"| {ends[0]}-{ends[1]} | {load} | {cells} |")
    return lines


def page(known: list[Result], unknown: list[Result], plans: list[tuple[float, float]]) -> str:
    """The page of the docs."""
    about = circumstances(("metropilot", "clarabel", "numpy", "scipy"))
    jerks = [r.jerk_mps3 for r in known if r.case.scenario == "jerk limit"]
    words = {
        "line": LINE,
        "trainset": TRAINSET,
        "loads": ", ".join(LOADS),
        "about": "; ".join(f"{k} {v}" for k, v in about.items()),
        "known": "\n".join(summary(known, by_ratio=True)),
        "jerk": f"{max(jerks):.4f}",
        "unknown": "\n".join(summary(unknown, by_ratio=False)),
        "plans": len(plans),
        "ratios": ", ".join(f"{r:g}" for r in PLAN_RATIOS),
        "certificate": f"{100 * max(g for g, _ in plans):.1e}",
        "cone": f"{max(t for _, t in plans):.1e}",
        "sections": "\n".join(by_section(known)),
    }
    return PAGE.format(**words)


def main() -> None:
    """Drive everything on all cores; print the page or write it, and the rows beside it as JSON."""
    options = page_options(__doc__)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), context) as pool:
        known = list(pool.map(drive_case, cases(KNOWN, RATIOS), chunksize=8))
        unknown = list(pool.map(drive_case, cases(tuple(SCENARIOS)[2:], (1.1,)), chunksize=8))
        plans = list(pool.map(check_plan, cases(("ideal actuation",), PLAN_RATIOS), chunksize=16))
    hand_out(options, page(known, unknown, plans), known + unknown)


if __name__ == "__main__":
    main()
