"""`metropilot drive`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot.cli import options as opt
from metropilot.cli.console import console, print_json, requirements, show_activity, table

if TYPE_CHECKING:
    from metropilot.evaluate import Kpis, RunSpec
EXAMPLES = {
    "drive": (
        "metropilot drive yizhuang RJ WYJ --time 101 --out drive",
        "metropilot drive yizhuang rongjing wanyuan --load AW2 --mass-factor 1.2 --speed-noise 0.05",
        "metropilot drive yizhuang RJ WYJ --time 101 --restriction 400-600@40@30 --arrive 116@30",
        "metropilot drive --from drive/run.toml",
    ),
}


@opt.with_run_options()
def drive_command(
    context: Any,  # noqa: ANN401 (typer.Context, as far as typer knows)
    line: Annotated[str | None, opt.LINE] = None,
    origin: Annotated[str | None, opt.ORIGIN] = None,
    destination: Annotated[str | None, opt.DESTINATION] = None,
    again: Annotated[
        Path | None, typer.Option("--from", metavar="RUN.TOML", help="Repeat the run of this file.")
    ] = None,
    out: opt.Out = None,
    as_json: opt.Json = False,
    **given: Any,  # noqa: ANN401 (the fields of a run)
) -> int:
    """Drive one run under protection and report it.

    Exit code 0: every requirement shown was met; 1: not; 2: invalid input.
    """
    from metropilot.evaluate import RunSpec, in_run_toml, run_from_toml

    opt.check_source(context, again, "run.toml", line, origin, destination)
    if again is not None:
        spec = run_from_toml(again)
        with in_run_toml(again):
            return run_and_report(spec, out, as_json=as_json)
    spec = RunSpec.from_values({"line": line, "origin": origin, "destination": destination, **given})
    return run_and_report(spec, out, as_json=as_json)


def run_and_report(request: RunSpec, out: Path | None, *, as_json: bool) -> int:
    """Drive, print and write; return the exit code."""
    from metropilot._io import check_writable
    from metropilot.evaluate import kpis_of, optimum_of, write_run
    from metropilot.sim import drive

    if out is not None:
        check_writable(out, "trajectory.csv")
    run, driver = request.run(), request.make_driver()
    with show_activity(f"driving {run.section.name} with {request.driver}"):
        drive_ = drive(run, driver)
        optimum = optimum_of(drive_, request.objective)
        kpis = kpis_of(drive_, optimum, request.objective)
    if out is not None:
        with show_activity(f"writing {out}"):
            write_run(out, request, drive_, kpis, optimum)
    if as_json:
        print_json(kpis.as_dict())
    else:
        report(request, kpis)
        if out is not None:
            files = "trajectory.csv kpis.json explanation.json profile.svg profile.png run.toml"
            console().print(f"Written to {out}: {files}")
    return 0 if kpis.success else 1


def report(request: RunSpec, kpis: Kpis) -> None:
    """Print the drive: requirements and KPIs."""
    from metropilot.evaluate import checks, kpi_rows, verdict

    out = console()
    known = request.resolve()
    where = f"{known.line} {known.origin} → {known.destination}"
    out.print(
        f"{where}, {known.trainset} {known.load}, driver {known.driver}: {verdict(kpis)}",
        style="bold" if kpis.success else "bold red",
    )
    out.print(requirements(checks(kpis)))
    out.print(table("", ("KPI", "value", ""), kpi_rows(kpis.as_dict()), right=(1,)))
