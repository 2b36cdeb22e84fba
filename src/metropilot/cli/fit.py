"""`metropilot fit`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metropilot.cli import complete
from metropilot.cli import options as opt
from metropilot.cli.console import console, heading, print_json, show_activity, table
from metropilot.errors import InputError

if TYPE_CHECKING:
    from metropilot.fit import Calibration, FittedParameter
EXAMPLES = {
    "fit": (
        "metropilot fit run/trajectory.csv --trainset dkz32 --out fitted",
        "metropilot fit monday.csv tuesday.csv --trainset dkz32 --load AW2 --line yizhuang RJ WYJ",
        "metropilot fit log.csv --trainset mine.toml --keep brake --json",
    ),
}


def fit_command(
    logs: Annotated[
        list[Path],
        typer.Argument(help="CSV logs with time, speed and command or effort; units in the header."),
    ],
    trainset: Annotated[
        str,
        typer.Option(
            help="Trainset to begin from: catalogue id or path.",
            autocompletion=complete.trainsets,
            rich_help_panel=opt.ABOUT,
        ),
    ],
    load: Annotated[
        str | None, typer.Option(help="Load aboard in the logs, e.g. AW0.", rich_help_panel=opt.ABOUT)
    ] = None,
    line: Annotated[
        tuple[str, str, str] | None,
        typer.Option(
            metavar="LINE ORIGIN DESTINATION",
            help="Section that every log runs over, for its gradients; else a gradient column is read.",
            rich_help_panel=opt.ABOUT,
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            "--input",
            help="Input of the model: command or effort; command if not given and logged.",
            rich_help_panel=opt.ABOUT,
        ),
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option(
            help="Parameter that is not estimated: mass, brake, resistance, delay or lag; repeatable.",
            rich_help_panel=opt.ABOUT,
        ),
    ] = None,
    resistance: Annotated[
        str,
        typer.Option(
            help="Resistance: one factor, its three coefficients, or auto: three if the logs determine them.",
            rich_help_panel=opt.ABOUT,
        ),
    ] = "auto",
    out: opt.Out = None,
    as_json: opt.Json = False,
) -> int:
    """Estimate a trainset's parameters from logs of runs.

    Mass, service brake, running resistance, dead time and lag, with 95 % intervals. With --out: the fitted
    trainset as TOML, which every command reads, residual plots and fit.json. Exit code 0: fitted; 2: the logs
    cannot be used or do not determine the parameters.
    """
    from metropilot._io import check_writable
    from metropilot.fit import GROUPS, SOURCES, fit_json, fit_trainset, read_log, write_fit
    from metropilot.fit import RESISTANCES as FORMS
    from metropilot.railway import load_line, load_trainset

    for name, given, allowed in (
        ("input", [source] if source else [], SOURCES),
        ("keep", keep or [], GROUPS),
        ("resistance", [resistance], FORMS),
    ):
        for value in given:
            if value not in allowed:
                raise InputError("unknown", field=f"--{name}", value=value, allowed=", ".join(allowed))
    base = load_trainset(trainset, load)
    sections = []
    if line is not None:
        where = load_line(line[0])
        sections = [where.section(where.station(line[1]), where.station(line[2]))]
    if out is not None:
        check_writable(out)
    read = [read_log(path) for path in logs]
    with show_activity("fitting"):
        found = fit_trainset(
            read,
            base,
            sections=sections,
            source=next((word for word in SOURCES if word == source), None),
            keep=keep or (),
            resistance=next(word for word in FORMS if word == resistance),
        )
    written = write_fit(found, out) if out is not None else None
    if as_json:
        print_json(fit_json(found) | {"file": str(written) if written else None})
        return 0
    _print(found)
    console().print(
        f"\ntrainset written to {written}"
        if written
        else "\n--out DIR writes the trainset, plots and fit.json"
    )
    return 0


def _print(found: Calibration) -> None:
    """Print the fit as tables."""
    from metropilot.fit import ambiguities, count_words

    screen = console()
    head = ("parameter", "trainset", "estimate", "95 % interval", "")
    screen.print(
        f"{found.nominal.id}, load {found.nominal.load}: {count_words(found)}, "
        f"input {found.source}, residuals {found.noise_mps:.3f} m/s",
        style="bold",
    )
    screen.print(table("", head, [_row(p) for p in found.parameters], right=(1, 2)))
    if any(p.estimated for p in found.resistance):
        screen.print(table("", head, [_row(p) for p in found.resistance], right=(1, 2)))
    for remark in ambiguities(found):
        screen.print(remark)
    heading(screen, "notes", found.notes)


def _row(p: FittedParameter) -> tuple[str, ...]:
    interval = f"{p.low:.4g} to {p.high:.4g}" if p.estimated else "kept"
    return p.label, f"{p.nominal:.4g}", f"{p.value:.4g}", interval, p.unit
