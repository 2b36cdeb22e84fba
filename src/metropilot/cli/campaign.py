"""`metropilot campaign`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot.cli import options as opt
from metropilot.cli.console import console, number, print_json, table
from metropilot.errors import InputError

if TYPE_CHECKING:
    from metropilot.campaign import CampaignProgress, LineSweep

EXAMPLES = {
    "campaign": (
        "metropilot campaign example --out campaign",
        "metropilot campaign robustness.toml --workers 2 --json",
        "metropilot campaign robustness.toml --cluster local --workers 2",
        "metropilot campaign leaderboard --write-docs docs/leaderboard.md",
        "metropilot campaign trainsets --sample 400 --out trainsets",
        "metropilot campaign line-example --out lines",
    ),
}
SAY_EVERY_S = 5.0


def campaign_command(
    file: Annotated[str, typer.Argument(help="A campaign's TOML file, or the name of one that ships.")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder; campaigns/ and the name of FILE if not given. An unfinished campaign is resumed."
        ),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes on this machine.")] = 2,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on a Ray cluster; `local` starts one on this machine."),
    ] = None,
    drivers: Annotated[
        str | None, typer.Option(help="Drivers instead of the file's own, separated by commas.")
    ] = None,
    sample: Annotated[
        int | None,
        typer.Option(min=0, help="Size of the sample instead of the file's own; 0: the whole matrix."),
    ] = None,
    write_docs: Annotated[
        Path | None, typer.Option(metavar="PAGE.md", help="Also write the page of the documentation.")
    ] = None,
    write_rows: Annotated[
        Path | None,
        typer.Option(metavar="ROWS.parquet", help="Also write rows, campaign and provenance as one file."),
    ] = None,
    as_json: opt.Json = False,
) -> int:
    """Compute a declared matrix of runs or lines, resumable, and report it.

    After an interruption the same command resumes it. Exit code 0: every run was safe, and arrived on time
    where that was possible, or every line was computed; 1: not; 2: invalid input.
    """
    from metropilot.campaign import (
        LineSweep,
        collect_parts,
        publish_rows,
        read_campaign,
        run_campaign,
        summarise,
        write_campaign_page,
        write_campaign_report,
        written_words,
    )

    campaign = read_campaign(file, drivers, sample)
    folder = out or Path("campaigns") / Path(file).stem
    if write_docs is not None and write_docs.suffix != ".md":
        raise InputError(
            "not a page", field="write-docs", value=str(write_docs), allowed="a path ending in .md"
        )
    if write_rows is not None and write_rows.suffix != ".parquet":
        allowed = "a path ending in .parquet"
        raise InputError("not a file of rows", field="write-rows", value=str(write_rows), allowed=allowed)
    began = perf_counter()
    try:
        progress = run_campaign(campaign, folder, workers, cluster, _Saying())
    except KeyboardInterrupt:
        raise typer.Abort("interrupted; the same command resumes it") from None
    sys.stderr.write(f"writing the report to {folder}\n")
    collect_parts(folder)
    summary = summarise(folder)
    summary |= call_summary(progress, workers, cluster)
    write_campaign_report(folder, summary, circumstances(progress, workers, cluster))
    line, seconds = campaign_line(file, drivers, sample), perf_counter() - began
    if write_docs is not None:
        write_campaign_page(write_docs, folder, summary, seconds, line)
    if write_rows is not None:
        # Rows behind a page say of themselves what it says.
        told = f"--write-rows {write_rows}" if write_docs is None else f"--write-docs {write_docs}"
        publish_rows(folder, write_rows, written_words(f"{line} {told}", summary, seconds))
    if as_json:
        print_json(summary)
    else:
        files = "report.html results.parquet timings.parquet"
        if isinstance(campaign, LineSweep):
            report_lines(campaign, summary)
        else:
            report(summary)
            files += " worst/"
        done = summary["sitting"]
        if done["driven"]:
            rate = f"{done['driven']} rows in {done['seconds']:.1f} s, {done['runs_per_s']:.2f} a second."
            console().print(rate)
        console().print(f"Written to {folder}: {files}")
    return 0 if campaign.succeeds(summary) else 1


def campaign_line(file: str, drivers: str | None, sample: int | None) -> str:
    """The command line, as a page quotes it."""
    told = ("" if drivers is None else f" --drivers {drivers}") + (
        "" if sample is None else f" --sample {sample}"
    )
    return f"metropilot campaign {file}{told}"


class _Saying:
    """Progress on the error stream, every few seconds."""

    def __init__(self) -> None:
        self.next_s = SAY_EVERY_S

    def __call__(self, progress: CampaignProgress) -> None:
        if progress.seconds < self.next_s:
            return
        self.next_s = progress.seconds + SAY_EVERY_S
        rate = progress.driven / max(progress.seconds, 1e-9)
        left = (progress.total - progress.rows) / max(rate, 1e-9)
        sys.stderr.write(
            f"{progress.rows} of {progress.total} rows, {rate:.2g} a second, {left:.0f} s left, "
            f"{progress.memory_mb:.0f} MB\n"
        )


def call_summary(progress: CampaignProgress, workers: int, cluster: str | None) -> dict[str, Any]:
    """Runs and time of this call, for the JSON."""
    rate = progress.driven / progress.seconds if progress.driven else None
    values = {"driven": progress.driven, "seconds": progress.seconds, "runs_per_s": rate, "workers": workers}
    return {"sitting": values | {"cluster": cluster, "memory_mb": progress.memory_mb}}


def circumstances(progress: CampaignProgress, workers: int, cluster: str | None) -> dict[str, str]:
    """Provenance lines in the head of the report."""
    from metropilot._provenance import provenance

    where = f"{workers} processes" if cluster is None else f"Ray cluster {cluster}"
    made = ", ".join(f"{name} {text}" for name, text in provenance().items())
    return {
        "This sitting": f"{progress.driven} rows in {progress.seconds:.0f} s on {where}",
        "Machine": f"{os.cpu_count()} cores",
        "Made with": made,
    }


def report_lines(sweep: LineSweep, summary: dict[str, Any]) -> None:
    """Print the summary of a campaign of lines in operation."""
    from metropilot.campaign import table_of_lines

    heads, cells = table_of_lines(sweep, summary["lines"])
    title = f"{summary['campaign']}: {summary['done']} of {summary['rows']} rows, kWh"
    spare = [name for name in heads if name.endswith((" s", ", found", ", plain")) and "optimal" not in name]
    console().print(table(title, heads, cells, right=range(1, len(heads)), spare=spare))


def report(summary: dict[str, Any]) -> None:
    """Print the summary of a campaign of drives."""
    rows = []
    for row in summary["drivers"]:
        share = 100.0 * row["successes"] / row["possible"] if row["possible"] else None
        rows.append(
            [
                row["driver"],
                str(row["runs"]),
                number(share, 1),
                number(row["gap_median"], 2),
                number(row["gap_95"], 1),
                number(row["gap_worst"], 1),
                number(row["late_worst_s"], 2),
                number(row["stop_worst_m"], 3),
                str(row["intervened"]),
                str(row["failed"]),
                number(row["decision_us_median"], 0),
            ]
        )
    columns = (
        *("driver", "runs", "on time %", "gap median %", "95 %", "worst %"),
        *("time worst s", "stop worst m", "intervened", "failed", "decision µs"),
    )
    out = console()
    title = f"{summary['campaign']}: {summary['done']} of {summary['rows']} runs"
    spare = ("decision µs", "95 %", "intervened", "stop worst m", "worst %")
    out.print(table(title, columns, rows, right=range(1, len(columns)), spare=spare))
