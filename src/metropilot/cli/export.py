"""`metropilot export`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metropilot._registry import did_you_mean
from metropilot.cli import complete
from metropilot.cli import options as opt
from metropilot.cli.console import console, print_json, show_activity, table
from metropilot.errors import InputError

if TYPE_CHECKING:
    from metropilot.cli.show_learned import PolicyFile

FORMATS = ("onnx", "c", "wasm")
TRAINSET = "dkz32"
CONTROLLER = "On a controller, in a browser (--to c, --to wasm)"
EXAMPLES = {
    "export": (
        "metropilot export ppo_scaled --to onnx --out ppo_scaled.onnx",
        "metropilot export mine --to onnx --json",
        "metropilot export generalist --to c --line yizhuang --sections RJ-WYJ --load AW2 --out aboard",
    ),
}


def export_command(
    what: Annotated[
        str,
        typer.Argument(metavar="DRIVER|RUN|FILE", help="Driver, learning run (folder or id) or policy file."),
    ],
    to: Annotated[str, typer.Option(help="Format: onnx; c or wasm, with protection.")] = "onnx",
    out: Annotated[
        Path | None,
        typer.Option(
            help="File to write, NAME.onnx here if not given; with --to c or wasm a folder.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None,
    line: Annotated[
        str | None,
        typer.Option(
            help="Line: catalogue id or path.", autocompletion=complete.lines, rich_help_panel=CONTROLLER
        ),
    ] = None,
    sections: Annotated[
        str | None,
        typer.Option(
            help="Sections, ORIGIN-DESTINATION,...; all of the line, both ways, if not given.",
            rich_help_panel=CONTROLLER,
        ),
    ] = None,
    trainset: Annotated[
        str | None,
        typer.Option(
            help=f"Trainset: catalogue id or path; {TRAINSET} if not given.",
            autocompletion=complete.trainsets,
            rich_help_panel=CONTROLLER,
        ),
    ] = None,
    load: Annotated[str | None, typer.Option(help="Load aboard.", rich_help_panel=CONTROLLER)] = None,
    number: Annotated[
        str | None, typer.Option(help="Number type: double or float.", rich_help_panel=CONTROLLER)
    ] = None,
    as_json: opt.Json = False,
) -> int:
    """Write a learned driver as ONNX or, with protection, a driver as C.

    ONNX: its policy, a graph from an observation to an action; the file's metadata describes both as JSON.
    Prints the largest difference of its actions from the policy's (parity, at most 1e-5) and the time of a
    decision.

    C: the whole driver (also pid, eitoe, eitop), and protection around it, for the sections of a line and a
    trainset; a folder with one header, one source file, test vectors and an example. WASM: the same
    compiled, with a door for JavaScript and a page to drive in; needs the package ziglang.
    """
    if to not in FORMATS:
        raise InputError("unknown format", field="to", value=to, allowed=", ".join(FORMATS))
    given = {"line": line, "sections": sections, "trainset": trainset, "load": load, "number": number}
    if to != "onnx":
        return write_c(what, to, out, as_json=as_json, **given)
    for name, value in given.items():
        if value is not None:
            raise InputError("only of --to c or wasm", field=name, value=value)
    return write_onnx(what, out, as_json=as_json)


def write_onnx(what: str, out: Path | None, *, as_json: bool) -> int:
    """Write a policy as ONNX and report it."""
    from metropilot.learn import export_onnx

    name, file = find_policy(what)
    path = out or Path(f"{name}.onnx")
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
    console().print(table(f"{what} as onnx", ("", "value", ""), rows, right=(1,)))
    console().print(f"Written to {path}")
    return 0


def write_c(
    what: str,
    to: str,
    out: Path | None,
    *,
    line: str | None,
    sections: str | None,
    trainset: str | None,
    load: str | None,
    number: str | None,
    as_json: bool,
) -> int:
    """Write a driver with protection as C, or also as WebAssembly, and report it."""
    from metropilot.aboard import NUMBERS, check_exportable, find_zig, trace_driver, write_driver
    from metropilot.drivers import DRIVERS, AbstractPolicyDriver
    from metropilot.policy import load_driving_policy
    from metropilot.railway import load_line, load_trainset

    for field, value in (("line", line), ("out", out)):
        if value is None:
            raise InputError("missing", field=field, allowed=f"--to {to} needs --{field}")
    number = number or "double"
    if number not in NUMBERS:
        raise InputError("unknown number type", field="number", value=number, allowed=", ".join(NUMBERS))
    compiler = find_zig() if to == "wasm" else None
    known = load_trainset(trainset or TRAINSET, load)
    check_exportable(what)
    if what in DRIVERS and not issubclass(DRIVERS.get(what), AbstractPolicyDriver):
        name, driver, policy = what, DRIVERS.get(what)(), None
    else:
        name, file = find_policy(what)
        driver, policy = load_driving_policy(file.path), str(file.path)
    chosen = load_line(str(line)).select_sections(sections)
    with show_activity(f"writing {out}"):
        program = trace_driver(name, driver, chosen, known, number=number)
        report = write_driver(program, Path(str(out)), compiler=compiler)
    if as_json:
        more = {"folder": str(report.folder), "driver": name, "trainset": known.id, "policy": policy}
        print_json(asdict(report) | more)
        return 0
    rows = [
        ("sections", str(len(report.sections)), " ".join(report.sections[:6])),
        ("constant tables", f"{report.table_bytes / 1000:.0f} kB", f"network included, in {number}"),
        ("test vectors", str(report.vectors), "control periods"),
    ]
    console().print(table(f"{what} as {to}, under protection", ("", "value", ""), rows, right=(1,)))
    console().print(f"Written to {report.folder}: {' '.join(report.files)}")
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
    if what in DRIVERS and not path.exists():
        words = "the driver has no policy of its own"
        raise InputError(words, field="export", value=what, allowed="a learned driver")
    if path.is_file() or path.suffix == ".safetensors":
        return path.stem, read_policy(path)
    try:
        store, record = find_run(what)
    except InputError as error:
        if error.message != "no such run":
            raise
        learned = [name for name in DRIVERS.ids() if shipped_policy(name).is_file()]
        words = f"no such driver or run{did_you_mean(what, learned)}"
        allowed = f"{', '.join(learned)}, a run or a policy file"
        raise InputError(words, field="export", value=what, allowed=allowed) from None
    return record.id, read_policy(policy_path(store.folder(record.id)))
