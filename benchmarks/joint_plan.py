"""Time and certificate of the joint plan of a convoy over its number of trainsets.

python -m benchmarks.joint_plan
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from benchmarks.report import Benchmark, Row, run
from metropilot.convoy import GAP_M
from metropilot.planning import Plan, PlanOptions, joint_minimum_running_time, joint_plan
from metropilot.railway import Section, Trainset, load_line, load_trainset
from metropilot.sim import Disturbance

RATIO = 1.1
MEMBERS = (1, 2, 4, 8)
MASSES = (0.8, 1.2)
"""Lowest and highest mass over nominal of trainsets that all differ."""
DRIVEN = PlanOptions(jerk_mps3=1.0, release_mps3=0.95)
"""What the plan of a head that is driven has besides."""


def plan_convoy(
    section: Section, trainsets: Sequence[Trainset], options: PlanOptions
) -> tuple[Plan, float, float]:
    """The joint plan, its processor time, and that of the minimum running time, s."""
    offsets_m = [0.0, *accumulate(each.length_m + GAP_M for each in trainsets[:-1])]
    began = time.process_time()
    fastest = joint_minimum_running_time(section, trainsets, offsets_m)
    middle = time.process_time()
    plan = joint_plan(section, trainsets, offsets_m, RATIO * fastest, options)
    return plan, time.process_time() - middle, middle - began


def measure() -> list[Row]:
    """All sections both ways, for each number of trainsets: alike, then with masses of their own."""
    line, trainset = load_line("yizhuang"), load_trainset("dkz32")
    sections = (*line.sections(), *line.sections(backward=True))
    plan_convoy(sections[0], [trainset], DRIVEN)
    rows: list[Row] = []
    base = 0.0
    for members in MEMBERS:
        name = f"{members} trainset{'s' * (members > 1)}"
        factors = np.linspace(*MASSES, members) if members > 1 else [1.0]
        apart = [Disturbance(mass_factor=float(factor)).true_plant(trainset) for factor in factors]
        cases = [("alike", [trainset] * members, PlanOptions()), ("jerk limit", apart, DRIVEN)]
        if members > 1:
            cases.insert(1, ("masses 0.8 to 1.2", apart, PlanOptions()))
        gaps: list[float] = []
        fastest_s: list[float] = []
        for words, trainsets, options in cases:
            found = [plan_convoy(section, trainsets, options) for section in sections]
            times = [plan_s for _, plan_s, _ in found]
            middle, worst = statistics.median(times), max(times)
            base = base or middle
            gaps += [plan.gap for plan, _, _ in found]
            target = "300 ms" if options is not DRIVEN else ""
            rows.append(Row(f"{name}, {words}: median", 1e3 * middle, "ms", middle / base))
            rows.append(Row(f"{name}, {words}: slowest", 1e3 * worst, "ms", worst / base, target))
            fastest_s += [minimum_s for _, _, minimum_s in found]
        fastest = statistics.median(fastest_s)
        rows.append(Row(f"{name}: minimum running time", 1e3 * fastest, "ms", fastest / base))
        rows.append(Row(f"{name}: largest certificate gap", 1e6 * max(gaps), "ppm", None, "100 ppm"))
    return rows


BENCHMARK = Benchmark(
    name="joint_plan",
    title="Joint plan of a convoy",
    packages=("metropilot", "clarabel", "numpy", "scipy"),
    measure=measure,
    note=(
        "Processor time of the whole call on one core: arrays, mesh, flat-out run, all passes. All 26 "
        f"sections of the Yizhuang line, trainset `dkz32`, gaps of {GAP_M} m, {RATIO} of the convoy's "
        "minimum running time; nothing is random (no seed). The gap is the certificate: energy over "
        "lower bound less one, 100 ppm being 0.01 %. *Alike*: trainsets under the same slope share "
        "their variables; with masses of their own none do. *Jerk limit*: the plan that the head "
        "drives, 1 m/s³, masses 0.8 to 1.2. Each ratio is to the plan of one trainset."
    ),
)

if __name__ == "__main__":
    run([BENCHMARK])
