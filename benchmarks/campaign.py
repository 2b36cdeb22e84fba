"""Cost of a campaign as its matrix grows: rate, cost a run, memory.

``python -m benchmarks.campaign [--seeds 1 7 72] [--workers 2] [--out FOLDER] [--write docs/campaigns.md]``
``python -m benchmarks.campaign --growth FOLDER [--write docs/campaigns.md]``

The shipped campaign ``large`` with more and more seeds, each in a process and a folder of its own; 72 seeds
are its 101,088 runs. A folder that is done already is not driven again, so that a killed benchmark goes on.
``--growth`` drives nothing: it reads off a campaign's folder, finished or not, what its runs cost as it grew.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import duckdb

from benchmarks.report import ROOT, circumstances, write_section

NAME = "campaign"
COSTS = "costs.json"
SEEDS = (1, 7, 72)
HEADS = ("runs", "wall s", "runs a second", "processor ms a run", "parent MB", "worker MB", "results MB")


def one(seeds: int, folder: Path, workers: int) -> dict[str, float]:
    """Drive the campaign with so many seeds in this process: what it took."""
    from dataclasses import replace
    from time import perf_counter

    from metropilot.campaign import RESULTS_FILE, collect_parts, peak_memory_mb, read_campaign, run_campaign

    kept = folder / COSTS
    if kept.exists():
        return json.loads(kept.read_text())
    campaign, began = replace(read_campaign("large"), seeds=seeds), perf_counter()
    progress = run_campaign(campaign, folder, workers)
    seconds, memory = perf_counter() - began, peak_memory_mb()
    collect_parts(folder)
    timings = str(folder / "timings" / "*" / "*.parquet")
    spent, worker = query_numbers(f"SELECT sum(processor_s), max(worker_mb) FROM read_parquet('{timings}')")
    costs = {
        "rows": progress.rows,
        "driven": progress.driven,
        "seconds": seconds,
        "processor_s": spent,
        "parent_mb": memory,
        "worker_mb": worker,
        "results_mb": (folder / RESULTS_FILE).stat().st_size / 1e6,
    }
    kept.write_text(json.dumps(costs))
    return costs


def query_numbers(query: str) -> tuple[float, float]:
    """The two numbers of a query's only row."""
    row = duckdb.execute(query).fetchone()
    return (0.0, 0.0) if row is None else (float(row[0]), float(row[1]))


def table(costs: list[dict[str, float]], workers: int, about: dict[str, str]) -> str:
    """The section of the page."""
    lines = ["| " + " | ".join(HEADS) + " |", "|" + "---:|" * len(HEADS)]
    for row in costs:
        whole = row["driven"] == row["rows"]
        words = (
            f"{row['rows']:,.0f}",
            f"{row['seconds']:.0f}" if whole else "went on",
            f"{row['rows'] / row['seconds']:.0f}" if whole else "–",
            f"{1e3 * row['processor_s'] / row['rows']:.1f}",
            f"{row['parent_mb']:.0f}",
            f"{row['worker_mb']:.0f}",
            f"{row['results_mb']:.1f}",
        )
        lines.append("| " + " | ".join(words) + " |")
    said = "; ".join(f"{key}: {value}" for key, value in about.items())
    return "\n".join(
        [*lines, "", f"Campaign `large` on {workers} processes, one thread each. Measured on {said}."]
    )


def growth(folder: Path, parts: int = 8) -> str:
    """The same for one campaign, in the order in which its shards came: an eighth of them after the other."""
    from metropilot.campaign import DONE_FILE, TIMINGS_FOLDER, campaign_of_folder

    lines = [line.split() for line in (folder / DONE_FILE).read_text().splitlines()]
    shards = [
        (int(rows), folder / TIMINGS_FOLDER / key / f"{int(k):06d}.parquet") for key, k, rows, *_ in lines
    ]
    table = ["| runs so far | processor ms a run, of these | worker MB, so far |", "|---:|---:|---:|"]
    rows, size = 0, -(-len(shards) // parts)
    for first in range(0, len(shards), size):
        some = shards[first : first + size]
        paths = ", ".join(f"'{path}'" for _, path in some)
        spent, memory = query_numbers(f"SELECT sum(processor_s), max(worker_mb) FROM read_parquet([{paths}])")
        own = sum(count for count, _ in some)
        rows += own
        table.append(f"| {rows:,} | {1e3 * spent / own:.1f} | {memory:.0f} |")
    campaign = campaign_of_folder(folder)
    said = f"{rows:,} of the {campaign.rows:,} runs of campaign `{campaign.name}`, when this was written."
    return "\n".join([*table, "", said])


def main() -> None:
    """Measure each size in a process of its own, then print or write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, help="folder to keep; else a temporary one")
    parser.add_argument(
        "--write", type=Path, metavar="PAGE", help="replace the benchmark's section of a page"
    )
    parser.add_argument("--growth", type=Path, metavar="FOLDER", help="read off a campaign's folder instead")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.growth:
        about = "; ".join(f"{key}: {value}" for key, value in circumstances(("metropilot", "jax")).items())
        write_section(options.write, NAME, f"{growth(options.growth)} Measured on {about}.")
        return
    if options.one:
        print(json.dumps(one(options.one, options.out, options.workers)))
        return
    with tempfile.TemporaryDirectory() as scratch:
        out, costs = options.out or Path(scratch), []
        for seeds in options.seeds:
            command = [sys.executable, "-m", "benchmarks.campaign", "--one", str(seeds)]
            command += ["--out", str(out / str(seeds)), "--workers", str(options.workers)]
            done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
            costs.append(json.loads(done.stdout.splitlines()[-1]))
            print(costs[-1], flush=True)
    text = table(costs, options.workers, circumstances(("metropilot", "jax", "clarabel")))
    write_section(options.write, NAME, text)


if __name__ == "__main__":
    main()
