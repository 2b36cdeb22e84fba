"""`metropilot plan`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from metropilot.cli import complete
from metropilot.cli import options as opt
from metropilot.errors import InputError

EXAMPLES = {
    "plan": (
        "metropilot plan yizhuang RJ WYJ --time 101",
        "metropilot plan yizhuang RJ WYJ --front --out front",
        "metropilot plan yizhuang YZHC SJZ --stopping --time 2100 --json",
        "metropilot plan yizhuang --journey timetable.toml",
    ),
}


@opt.with_run_options(only=("trainset", "load", "objective"))
def plan_command(
    line: opt.LineArgument,
    origin: Annotated[
        str | None,
        typer.Argument(
            help="Station of departure; the line's first if not given.", autocompletion=complete.stations
        ),
    ] = None,
    destination: Annotated[
        str | None,
        typer.Argument(help="Station of arrival; the line's last.", autocompletion=complete.stations),
    ] = None,
    time: Annotated[
        float | None,
        typer.Option(
            "--time",
            help="Running time, s; of a journey: the whole, dwells included.",
            rich_help_panel=opt.ABOUT,
        ),
    ] = None,
    journey: Annotated[
        Path | None,
        typer.Option(help="Journey file with timing points, .toml or .json.", rich_help_panel=opt.ABOUT),
    ] = None,
    stopping: Annotated[
        bool, typer.Option("--stopping", help="Call at every station on the way.", rich_help_panel=opt.ABOUT)
    ] = False,
    front: Annotated[
        bool, typer.Option("--front", help="Optimal energy from 1.02 to 1.6 of the minimum running time.")
    ] = False,
    jerk: Annotated[
        float | None,
        typer.Option(help="Jerk limit that the plan allows for, m/s³.", rich_help_panel=opt.ABOUT),
    ] = None,
    out: opt.Out = None,
    as_json: opt.Json = False,
    **given: Any,  # noqa: ANN401 (the fields of a run)
) -> int:
    """Compute the optimal plan, its certificate, the time-energy front.

    With two stations: one run without stops between them (with --stopping: a journey). Without: the journey
    over the whole line. A journey keeps the line's timetable unless --time gives the total time, which the
    optimum distributes over the sections. Exit code 0: planned; 2: no such plan.
    """
    from metropilot.cli import plan_reports as reports
    from metropilot.evaluate import run_fields
    from metropilot.planning import PlanOptions
    from metropilot.railway import load_line, load_trainset

    opt.check_both(origin, destination)
    trainset, load, objective = (given[key] for key in ("trainset", "load", "objective"))
    run_fields()["objective"].check("objective", objective)
    _check_numbers(time, jerk, {"front": front, "journey": journey is not None})
    if journey is not None:
        for name, extra in {"origin": origin, "stopping": stopping or None}.items():
            if extra is not None:
                words = "not beside --journey: its timing points say where it stops"
                raise InputError(words, field=name, value=origin, allowed="one of them")
    where = load_line(line)
    asked = reports.PlanArguments(
        load_trainset(trainset, load), PlanOptions(objective=objective, jerk_mps3=jerk), out, as_json
    )
    ends = (where.station(origin), where.station(destination)) if origin and destination else None
    if out is not None:
        from metropilot._io import check_writable

        check_writable(out)
    if journey is None and ends is not None and not stopping:
        section = where.section(*ends)
        with opt.name_stall([section], asked.trainset):
            return reports.front(asked, section) if front else reports.run(asked, section, time)
    if front:
        raise InputError("a front is drawn for one section", field="front", allowed="LINE ORIGIN DESTINATION")
    with opt.name_stall((*where.sections(), *where.sections(backward=True)), asked.trainset):
        if journey is not None:
            return reports.timetable(asked, where, journey)
        return reports.journey(asked, where, ends, time)


def _check_numbers(time: float | None, jerk: float | None, without_time: Mapping[str, bool]) -> None:
    """Refuse a running time or a jerk limit that is none, and a time beside what has its own.

    Args:
        time: Running time, s.
        jerk: Jerk limit, m/s³.
        without_time: Options that ask for no time, and if they are given.
    """
    if jerk is not None and not 0 < jerk < float("inf"):
        raise InputError("out of range", field="jerk", value=jerk, unit="m/s³", allowed="> 0, finite")
    if time is None:
        return
    if not 0 < time < float("inf"):
        raise InputError(
            "running time out of range", field="time", value=time, unit="s", allowed="> 0, finite"
        )
    for name, given in without_time.items():
        if given:
            raise InputError(f"no time beside --{name}", field="time", value=time, allowed="one of them")
