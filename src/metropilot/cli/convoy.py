"""`metropilot convoy`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot.cli import complete
from metropilot.cli import options as opt
from metropilot.cli.console import console, number, print_json, requirements, table, working
from metropilot.errors import InputError, rename_fields

if TYPE_CHECKING:
    from metropilot.convoy import ConvoyKpis, ConvoyRequest, MemberKpis

EXAMPLES = {
    "convoy": (
        "metropilot convoy yizhuang RJ WYJ --time 115 --trainsets 2 --driver follow_gap",
        "metropilot convoy yizhuang RJ WYJ --time 115 --driver follow_mpc --delay 0.3 --out convoy",
        "metropilot convoy yizhuang RJ WYJ --time 130 --start-gap 200 --uncouple-at 900",
        "metropilot convoy yizhuang YZQ WHY --trainset cheng2023 --mass-factors 1,1.2 --head-emergency 40",
    ),
}
OPTIONS = {
    "driver": "head",
    "follower": "driver",
    "count": "trainsets",
    "masses": "mass_factors",
    "emergency_s": "head_emergency",
}
"""Options with another name than their field of the request."""
RUN_FIELDS = ("time_s", "options", "trainset", "load", "dt_s", "seed")
CONVOY, LINK = "The convoy", "The link between trainsets"


@opt.with_run_options(only=RUN_FIELDS, dt_s=0.1)
def convoy_command(
    line: opt.LineArgument,
    origin: opt.OriginArgument,
    destination: opt.DestinationArgument,
    trainsets: Annotated[int, typer.Option(help="How many trainsets, 2 to 16.", rich_help_panel=CONVOY)] = 2,
    driver: Annotated[
        str,
        typer.Option(
            help="Driver of the followers; see `metropilot drivers --followers`.",
            rich_help_panel=CONVOY,
            autocompletion=complete.followers,
        ),
    ] = "follow_gap",
    head: Annotated[
        str,
        typer.Option(
            help="Driver of the head; see `metropilot drivers`.",
            rich_help_panel=CONVOY,
            autocompletion=complete.drivers,
        ),
    ] = "optimal",
    gap: Annotated[float, typer.Option(help="Desired gap, m.", rich_help_panel=CONVOY)] = 5.92,
    start_gap: Annotated[
        float | None,
        typer.Option(help="Gap at departure, m: the convoy couples on the move.", rich_help_panel=CONVOY),
    ] = None,
    uncouple_at: Annotated[
        float | None,
        typer.Option(help="Where the head begins to uncouple, m from the origin.", rich_help_panel=CONVOY),
    ] = None,
    apart: Annotated[
        float, typer.Option(help="Desired gap once uncoupled, m.", rich_help_panel=CONVOY)
    ] = 100.0,
    guard: Annotated[
        str,
        typer.Option(
            help="What protection relies on: coupled, independent, moving_block or none.",
            rich_help_panel=CONVOY,
        ),
    ] = "coupled",
    mass_factors: Annotated[
        str | None,
        typer.Option(
            metavar="F,F,...",
            help="True over nominal mass of each trainset, the head first.",
            rich_help_panel=opt.WORLD,
        ),
    ] = None,
    head_emergency: Annotated[
        float | None,
        typer.Option(help="When the head makes an emergency brake, s.", rich_help_panel=opt.WORLD),
    ] = None,
    delay: Annotated[float, typer.Option(help="Time a message takes, s.", rich_help_panel=LINK)] = 0.0,
    jitter: Annotated[float, typer.Option(help="Largest additional time, s.", rich_help_panel=LINK)] = 0.0,
    loss: Annotated[float, typer.Option(help="Share of messages lost.", rich_help_panel=LINK)] = 0.0,
    out: opt.Out = None,
    as_json: opt.Json = False,
    **given: Any,  # noqa: ANN401 (the fields of a run)
) -> int:
    """Drive virtually coupled trainsets: a head, and followers a few metres behind each other.

    Exit code 0: every trainset met every requirement shown; 1: not; 2: invalid input.
    """
    from metropilot.convoy import ConvoyRequest, Link
    from metropilot.evaluate import RunSpec

    where, options = {"line": line, "origin": origin, "destination": destination}, given.pop("options")
    with rename_fields(OPTIONS):
        request = ConvoyRequest(
            head=RunSpec.from_values({**where, "driver": head, **given}),
            count=trainsets,
            follower=driver,
            options=options,
            gap_m=gap,
            start_gap_m=start_gap,
            apart_m=apart,
            uncouple_at_m=uncouple_at,
            link=Link(delay, jitter, loss),
            guard=guard,  # pyright: ignore[reportArgumentType] (checked by Convoy)
            masses=_factors(mass_factors),
            emergency_s=head_emergency,
        )
        return run_and_report(request, out, as_json=as_json)


def _factors(text: str | None) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in text.split(",")) if text else ()
    except ValueError:
        raise InputError(
            "not a list of numbers", field="mass-factors", value=text, allowed="e.g. 1,1.2,0.8"
        ) from None


def run_and_report(request: ConvoyRequest, out: Path | None, *, as_json: bool) -> int:
    """Drive, print and write; return the exit code."""
    from metropilot._io import check_writable
    from metropilot.convoy import convoy_kpis, write_convoy

    if out is not None:
        check_writable(out)
    with working(f"driving {request.count} trainsets with {request.follower}"):
        convoy, follower = request.convoy(), request.make_follower()
        scheduled = request.run(convoy).scheduled_time_s
        drive = request.drive(convoy, follower)
        kpis = convoy_kpis(drive, scheduled)
    if out is not None:
        with working(f"writing {out}"):
            write_convoy(out, request, drive, kpis)
    if as_json:
        print_json(kpis.as_dict())
    else:
        report(request, kpis)
        if out is not None:
            console().print(f"Written to {out}: trajectory-N.csv kpis.json convoy.svg convoy.png run.json")
    return 0 if kpis.success else 1


def report(request: ConvoyRequest, kpis: ConvoyKpis) -> None:
    """Print the convoy."""
    out, known = console(), request.head.resolved()
    where = (
        f"{known.line} {known.origin} → {known.destination}, {request.count} x {known.trainset} {known.load}"
    )
    style = "bold" if kpis.success else "bold red"
    out.print(f"{where}, {request.follower} behind {known.driver}: {kpis.verdict}", style=style)
    out.print(
        f"gap {kpis.gap_min_m:.2f} to {kpis.gap_max_m:.2f} m, speed difference at most "
        f"{kpis.speed_difference_max_mps:.3f} m/s, scheduled {kpis.scheduled_time_s:g} s"
    )
    out.print(requirements(kpis.checks))
    columns = (
        *("trainset", "driver", "outcome", "time s", "stop m", "gap m", "speed diff. m/s"),
        *("wheel kWh", "line kWh", "jerk m/s³", "interventions"),
    )
    spare = ("line kWh", "wheel kWh", "speed diff. m/s", "time s", "outcome", "stop m")
    rows = map(_row, kpis.trainsets)
    out.print(table("", columns, rows, right=range(3, len(columns)), spare=spare))


def _row(member: MemberKpis) -> tuple[str, ...]:
    """Cells of one trainset."""
    return (
        str(member.number),
        member.driver,
        member.outcome.replace("_", " "),
        number(member.running_time_s, 1),
        f"{member.stopping_error_m:+.2f}",
        "–" if member.gap_min_m is None else f"{member.gap_min_m:.2f}–{member.gap_max_m:.2f}",
        number(member.speed_difference_max_mps, 3),
        number(member.energy_wheel_kwh, 2),
        number(member.energy_line_kwh, 2),
        number(member.max_jerk_mps3, 2),
        str(member.interventions),
    )
