"""`metropilot reproduce`, `metropilot studies`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metropilot.cli import complete
from metropilot.cli import options as opt
from metropilot.cli.console import console, heading, print_json, table
from metropilot.errors import InputError

if TYPE_CHECKING:
    from metropilot.studies import StudyReport

EXAMPLES = {
    "reproduce": (
        "metropilot reproduce chen2023a",
        "metropilot reproduce chen2023a --budget paper --out chen2023a",
        "metropilot reproduce cheng2023 --reference optimal --json",
        "metropilot reproduce cheng2023 --as-printed",
    ),
    "studies": ("metropilot studies", "metropilot studies --json"),
}


def reproduce_command(
    study: Annotated[
        str, typer.Argument(help="Study id; see `metropilot studies`.", autocompletion=complete.studies)
    ],
    budget: Annotated[
        str, typer.Option(help="quick (about two minutes) or paper (within an hour).")
    ] = "quick",
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Number of seeds; the budget's own if not given.")
    ] = None,
    reference: Annotated[
        str | None, typer.Option(help="Reference to track, where the study has one.")
    ] = None,
    options: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Option of the study; repeatable.")
    ] = None,
    as_printed: Annotated[
        bool, typer.Option("--as-printed", help="Also run the paper's own settings, beside ours.")
    ] = False,
    processes: Annotated[int, typer.Option(min=1, help="Learning runs side by side.")] = 2,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for report, figures and learning runs; studies/STUDY-BUDGET if not given."),
    ] = None,
    write_docs: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Also write the page of the documentation.")
    ] = None,
    as_json: opt.Json = False,
) -> int:
    """Reproduce a paper: published, reproduced and optimal values in one table, with its figures.

    After an interruption the same command with the same folder resumes it.
    """
    from metropilot import studies
    from metropilot._io import check_writable

    found = studies.STUDIES.get(study)
    given = _pairs(options)
    if reference is not None:
        if "reference" not in found.options:
            raise InputError("the study has none", field="reference", value=reference, allowed="no reference")
        given["reference"] = reference
    folder = out or Path("studies") / f"{study}-{budget}"
    order = studies.Order(
        folder=folder / "runs",
        budget=studies.check_budget(budget),
        seeds=seeds,
        options=given,
        as_printed=as_printed,
        processes=processes,
        say=_say,
    )
    check_writable(folder)
    report = studies.reproduce(study, order)
    studies.write_report(folder, found, report)
    if write_docs is not None:
        studies.write_docs(write_docs, found, report)
    if as_json:
        print_json(report.as_dict())
    else:
        _report(report, folder)
    return 0


def studies_command(as_json: opt.Json = False) -> int:
    """List the studies."""
    from metropilot.studies import STUDIES

    if as_json:
        print_json([{"id": key, "summary": row.summary} for key, row in STUDIES.rows().items()])
        return 0
    console().print(
        table("", ("id", "what it reproduces"), [(key, row.summary) for key, row in STUDIES.rows().items()])
    )
    return 0


def _pairs(texts: list[str] | None) -> dict[str, str]:
    """Split ``NAME=VALUE``."""
    pairs = {}
    for text in texts or []:
        name, sign, value = text.partition("=")
        if not sign:
            raise InputError("not an option of a study", field="set", value=text, allowed="NAME=VALUE")
        pairs[name.strip()] = value.strip()
    return pairs


def _say(line: str) -> None:
    """Print progress on the error stream."""
    sys.stderr.write(f"{line}\n")


def _report(report: StudyReport, folder: Path) -> None:
    """Print the tables."""
    from metropilot.studies import literal_numbers, row_numbers, verdict_numbers

    out = console()
    if report.verdicts:
        cells = [(v.claim, *verdict_numbers(v), v.verdict, v.why) for v in report.verdicts]
        columns = ("claim", "published", "ours", "interval", "simple rival", "verdict", "why")
        out.print(table("Verdicts", columns, cells, right=(1, 2, 3), spare=("interval", "why")))
    for name, rows in report.tables().items():
        cells = [(r.case, r.driver, r.kpi, r.unit, *row_numbers(r)) for r in rows]
        columns = ("case", "driver", "KPI", "unit", "published", "ours", "range", "optimum")
        out.print(table(name, columns, cells, right=(4, 5, 6, 7), spare=("range", "unit")))
    if (literal := report.as_printed) is not None:
        settings = [(one.name, one.printed, one.ours) for one in literal.settings]
        out.print(table("Settings as printed", ("setting", "printed", "this study"), settings))
        cells = [(row.case, row.driver, row.kpi, row.unit, *literal_numbers(row)) for row in literal.rows]
        columns = ("case", "driver", "KPI", "unit", "published", "ours", "as printed", "range")
        out.print(table("As printed", columns, cells, right=(4, 5, 6, 7), spare=("range", "unit")))
        heading(out, "Under the printed settings", literal.remarks)
    heading(out, "Findings", report.remarks)
    heading(out, "Deviations from the paper", [f"{n}. {text}" for n, text in enumerate(report.deviations, 1)])
    out.print(f"\n{report.seeds} seeds in {report.seconds:.0f} s.")
    out.print(f"Written to {folder}: {report.study}.md, report.json, figures in {report.study}/")
