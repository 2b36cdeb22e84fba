"""`metropilot runs`, `metropilot tasks`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metropilot.cli import options as opt
from metropilot.cli.console import console, print_json, table
from metropilot.errors import InputError

EXAMPLES = {
    "runs": (
        "metropilot runs",
        "metropilot runs ppo drive --json",
    ),
    "tasks": (
        "metropilot tasks",
        "metropilot tasks --json",
    ),
}


def runs_command(
    words: Annotated[
        list[str] | None, typer.Argument(help="Only runs with these words in id, task, status or settings.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Folder of the runs; yours if not given.", rich_help_panel=opt.OUTPUT)
    ] = None,
    most: Annotated[int, typer.Option(min=1, help="At most so many.", rich_help_panel=opt.OUTPUT)] = 100,
    as_json: opt.Json = False,
) -> int:
    """List the learning runs, the newest first."""
    from metropilot._dirs import runs_folder
    from metropilot.cli.learn_report import clock, figure, run_as_json
    from metropilot.learn import RunStore

    if folder is not None and not any(folder.glob("*/run.toml")):
        allowed = "a folder with the folders of runs"
        raise InputError("no runs in it", field="folder", value=str(folder), allowed=allowed)
    store = RunStore(folder or runs_folder())
    found = store.find(" ".join(words or ()), most)
    if as_json:
        print_json([run_as_json(record, store.folder(record.id)) for record in found])
        return 0
    rows = [
        (
            record.id,
            record.driver or record.algorithm,
            record.task,
            str(record.seed),
            record.status,
            f"{record.steps:,}".replace(",", " "),
            clock(record.seconds),
            figure(record.kpis.get("safe_share"), 0, 100.0),
            figure(record.kpis.get("gap_percent"), 2),
        )
        for record in found
    ]
    columns = ("id", "driver", "task", "seed", "status", "steps", "time", "safe %", "above optimum %")
    console().print(
        table("", columns, rows, right=(3, 5, 6, 7, 8), spare=("seed", "time", "above optimum %"))
    )
    if not rows:
        console().print(f"No runs in {store.root}")
    return 0


def tasks_command(as_json: opt.Json = False) -> int:
    """List the tasks that can be learned."""
    from metropilot.env import TASKS
    from metropilot.learn import RECIPES

    used = {name: [key for key in RECIPES if RECIPES.get(key).task == name] for name in TASKS}
    if as_json:
        print_json(
            [
                {"id": name, "summary": row.summary, "drivers": used[name]}
                for name, row in TASKS.rows().items()
            ]
        )
        return 0
    rows = [(name, row.summary, ", ".join(used[name])) for name, row in TASKS.rows().items()]
    console().print(table("", ("id", "what is learned", "drivers learned on it"), rows))
    return 0
