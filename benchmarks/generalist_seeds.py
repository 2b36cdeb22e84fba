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
from unittest.mock import patch

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.beside_optimum import Result, table
from benchmarks.generalist import (
    DRIVER,
    IDEAL,
    LIMITED,
    SEEDS,
    Case,
    cases,
    drive_all,
    drive_case,
    is_success,
    spread,
    target_gap,
    wide_cases,
)
from benchmarks.report import circumstances, write_section
from metropilot.control import Model, PredictedState, StateEstimate, look_ahead
from metropilot.learn import DrivingEvaluation, evaluation_of, new_request
from metropilot.policy import load_driving_policy, load_policy, policy_path, shipped_policy

QUARTER = {"steps": 12_000_000, "batches": 10_000}
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
AS_SHIPPED, A_QUARTER = "as shipped", "a quarter of the budget"
PRESENT = "as shipped, the policy in the present state"
TEXT = """### Seeds and ablation

The policy shipped is that of the seed that is best in **its own worlds**: {drives} drives on {worlds} random
sections with random trainsets, the same for every seed. Then each drives {line} runs
of the first table and {wide} with other trainsets, which chose nothing. A quarter of the budget is
{quarter:,} decisions and {batches:,} steps of imitation; a feature that a policy is without is always zero.

{table}

{finding}

`python -m benchmarks.generalist_seeds RUN... --sample {sample}`, each run a folder of
`metropilot learn generalist --budget paper` with the options of the first column; learned at {commits};
{about}."""


def learned_with(about: Any) -> str:  # noqa: ANN401 (what a policy's file says)
    """Options of the learning run in words."""
    words, config = about["provenance"]["command"].split(), about["config"]
    if about["provenance"]["steps"] <= config["decisions"]:
        return "imitation alone"
    if config["batches"] == 1 and config["imitation_weight"] == 0.0:
        return "closed loop alone"
    if config["batches"] == QUARTER["batches"] and config["steps"] == QUARTER["steps"]:
        unseen = ", ".join(f"`{name}`" for name in config.get("unseen", ()))
        return f"{A_QUARTER}{unseen and ', without ' + unseen}"
    kept = [f"{a} {b}" for a, b in pairwise(words) if a in {"--set", "--steps"}]
    return f"`{' '.join(kept)}`" if kept else AS_SHIPPED


def scatter(rows: Sequence[Sequence[str]]) -> str:
    """Finding of the ablation beside the scatter of the seeds, in the mean of their own worlds."""
    shipped = [float(row[3]) for row in rows if row[0] == AS_SHIPPED]
    quarter = [float(row[3]) for row in rows if row[0].startswith(A_QUARTER)]
    if not quarter:
        return ""
    wider = max(quarter) - min(quarter) > max(shipped) - min(shipped)
    return (
        f"In their own worlds the seeds scatter from {min(shipped):.1f} to {max(shipped):.1f} %, those "
        f"of a quarter of the budget from {min(quarter):.1f} to {max(quarter):.1f} %: "
        + ("some groups of features make" if wider else "no group of features makes")
        + " a difference beyond that of the seeds."
    )


def own_worlds(path: Path) -> dict[str, float]:
    """KPIs of a policy in the worlds that choose the seed, driven with the code of now."""
    evaluate = jax.jit(cast("DrivingEvaluation", evaluation_of(new_request(DRIVER))))
    policy, _ = load_policy(path)
    params = {name: jnp.asarray(value) for name, value in policy.params.items()}
    return {name: float(value) for name, value in evaluate(params, jax.random.key(0)).items()}


def row(path: Path, shipped: bool, line: Sequence[Result], wide: Sequence[Result]) -> list[str]:
    """One policy's row of the table."""
    about: Any = load_driving_policy(path).about
    kpis = own_worlds(policy_path(path))
    seed = f"{about['seed']}{' (shipped)' if shipped else ''}"
    return [
        learned_with(about),
        seed,
        f"{100.0 * kpis['safe_share']:.0f}",
        f"{kpis['gap_percent']:.2f}",
        f"{kpis['gap_worst_percent']:.1f}",
        f"{kpis['late_worst_s']:.2f}",
        *driven(line, wide),
    ]


def driven(line: Sequence[Result], wide: Sequence[Result]) -> list[str]:
    """Columns of the runs that chose nothing."""
    by_name = {name: [r for r in line if r.case.scenario == name] for name in (IDEAL, LIMITED)}
    return [
        f"{sum(map(is_success, line))} of {len(line)}" if line else "–",
        *(spread([target_gap(r) for r in some]) if some else "–" for some in by_name.values()),
        f"{sum(map(is_success, wide))} of {len(wide)}",
        spread([target_gap(r) for r in wide]),
    ]


def drive_in_present(cases: Sequence[Case]) -> list[Result]:
    """Drive with a policy that sees the present state, not that in which its command begins to act.

    Stop, ceiling and the look at protection predict as ever.
    """

    def look_at_present(model: Model, estimate: StateEstimate) -> PredictedState:
        return look_ahead(model, estimate)._replace(
            seconds=0.0,
            position_m=estimate.position_m,
            speed_mps=estimate.speed_mps,
            acceleration_mps2=estimate.acceleration_mps2,
        )

    with patch("metropilot.drivers.learned.look_ahead", look_at_present):
        return [result for case in cases if (result := drive_case(case))]


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
    late = drive_in_present(wide)
    rows.insert(1, [PRESENT, *("–",) * 5, *driven([], late)])
    commits = {load_driving_policy(path).about["provenance"]["commit"][:9] for path in options.runs}
    grid = cast("DrivingEvaluation", evaluation_of(new_request(DRIVER))).grid
    text = TEXT.format(
        drives=grid.case.size,
        worlds=np.unique(grid.case).size,
        quarter=QUARTER["steps"],
        batches=QUARTER["batches"],
        line=len(line),
        wide=len(wide),
        sample=options.sample,
        table=table(HEADS, rows),
        finding=scatter(rows),
        commits=", ".join(sorted(commits)),
        about="; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items()),
    )
    write_section(options.write, SEEDS, text)


if __name__ == "__main__":
    main()
