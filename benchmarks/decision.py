"""Time that drivers take to decide on the host, beside the simulation of a control period.

python -m benchmarks.decision
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.report import Benchmark, Row, run
from metropilot.drivers import DRIVERS
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Run, drive

LINE, ORIGIN, DESTINATION, TRAINSET, TIME_S = "yizhuang", "RJ", "WYJ", "dkz32", 110.0
NAMES = ("generalist", "ppo", "eitoe", "manual", "optimal")
RUNS = 3
TARGETS = {"generalist": "300 us"}


def decision_us(name: str, where: Run) -> tuple[float, float]:
    """Median time of a decision, and mean time of the rest of a control period, us; the least of the runs."""
    driver, decisions, rests = DRIVERS.make(name), [], []
    for _ in range(RUNS + 1):
        began = time.perf_counter()
        done = drive(where, driver)
        whole_us = 1e6 * (time.perf_counter() - began)
        decisions.append(float(np.median(done.decision_us)))
        rests.append((whole_us - sum(done.decision_us)) / len(done.decision_us))
    return min(decisions[1:]), min(rests[1:])


def measure() -> list[Row]:
    """Every driver's decision, over the plant and protection of a control period."""
    section = load_line(LINE).section(ORIGIN, DESTINATION)
    where = Run(section, load_trainset(TRAINSET), TIME_S)
    found = {name: decision_us(name, where) for name in NAMES}
    rest = min(rest for _, rest in found.values())
    rows = [Row("plant and protection of a control period", rest, "us")]
    return rows + [
        Row(f"decision of `{name}`", decision, "us", decision / rest, TARGETS.get(name, ""))
        for name, (decision, _) in found.items()
    ]


BENCHMARK = Benchmark(
    name="decision",
    title="Decisions on the host",
    packages=("metropilot", "numpy"),
    measure=measure,
    note=f"Least of {RUNS} drives from {ORIGIN} to {DESTINATION} in {TIME_S:g} s, each the median over its "
    "control periods. The ratio is over plant and protection of a control period in the same drives. "
    "`generalist` decides in every second period; a median counts those.",
)

if __name__ == "__main__":
    run([BENCHMARK])
