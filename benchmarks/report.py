"""Report of a benchmark: rows with units, the machine, and a page written by the command."""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from metropilot._provenance import commit, machine, versions

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Row:
    """One measured number.

    Attributes:
        what: What was measured.
        value: The number, a median where it was repeated.
        unit: Its unit.
        ratio: The number over the benchmark's baseline, measured in the same run; None for none.
        target: What we aim for, in words; empty for none.
    """

    what: str
    value: float
    unit: str
    ratio: float | None = None
    target: str = ""


@dataclass(frozen=True)
class Benchmark:
    """A benchmark: ``measure`` takes a minute or so and returns its rows.

    Attributes:
        name: Short name, also of its section in the page.
        title: Heading of its table.
        packages: Distributions whose versions matter.
        measure: Does the work.
        note: What a reader must know about how it was measured.
    """

    name: str
    title: str
    packages: tuple[str, ...]
    measure: Callable[[], list[Row]]
    note: str = ""


def on_devices(devices: int, module: str, *arguments: str) -> dict[str, float]:
    """Last line that ``python -m MODULE ARGUMENTS`` prints, as JSON, with so many single-threaded devices.

    JAX fixes its devices when it starts, hence a process of its own.
    """
    flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    environment = {
        **os.environ,
        "JAX_PLATFORMS": "cpu",
        "XLA_FLAGS": f"{flags} --xla_force_host_platform_device_count={devices}",
    }
    command = [sys.executable, "-m", module, *arguments]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def page_options(about: str | None) -> argparse.Namespace:
    """Options of a script that writes a page of its own: ``write`` and ``rows``, paths or None."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    parser.add_argument("--rows", type=Path, metavar="JSON", help="also write every run's numbers")
    return parser.parse_args()


def hand_out(options: argparse.Namespace, page: str, runs: Sequence[Any]) -> None:
    """Print the page or write it, and the runs (dataclasses) beside it as JSON."""
    if options.rows:
        options.rows.write_text(json.dumps([asdict(run) for run in runs]))
    if options.write:
        options.write.write_text(page)
    else:
        print(page)


def circumstances(packages: tuple[str, ...]) -> dict[str, str]:
    """Machine, load, date, commit and versions."""
    told = versions(packages)
    return {
        "machine": f"{machine()}, load {os.getloadavg()[0]:.1f}",
        "date": datetime.now(UTC).date().isoformat(),
        "commit": commit() or "unknown",
        "versions": ", ".join(f"{name} {number}" for name, number in told.items()),
    }


def number(value: float) -> str:
    """A number with three significant digits, thousands grouped."""
    digits = 0 if value >= 100 else 2 if value >= 1 else 4
    rounded = float(f"{value:.3g}")
    return f"{rounded:,.{digits}f}"


def cells(row: Row) -> tuple[str, str, str, str, str]:
    """A row as text."""
    return (
        row.what,
        number(row.value),
        row.unit,
        "" if row.ratio is None else f"{number(row.ratio)} x",
        row.target,
    )


HEADINGS = ("what", "value", "unit", "ratio", "target")


def format_terminal(benchmark: Benchmark, rows: list[Row], about: dict[str, str]) -> Table:
    """The table for a terminal."""
    caption = "\n".join([f"{key}: {value}" for key, value in about.items()] + [benchmark.note])
    table = Table(*HEADINGS, title=benchmark.title, caption=caption, caption_justify="left")
    for row in rows:
        table.add_row(*cells(row))
    return table


def format_page(benchmark: Benchmark, rows: list[Row], about: dict[str, str]) -> str:
    """The table for the page."""
    lines = [f"## {benchmark.title}", "", "| " + " | ".join(HEADINGS) + " |", "|---|---:|---|---:|---|"]
    lines += ["| " + " | ".join(cells(row)) + " |" for row in rows]
    lines += ["", benchmark.note, "", "Measured on " + "; ".join(f"{k}: {v}" for k, v in about.items()) + "."]
    return "\n".join(lines)


def find_section(page: str, name: str) -> str:
    """One benchmark's section of a page with its marks; empty where there is none."""
    begin, end = f"<!-- benchmark: {name} -->", f"<!-- end: {name} -->"
    found = re.search(re.escape(begin) + ".*?" + re.escape(end), page, re.DOTALL)
    return found.group() if found else ""


def replace_section(page: str, name: str, text: str) -> str:
    """The page with one benchmark's section replaced, or added at its end."""
    section = f"<!-- benchmark: {name} -->\n{text}\n<!-- end: {name} -->"
    if known := find_section(page, name):
        return page.replace(known, section)
    return page.rstrip() + f"\n\n{section}\n"


def write_section(page: Path | None, name: str, text: str) -> None:
    """Replace one benchmark's section of a page; without a page, print it."""
    if page is None:
        print(text)
    else:
        page.write_text(replace_section(page.read_text(), name, text))


def run(benchmarks: list[Benchmark], arguments: list[str] | None = None) -> None:
    """Command line of one or more benchmarks: measure, then print, ``--json`` or ``--write PAGE``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Measure and report.")
    parser.add_argument("names", nargs="*", help="which: " + ", ".join(b.name for b in benchmarks))
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument(
        "--write", type=Path, metavar="PAGE", help="replace the benchmark's section of a page"
    )
    options = parser.parse_args(arguments)
    unknown = set(options.names) - {b.name for b in benchmarks}
    if unknown:
        parser.error(f"unknown benchmark: {', '.join(sorted(unknown))}")
    results = []
    for benchmark in benchmarks:
        if options.names and benchmark.name not in options.names:
            continue
        about = circumstances(benchmark.packages)
        rows = benchmark.measure()
        results.append({"benchmark": benchmark.name, **about, "rows": [asdict(row) for row in rows]})
        if not options.json:
            Console().print(format_terminal(benchmark, rows, about))
        if options.write:
            page = options.write.read_text() if options.write.exists() else "# Benchmarks\n"
            options.write.write_text(
                replace_section(page, benchmark.name, format_page(benchmark, rows, about))
            )
    if options.json:
        print(json.dumps(results, indent=2))
