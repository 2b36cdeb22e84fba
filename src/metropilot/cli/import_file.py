"""`metropilot import`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metropilot.cli import options as opt
from metropilot.cli.console import console, heading, print_json
from metropilot.errors import InputError
from metropilot.units import KMH_PER_MPS

if TYPE_CHECKING:
    from metropilot.railway import Journey, Line, Trainset
EXAMPLES = {
    "import": (
        "metropilot import CN_Songjiazhuang_Yizhuang.json --out my_line.toml",
        "metropilot drive my_line.toml 0 1 --time 160",
    ),
}


def import_command(
    file: Annotated[
        Path, typer.Argument(help="TTOBench JSON or metropilot TOML: a line, a trainset or a journey.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="File to write; NAME.toml here if not given.", rich_help_panel=opt.OUTPUT),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write over an existing file.", rich_help_panel=opt.OUTPUT)
    ] = False,
    as_json: opt.Json = False,
) -> int:
    """Read a line, trainset or journey file and write it as TOML.

    Prints the contents of the file and which of its blocks are unused. The written file can be used wherever
    a line or a trainset is expected.
    """
    from metropilot.railway import (
        Feeding,
        Journey,
        Line,
        ServiceDay,
        import_file,
        write_journey,
        write_line,
        write_trainset,
    )

    found = import_file(file)
    if isinstance(found, Feeding | ServiceDay):
        raise InputError("needs no import", file=file, allowed="a line, a trainset or a journey")
    target = out if out is not None else Path(f"{found.id}.toml")
    if target.exists() and not force:
        raise InputError("the file exists", file=target, field="out", allowed="a new name, or --force")
    if isinstance(found, Line):
        kind = "line"
        write_line(found, target)
    elif isinstance(found, Journey):
        kind = "journey"
        write_journey(found, target)
    else:
        kind = "trainset"
        write_trainset(found, target)
    used = contents(found)
    unused = list(getattr(found, "unused", ()))
    notes = list(getattr(found, "notes", ()))
    if as_json:
        print_json(
            {
                "kind": kind,
                "id": found.id,
                "file": str(target),
                "used": used,
                "unused": unused,
                "notes": notes,
            }
        )
        return 0
    screen = console()
    screen.print(f"{kind} {found.id} written to {target}", style="bold")
    heading(screen, "used", used)
    heading(screen, "read but unused", unused)
    heading(screen, "kept for writing back", map(str, found.extra))
    heading(screen, "notes", notes)
    return 0


def contents(found: Line | Trainset | Journey) -> list[str]:
    """Contents of the file in words."""
    from metropilot.railway import Journey, Line

    if isinstance(found, Line):
        said = [
            f"{len(found.stations)} stations",
            f"{found.limit_mps.from_m.size} speed limits",
            f"{found.gradient_permil.from_m.size} gradients",
        ]
        said += [f"{len(found.curves)} curves"] if found.curves else []
        return said + ([f"{len(found.tunnels)} tunnels"] if found.tunnels else [])
    if isinstance(found, Journey):
        return [f"{len(found.points)} timing points"]
    loads = ", ".join(f"{name} {mass / 1000:.1f} t" for name, mass in found.loads.items())
    return [
        f"loads {loads}",
        f"length {found.length_m:g} m",
        f"top speed {KMH_PER_MPS * found.max_speed_mps:g} km/h",
    ]
