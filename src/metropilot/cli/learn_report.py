"""Output of `metropilot learn` during and after learning."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from metropilot.cli.console import NOTHING, console, table

if TYPE_CHECKING:
    from metropilot.learn import RunRecord, RunRequest, TrainingProgress

COLUMNS = ("steps", "steps/s", "return", "safe %", "above optimum %", "late s", "stop m", "left")
WIDTHS = (11, 10, 9, 7, 16, 7, 7, 8)
KPIS: tuple[tuple[str, str, str, float], ...] = (
    ("safe_share", "drives that arrive safely and on time", "%", 100.0),
    ("gap_percent", "energy above the optimum, mean", "%", 1.0),
    ("gap_worst_percent", "energy above the optimum, worst", "%", 1.0),
    ("late_worst_s", "off time, worst", "s", 1.0),
    ("stop_error_worst_m", "off the stop, worst", "m", 1.0),
    ("energy_wheel_kwh", "energy at the wheel, mean", "kWh", 1.0),
    ("running_time_s", "running time, mean", "s", 1.0),
    ("interventions", "interventions", "", 1.0),
)


class LearnReport:
    """Output during learning: a row per evaluation, and a progress bar on a terminal, else one line.

    Args:
        request: The learning run.
        folder: Folder of the run.
        quiet: Print the bar only.
    """

    def __init__(self, request: RunRequest, folder: Path, *, quiet: bool) -> None:
        self.request = request
        self.folder = folder
        self.quiet = quiet
        self.steps = 0
        self.bar: Any = None
        self.item: Any = None

    def __enter__(self) -> LearnReport:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            words = TextColumn("{task.description}", markup=False)
            left = TextColumn("{task.fields[left]}", markup=False)
            self.bar = Progress(words, BarColumn(), left, console=Console(stderr=True), transient=True)
            self.item = self.bar.add_task("compiling", total=None, left="kept for the next time")
            self.bar.start()
        elif not self.quiet:
            sys.stderr.write("metropilot: compiling, kept for the next time\n")
            sys.stderr.flush()
        request = self.request
        config = request.config
        self._say(
            f"{request.driver}: {config.algorithm} on {request.name}, seed {request.seed}, in {self.folder}"
        )
        self._say("".join(name.rjust(width) for name, width in zip(COLUMNS, WIDTHS, strict=True)))
        return self

    def progress(self, now: TrainingProgress) -> None:
        """Print an evaluation and advance the bar."""
        self.steps = now.steps
        row = now.row
        left = clock(now.seconds_left)
        if "lessons" in row:
            self._say(f"{row['lessons']:>10.0%} of the demonstrations collected, {left} left")
            return
        cells = (
            f"{now.steps:,}".replace(",", " "),
            f"{now.rate:,.0f}".replace(",", " "),
            figure(row.get("return"), 2),
            figure(row.get("evaluation.safe_share"), 0, 100.0),
            figure(row.get("evaluation.gap_percent"), 2),
            figure(row.get("evaluation.late_worst_s"), 2),
            figure(row.get("evaluation.stop_error_worst_m"), 3),
            left,
        )
        self._say("".join(cell.rjust(width) for cell, width in zip(cells, WIDTHS, strict=True)))
        if self.bar is not None:
            words, total = f"learning {self.request.driver}", now.total_steps
            self.bar.update(
                self.item, description=words, total=total, completed=now.steps, left=f"{left} left"
            )

    def close(self) -> None:
        """Remove the bar."""
        if self.bar is not None:
            self.bar.stop()
            self.bar = None

    def _say(self, line: str) -> None:
        if self.quiet:
            return
        if self.bar is not None:
            self.bar.console.print(line, markup=False, highlight=False)
        else:
            sys.stdout.write(line + "\n")
            sys.stdout.flush()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def figure(value: float | None, digits: int, factor: float = 1.0) -> str:
    """Format a number; None becomes a dash."""
    return NOTHING if value is None or value != value else f"{factor * value:.{digits}f}"  # noqa: PLR0124 (NaN)


def clock(seconds: float) -> str:
    """Format seconds as m:ss or h:mm:ss."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def kpi_rows(kpis: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Rows of the known KPIs of a learned driver: words, number, unit."""
    known = [(words, kpis.get(name), unit, factor) for name, words, unit, factor in KPIS]
    return [
        (words, f"{factor * value:.4g}", unit)
        for words, value, unit, factor in known
        if isinstance(value, int | float)
    ]


def run_as_json(record: RunRecord, folder: Path) -> dict[str, Any]:
    """A run as plain values."""
    from dataclasses import asdict

    return {"kind": "learning run", "folder": str(folder)} | asdict(record)


def report_learned(record: RunRecord, folder: Path) -> None:
    """Print the result of a run and the commands that use it."""
    out = console()
    done = f"{record.steps:,} steps in {clock(record.seconds)}".replace(",", " ")
    out.print(
        table(
            f"{record.driver or record.algorithm}: {done}",
            ("KPI of the policy kept", "value", ""),
            kpi_rows(record.kpis),
            right=(1,),
        )
    )
    out.print(f"Written to {folder}: policy.safetensors history.parquet checkpoint.safetensors run.toml")
    out.print(f"Drive it: metropilot drive ... --driver learned --set policy={folder}", soft_wrap=True)
