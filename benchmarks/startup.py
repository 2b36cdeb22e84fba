"""Waiting times of a user: `metropilot --help` (target 0.3 s) and a second `metropilot drive` (target 3 s).

python -m benchmarks.startup
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.report import Benchmark, Row, run

RUNS = 9
PROGRAM = Path(sys.executable).with_name("metropilot")
SECTION = ("drive", "yizhuang", "RJ", "WYJ", "--time", "101")
CASES = (
    ("`metropilot --help`", ("--help",), "0.3 s"),
    ("second `metropilot drive`", SECTION, "3 s"),
    ("the same with `--out` (pictures)", (*SECTION, "--out", "{out}"), "3 s"),
)


def median_s(arguments: tuple[str, ...], runs: int = RUNS) -> tuple[float, float]:
    """Median wall and processor time of a command in a fresh process, s; the first warms the file cache."""
    walls, busy = [], []
    for _ in range(runs + 1):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        began = time.perf_counter()
        subprocess.run([PROGRAM, *arguments], capture_output=True, check=True)
        walls.append(time.perf_counter() - began)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        busy.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return statistics.median(walls[1:]), statistics.median(busy[1:])


def measure() -> list[Row]:
    """Wall time of each command, and the processor time in it."""
    rows = []
    with TemporaryDirectory() as out:
        for what, arguments, target in CASES:
            wall_s, busy_s = median_s(tuple(a.format(out=out) for a in arguments))
            rows.append(Row(what, wall_s, "s", target=target))
            rows.append(Row(f"{what}, processor time", busy_s, "s"))
    return rows


BENCHMARK = Benchmark(
    name="startup",
    title="Start-up",
    packages=("metropilot", "typer", "rich", "numpy", "clarabel", "matplotlib"),
    measure=measure,
    note=f"Each command in a fresh process, median of {RUNS} after one that warms the file cache. "
    "`drive` plans, drives under protection, computes the optimum and prints.",
)

if __name__ == "__main__":
    run([BENCHMARK])
