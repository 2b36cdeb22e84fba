"""`metropilot convoy`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot._schema import FieldSpec, field_specs
from metropilot.cli import options as opt
from metropilot.cli.console import console, number, print_json, requirements, show_activity, table
from metropilot.convoy import CONVOY_PERIOD_S, ConvoyRequest, Link, convoy_from_json, in_run_json
from metropilot.errors import InputError, rename_fields
from metropilot.sim import Disturbance

if TYPE_CHECKING:
    from metropilot.convoy import ConvoyKpis, Manoeuvre, MemberKpis

EXAMPLES = {
    "convoy": (
        "metropilot convoy yizhuang RJ WYJ --time 115 --trainsets 3",
        "metropilot convoy yizhuang RJ WYJ --time 115 --driver follow_mpc --link-delay 0.3 --out convoy",
        "metropilot convoy yizhuang RJ WYJ --time 130 --start-gap 200",
        "metropilot convoy yizhuang RJ WYJ --time 130 --uncouple-at 900 --apart 100",
        "metropilot convoy yizhuang RJ WYJ --time 130 --behind cheng2023 --start-gap 100",
        "metropilot convoy yizhuang YZQ WHY --trainset cheng2023 --mass-factors 1,1.2 --head-emergency 40",
        "metropilot convoy --from convoy/run.json",
    ),
}
CONVOY, LINK = "The convoy", "The link between trainsets"


HEAD = FieldSpec("Driver of the head; see `metropilot drivers`.", option="head")
OPTIONS = (
    *opt.options_of(ConvoyRequest, CONVOY),
    *opt.options_of(Link, LINK, "link_"),
    opt.option_of("head_driver", HEAD, str, "optimal", CONVOY),
)


@opt.with_run_options("driver", more=OPTIONS, dt_s=CONVOY_PERIOD_S)
def convoy_command(
    context: Any,  # noqa: ANN401 (typer.Context, as far as typer knows)
    line: Annotated[str | None, opt.LINE] = None,
    origin: Annotated[str | None, opt.ORIGIN] = None,
    destination: Annotated[str | None, opt.DESTINATION] = None,
    again: Annotated[
        Path | None, typer.Option("--from", metavar="RUN.JSON", help="Repeat the run of this file.")
    ] = None,
    mass_factors: Annotated[
        str | None,
        typer.Option(
            metavar="F,F,...",
            help="True over nominal mass of each trainset, the head first.",
            rich_help_panel=opt.WORLD,
        ),
    ] = None,
    behind: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TRAINSET",
            help="Trainset of the first follower, if not the head's; repeat for those behind it.",
            rich_help_panel=CONVOY,
        ),
    ] = None,
    out: opt.Out = None,
    as_json: opt.Json = False,
    **given: Any,  # noqa: ANN401 (the fields of a run, of a convoy and of its link)
) -> int:
    """Drive virtually coupled trainsets: a head, and followers a few metres behind each other.

    Disturbances act on every trainset. Exit code 0: every trainset met every requirement shown; 1: not;
    2: invalid input.
    """
    opt.check_source(context, again, "run.json", line, origin, destination)
    if again is not None:
        request = convoy_from_json(again)
        with in_run_json(again):
            return run_and_report(request, out, as_json=as_json)
    if opt.is_typed(context, "apart_m") and not opt.is_typed(context, "uncouple_at_m"):
        raise InputError("needs a place of uncoupling", field="apart", allowed="--uncouple-at M")
    values = {name: given.pop(name) for name in ("options", *field_specs(ConvoyRequest))}
    values["link"] = {name: given.pop(f"link_{name}") for name in field_specs(Link)}
    values["head"] = {"line": line, "origin": origin, "destination": destination}
    values["head"] |= {"driver": given.pop("head_driver"), **given}
    values["behind"] = behind
    if mass_factors:
        if opt.is_typed(context, "mass_factor"):
            raise InputError("given beside --mass-factors", field="mass_factor", allowed="one of them")
        disturbance = {name: given[name] for name in field_specs(Disturbance)}
        values["disturbances"] = [disturbance | {"mass_factor": f} for f in _factors(mass_factors)]
    numbered = (f"disturbances.{k}.mass_factor" for k in range(len(values.get("disturbances", ()))))
    names = dict.fromkeys(("disturbances", *numbered), "mass_factors")
    with rename_fields(names | {"driver": "head_driver"}):
        return run_and_report(ConvoyRequest.from_values(values), out, as_json=as_json)


def _factors(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(
            "not a list of numbers", field="mass-factors", value=text, allowed="e.g. 1,1.2,0.8"
        ) from None


def run_and_report(request: ConvoyRequest, out: Path | None, *, as_json: bool) -> int:
    """Drive, print and write; return the exit code."""
    from metropilot._io import check_writable
    from metropilot.convoy import convoy_kpis, write_convoy

    if out is not None:
        check_writable(out, "convoy.svg")
    with show_activity(f"driving {request.count} trainsets with {request.follower}"):
        convoy, follower = request.convoy(), request.make_follower()
        scheduled = request.scheduled_time_s(convoy)
        drive = request.drive(convoy, follower)
        kpis = convoy_kpis(drive, scheduled)
    if out is not None:
        with show_activity(f"writing {out}"):
            write_convoy(out, request, drive, kpis)
    if as_json:
        print_json(kpis.as_dict())
    else:
        report(request, kpis)
        if out is not None:
            console().print(f"Written to {out}: trajectory-N.csv kpis.json convoy.svg convoy.png run.json")
    return 0 if kpis.success else 1


def name_trainsets(request: ConvoyRequest) -> str:
    """Trainsets of a convoy in words: their number, and each one of a mixed convoy."""
    known, behind = request.head.resolve(), request.behind
    head = f"{known.trainset} {known.load}"
    if not behind:
        return f"{request.count} x {head}"
    each = (head, *behind, *behind[-1:] * (request.count - 1 - len(behind)))
    return f"{request.count} trainsets ({', '.join(each)})"


def report(request: ConvoyRequest, kpis: ConvoyKpis) -> None:
    """Print the convoy."""
    out, known = console(), request.head.resolve()
    where = f"{known.line} {known.origin} → {known.destination}, {name_trainsets(request)}"
    style = "bold" if kpis.success else "bold red"
    out.print(f"{where}, {request.follower} behind {known.driver}: {kpis.verdict}", style=style)
    out.print(
        f"gap {kpis.gap_min_m:.2f} to {kpis.gap_max_m:.2f} m, speed difference at most "
        f"{kpis.speed_difference_max_mps:.3f} m/s, scheduled {kpis.scheduled_time_s:g} s"
    )
    if kpis.joint_gap_percent is not None:
        out.print(
            f"{kpis.energy_wheel_kwh:.2f} kWh at the wheel, {kpis.joint_gap_percent:.1f} % above the joint "
            f"optimum of {kpis.joint_optimal_energy_kwh:.2f} kWh"
        )
    out.print(requirements(kpis.checks))
    columns = (
        *("trainset", "driver", "outcome", "time s", "stop m", "gap m", "gap error m", "speed diff. m/s"),
        *("wheel kWh", "optimum kWh", "line kWh", "jerk m/s³", "interventions"),
    )
    spare = (
        "line kWh",
        "optimum kWh",
        "gap error m",
        "wheel kWh",
        "speed diff. m/s",
        "time s",
        "outcome",
        "stop m",
    )
    rows = map(_row, kpis.trainsets)
    out.print(table("", columns, rows, right=range(3, len(columns)), spare=spare))
    if kpis.manoeuvres:
        columns = ("manoeuvre", "trainset", "from s", "to s", "from m", "to m", "gap m", "smallest gap m")
        columns = (*columns, "wheel kWh", "gap kept kWh", "jerk m/s³")
        rows = map(_manoeuvre_row, kpis.manoeuvres)
        spare = ("smallest gap m", "from s", "to s", "jerk m/s³")
        out.print(table("", columns, rows, right=range(2, len(columns)), spare=spare))
        out.print(
            "Positions: front of the trainset ahead; gap kept: the same trainset at the gap of the beginning."
        )


def _row(member: MemberKpis) -> tuple[str, ...]:
    """Cells of one trainset."""
    return (
        str(member.number),
        member.driver,
        member.outcome.replace("_", " "),
        number(member.running_time_s, 1),
        f"{member.stopping_error_m:+.2f}",
        "–" if member.gap_min_m is None else f"{member.gap_min_m:.2f}–{member.gap_max_m:.2f}",
        number(member.gap_error_m, 2),
        number(member.speed_difference_max_mps, 3),
        number(member.energy_wheel_kwh, 2),
        number(member.joint_energy_kwh, 2),
        number(member.energy_line_kwh, 2),
        number(member.max_jerk_mps3, 2),
        str(member.interventions),
    )


def _manoeuvre_row(each: Manoeuvre) -> tuple[str, ...]:
    """Cells of one manoeuvre."""
    return (
        each.kind,
        str(each.trainset),
        number(each.begun_s, 1),
        number(each.done_s, 1),
        number(each.begun_m, 0),
        number(each.done_m, 0),
        f"{each.gap_from_m:.1f}–{each.gap_to_m:g}",
        number(each.gap_min_m, 2),
        number(each.energy_kwh, 2),
        number(each.apart_energy_kwh, 2),
        number(each.max_jerk_mps3, 2),
    )
