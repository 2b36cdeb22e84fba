"""`metropilot export`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metropilot.cli import options as opt
from metropilot.cli.console import console, print_json, show_activity, table
from metropilot.errors import InputError

if TYPE_CHECKING:
    from metropilot.cli.show_learned import PolicyFile

FORMATS = ("onnx",)
EXAMPLES = {
    "export": (
        "metropilot export ppo_scaled --to onnx --out ppo_scaled.onnx",
        "metropilot export mine --to onnx --json",
    ),
}


def export_command(
    what: Annotated[
        str,
        typer.Argument(
            metavar="DRIVER|RUN|FILE", help="Learned driver, learning run (folder or id) or policy file."
        ),
    ],
    to: Annotated[str, typer.Option(help="Format: onnx.")] = "onnx",
    out: Annotated[
        Path | None,
        typer.Option(help="File to write; NAME.onnx here if not given.", rich_help_panel=opt.OUTPUT),
    ] = None,
    as_json: opt.Json = False,
) -> int:
    """Write a learned driver's policy in another format.

    Prints the largest difference of its actions from the policy's (parity, at most 1e-5) and the time of a
    decision. The graph maps an observation to an action; the file's metadata describes both as JSON.
    """
    from metropilot.learn import export_onnx

    if to not in FORMATS:
        raise InputError("unknown format", field="to", value=to, allowed=", ".join(FORMATS))
    name, file = find_policy(what)
    path = out or Path(f"{name}.{to}")
    with show_activity(f"writing {path}"):
        report = export_onnx(file.policy, path, about=file.about)
    if as_json:
        print_json(asdict(report) | {"path": str(path), "policy": str(file.path)})
        return 0
    rows = [
        ("parity: largest difference of an action", f"{report.parity:.1e}", f"{report.probes} observations"),
        ("decision, median", f"{report.latency_us_median:.1f} µs", "onnxruntime, one thread"),
        ("decision, 99th percentile", f"{report.latency_us_p99:.1f} µs", ""),
        ("size", f"{report.bytes / 1000:.1f} kB", ""),
    ]
    console().print(table(f"{what} as {to}", ("", "value", ""), rows, right=(1,)))
    console().print(f"Written to {path}")
    return 0


def find_policy(what: str) -> tuple[str, PolicyFile]:
    """Find the policy of a driver's id, a run or a file, and a short name for it.

    Raises:
        InputError: There is no such policy.
    """
    from metropilot.cli.learn import find_run
    from metropilot.cli.show_learned import read_policy
    from metropilot.drivers import DRIVERS
    from metropilot.policy import policy_path, shipped_policy

    path = Path(what).expanduser()
    if not path.exists() and what.isidentifier() and shipped_policy(what).is_file():
        return what, read_policy(shipped_policy(what))
    if what in DRIVERS.ids() and not path.exists():
        words = "the driver has no policy of its own"
        raise InputError(words, field="export", value=what, allowed="a learned driver")
    if path.is_file() or path.suffix == ".safetensors":
        return path.stem, read_policy(path)
    store, record = find_run(what)
    return record.id, read_policy(policy_path(store.folder(record.id)))
