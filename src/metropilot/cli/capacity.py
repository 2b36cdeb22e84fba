"""`metropilot capacity`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot.cli import complete
from metropilot.cli import options as opt
from metropilot.cli.console import console, number, print_json, show_activity, table
from metropilot.convoy import ServiceOptions
from metropilot.errors import InputError
from metropilot.units import KMH_PER_MPS

if TYPE_CHECKING:
    from metropilot.convoy import Capacity
    from metropilot.railway import Line, Section

EXAMPLES = {
    "capacity": (
        "metropilot capacity yizhuang --platform 260 --out capacity",
        "metropilot capacity yizhuang WYJ RC --trainset cheng2023 --counts 1,2 --dwell 40 --json",
        "metropilot capacity yizhuang --counts 1 --age 0.36 --blocks 2 --places --out headways",
    ),
}
SERVICE = "The service"


@opt.with_run_options(only=("trainset", "load"), more=opt.options_of(ServiceOptions, SERVICE))
def capacity_command(
    line: opt.LineArgument,
    origin: Annotated[
        str | None,
        typer.Argument(
            help="First station; the line's first if not given.", autocompletion=complete.stations
        ),
    ] = None,
    destination: Annotated[
        str | None, typer.Argument(help="Last station; the line's last.", autocompletion=complete.stations)
    ] = None,
    counts: Annotated[
        str,
        typer.Option(
            metavar="N,N,...", help="Trainsets of a convoy; 1: no convoys.", rich_help_panel=SERVICE
        ),
    ] = "1,2,4,8",
    places: Annotated[
        bool,
        typer.Option(
            "--places",
            help="Show the least headway of every section and station too, of the shortest convoy.",
            rich_help_panel=SERVICE,
        ),
    ] = False,
    out: opt.Out = None,
    as_json: opt.Json = False,
    **given: Any,  # noqa: ANN401 (the fields of a service and of a run)
) -> int:
    """Compute the trainsets an hour of a line, alone and in convoys, and the least headway of each place.

    They stop at every station. Between convoys protection relies on a moving block, on declared brakes, or on
    fixed blocks (--blocks, --block-length).
    With --platform the result for platforms as long as each convoy stands beside it. Exit code 0: computed;
    2: invalid input.
    """
    from dataclasses import replace

    from metropilot._io import check_writable
    from metropilot.convoy import line_capacity, write_capacity
    from metropilot.railway import load_line, load_trainset

    trainset = load_trainset(given.pop("trainset"), given.pop("load"))
    service, where = ServiceOptions(**given), load_line(line)
    sections = _sections(where, origin, destination)
    if out is not None:
        check_writable(out)
    # Platforms that a convoy does not fit on are refused before anything is computed.
    services = [service] if service.platform_m is None else [service, replace(service, platform_m=None)]
    sizes = _counts(counts)
    activity = show_activity(f"driving {len(sections)} sections in convoys of {counts}")
    with activity, opt.name_stall(sections, trainset):
        found = [line_capacity(sections, trainset, sizes, options=each) for each in services]
    rows = [row for each in reversed(found) for row in each]
    ends = f"{sections[0].origin.name} – {sections[-1].destination.name}"
    title = f"{where.id} {ends}, {trainset.id} {trainset.load}"
    below = (
        f"dwell {service.dwell_s:g} s, running time {100 * service.reserve:g} % over the minimum, "
        f"messages {service.age_s:g} s old"
    )
    files = () if out is None else write_capacity(out, rows, title, below)
    if as_json:
        print_json({"service": title, "details": below, "rows": [row.as_dict() for row in rows]})
        return 0
    columns = ("convoy", "platform m", "between convoys", "trainsets/h", "headway s", "length m", "stops")
    columns = (*columns, "journey s", "plain line/h", "nearest")
    spare = ("length m", "journey s", "stops", "nearest", "plain line/h")
    shown = table(f"{title}; {below}", columns, map(_row, rows), right=(0, 1, 3, 4, 5, 6, 7, 8), spare=spare)
    console().print(shown)
    if places:
        _print_places(rows, title)
    if out is not None:
        console().print(f"Written to {out}: {' '.join(files)}")
    return 0


def _print_places(rows: Sequence[Capacity], title: str) -> None:
    """Least headways of sections and stations, of the shortest convoy at the platforms asked for."""
    shortest = min(row.count for row in rows)
    chosen = {row.guard: row.blocking for row in rows if row.count == shortest and row.blocking}
    for guard, blocking in chosen.items():
        cells = [
            (
                each.kind,
                each.name,
                number(each.headway_s, 1),
                number(each.from_m, 0) if each.from_m == each.to_m else f"{each.from_m:.0f}–{each.to_m:.0f}",
                number(KMH_PER_MPS * each.speed_mps, 0),
                "binds" if each.binds else "",
            )
            for each in blocking.places
        ]
        columns = ("", "place", "headway s", "blocked m", "at km/h", "")
        console().print(
            table(
                f"{title}, convoy of {shortest}, {guard.replace('_', ' ')}", columns, cells, right=(2, 3, 4)
            )
        )


def _counts(text: str) -> tuple[int, ...]:
    try:
        return tuple(dict.fromkeys(int(word) for word in text.split(",")))
    except ValueError:
        raise InputError("not a list of counts", field="counts", value=text, allowed="e.g. 1,2,4,8") from None


def _sections(line: Line, origin: str | None, destination: str | None) -> tuple[Section, ...]:
    """The sections between two stations, with every stop on the way."""
    opt.check_both(origin, destination)
    stations = list(line.stations)
    first = stations.index(line.station(origin)) if origin else 0
    last = stations.index(line.station(destination)) if destination else len(stations) - 1
    between = stations[first : last + 1] if first <= last else stations[last : first + 1][::-1]
    return tuple(line.section(a, b) for a, b in pairwise(between))


def _row(row: Capacity) -> tuple[str, ...]:
    """Cells of one row."""
    return (
        str(row.count),
        "its length" if row.platform_m is None else f"{row.platform_m:g}",
        row.guard.replace("_", " "),
        number(row.trainsets_per_h, 1),
        number(row.headway_s, 1),
        number(row.convoy_m, 0),
        str(row.stops_at_platform),
        number(row.journey_s, 0),
        number(row.plain_per_h, 0),
        row.bottleneck,
    )
