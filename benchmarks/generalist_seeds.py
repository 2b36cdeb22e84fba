"""Seeds and ablation of the generalist: other learning runs beside the shipped one.

python -m benchmarks.generalist_seeds RUN... --sample 20 --rows rows.jsonl --write docs/generalist.md

A run is the folder of ``metropilot learn generalist``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np

from benchmarks.beside_optimum import Result, table
from benchmarks.generalist import (
    DRIVER,
    IDEAL,
    LIMITED,
    SEEDS,
    cases,
    drive_all,
    is_success,
    spread,
    target_gap,
    wide_cases,
)
from benchmarks.report import circumstances, write_section
from metropilot.learn import DrivingEvaluation, evaluation_of, new_request
from metropilot.policy import load_driving_policy, shipped_policy

HEADS = (
    "learned with",
    "seed",
    "own worlds: safe %",
    "above the optimum, mean %",
    "worst %",
    "time, worst s",
    "line: in time and place",
    "ideal: median / 95th / worst %",
    "jerk limit: median / 95th / worst %",
    "other trainsets: in time and place",
    "median / 95th / worst %",
)
TEXT = """### Seeds and ablation

The policy shipped is that of the seed that is best in **its own worlds**: {drives} drives on {worlds} random
sections with random trainsets at the end of learning, the same for every seed. Then each drives {line} runs
of the first table and {wide} with other trainsets, which chose nothing.

{table}

`python -m benchmarks.generalist_seeds RUN... --sample {sample}`, each run a folder of
`metropilot learn generalist --budget paper` with the options of the first column; learned at {commits};
{about}."""


def learned_with(about: Any) -> str:  # noqa: ANN401 (what a policy's file says)
    """Options of the learning run in words."""
    words = about["provenance"]["command"].split()
    kept = [f"{a} {b}" for a, b in pairwise(words) if a in {"--set", "--steps"}]
    if about["provenance"]["steps"] <= about["config"]["decisions"]:
        return "imitation alone"
    if about["config"]["batches"] == 1 and about["config"]["imitation_weight"] == 0.0:
        return "closed loop alone"
    return f"`{' '.join(kept)}`" if kept else "as shipped"


def row(path: Path, shipped: bool, line: Sequence[Result], wide: Sequence[Result]) -> list[str]:
    """One policy's row of the table."""
    about: Any = load_driving_policy(path).about
    kpis = about["kpis"]
    seed = f"{about['seed']}{' (shipped)' if shipped else ''}"
    by_name = {name: [r for r in line if r.case.scenario == name] for name in (IDEAL, LIMITED)}
    return [
        learned_with(about),
        seed,
        f"{100.0 * kpis['safe_share']:.0f}",
        f"{kpis['gap_percent']:.2f}",
        f"{kpis['gap_worst_percent']:.1f}",
        f"{kpis['late_worst_s']:.2f}",
        f"{sum(map(is_success, line))} of {len(line)}",
        *(spread([target_gap(r) for r in some]) for some in by_name.values()),
        f"{sum(map(is_success, wide))} of {len(wide)}",
        spread([target_gap(r) for r in wide]),
    ]


def main() -> None:
    """Drive the same runs with each policy; print the section or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--sample", type=int, default=20, metavar="N", help="runs on the line")
    parser.add_argument("--rows", type=Path, metavar="JSONL", help="runs that are in it are not driven again")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    line = [case for case in cases(options.sample) if case.driver == DRIVER]
    # A fifth of them: most trainsets, and every dead time and lag by turns.
    wide = wide_cases([])[::5]
    rows = []
    for path in (None, *options.runs):
        parts = [[replace(case, policy=str(path or "")) for case in part] for part in (line, wide)]
        done = drive_all([*parts[0], *parts[1]], options.processes, options.rows)
        found = [[done[case] for case in part if case in done] for part in parts]
        rows.append(row(path or shipped_policy(DRIVER), path is None, *found))
    commits = {load_driving_policy(path).about["provenance"]["commit"][:9] for path in options.runs}
    grid = cast("DrivingEvaluation", evaluation_of(new_request(DRIVER))).grid
    text = TEXT.format(
        drives=grid.case.size,
        worlds=np.unique(grid.case).size,
        line=len(line),
        wide=len(wide),
        sample=options.sample,
        table=table(HEADS, rows),
        commits=", ".join(sorted(commits)),
        about="; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items()),
    )
    write_section(options.write, SEEDS, text)


if __name__ == "__main__":
    main()
