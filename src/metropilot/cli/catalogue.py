"""`metropilot lines`, `metropilot trainsets`, `metropilot drivers`."""

from __future__ import annotations

from typing import Annotated

import typer

from metropilot.cli import options as opt
from metropilot.cli.console import console, print_json, table
from metropilot.units import KMH_PER_MPS

EXAMPLES = {
    "lines": (
        "metropilot lines",
        "metropilot lines --json",
    ),
    "trainsets": (
        "metropilot trainsets",
        "metropilot trainsets --json",
    ),
    "drivers": (
        "metropilot drivers",
        "metropilot drivers --json",
        "metropilot drivers --followers",
    ),
}


def lines_command(as_json: opt.Json = False) -> int:
    """List the lines of the catalogue."""
    from metropilot.railway import list_lines, load_line

    found = [load_line(key) for key in list_lines()]
    if as_json:
        print_json(
            [
                {
                    "id": line.id,
                    "name": line.name,
                    "stations": len(line.stations),
                    "length_m": line.stations[-1].position_m - line.stations[0].position_m,
                    "source": dict(line.source),
                }
                for line in found
            ]
        )
        return 0
    rows = []
    for line in found:
        ends = line.stations[0], line.stations[-1]
        length = f"{(ends[1].position_m - ends[0].position_m) / 1000:.2f}"
        rows.append((line.id, line.name, str(len(line.stations)), length, f"{ends[0].name} – {ends[1].name}"))
    columns = ("id", "name", "stations", "km", "from – to")
    console().print(table("", columns, rows, right=(2, 3), spare=("stations", "km")))
    return 0


def trainsets_command(as_json: opt.Json = False) -> int:
    """List the trainsets of the catalogue."""
    from metropilot.railway import list_trainsets, load_trainset

    found = [load_trainset(key) for key in list_trainsets()]
    if as_json:
        print_json(
            [
                {
                    "id": t.id,
                    "name": t.name,
                    "loads_kg": dict(t.loads),
                    "load": t.load,
                    "length_m": t.length_m,
                    "max_speed_mps": t.max_speed_mps,
                }
                for t in found
            ]
        )
        return 0
    rows = []
    for t in found:
        loads = ", ".join(f"{name} {mass / 1000:.1f} t" for name, mass in t.loads.items())
        rows.append((t.id, t.name, loads, f"{t.length_m:g}", f"{KMH_PER_MPS * t.max_speed_mps:g}"))
    console().print(table("", ("id", "name", "loads", "length m", "max km/h"), rows, right=(3, 4)))
    return 0


def drivers_command(
    followers: Annotated[
        bool,
        typer.Option("--followers", help="List instead the drivers of trainsets that follow in a convoy."),
    ] = False,
    as_json: opt.Json = False,
) -> int:
    """List the drivers, or those of followers in a convoy."""
    from metropilot.convoy import FOLLOWERS
    from metropilot.drivers import DRIVERS

    registry = FOLLOWERS if followers else DRIVERS
    rows = [(key, row.summary, row.source) for key, row in registry.rows().items()]
    if as_json:
        print_json([dict(zip(("id", "summary", "source"), row, strict=True)) for row in rows])
        return 0
    console().print(table("", ("id", "what it does", "source"), rows))
    if not followers:
        console().print("Drivers that follow in a convoy: metropilot drivers --followers")
    return 0
