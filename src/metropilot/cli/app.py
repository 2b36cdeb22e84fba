"""The entry point: one command is imported for each call, and every error is one line."""

from __future__ import annotations

import _thread
import errno
import math
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import pairwise
from threading import Timer
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

import metropilot
from metropilot._schema import Range
from metropilot.cli.complete import words_to_complete
from metropilot.cli.options import INTERRUPTED, UNIT
from metropilot.errors import InputError, MetropilotError

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

SUMMARY = "Compute, learn, compare and explain how a metro train should be driven, against the optimum."
BAD_INPUT = 2
AGAIN_S = 0.05
NO_ENDS = -math.inf, math.inf
EMPTY = re.compile(r"--[a-z-]+=")

COMMANDS: dict[str, tuple[str, str]] = {
    "drive": ("metropilot.cli.drive", "Drive one run under protection and report it."),
    "compare": ("metropilot.cli.compare", "Drive the same run with several drivers."),
    "convoy": (
        "metropilot.cli.convoy",
        "Drive virtually coupled trainsets: a head, and followers a few metres behind each other.",
    ),
    "capacity": (
        "metropilot.cli.capacity",
        "Compute the trainsets an hour of a line, alone and in convoys, and the least headway of each place.",
    ),
    "line": ("metropilot.cli.line", "Compute the energy of all trains of a line, beside its floor."),
    "campaign": (
        "metropilot.cli.campaign",
        "Compute a declared matrix of runs or lines, resumable, and report it.",
    ),
    "plan": ("metropilot.cli.plan", "Compute the optimal plan, its certificate, the time-energy front."),
    "fit": ("metropilot.cli.fit", "Estimate a trainset's parameters from logs of runs."),
    "learn": ("metropilot.cli.learn", "Learn a driver, or resume a run."),
    "runs": ("metropilot.cli.runs", "List the learning runs, the newest first."),
    "export": ("metropilot.cli.export", "Write a learned driver as ONNX or, with protection, a driver as C."),
    "lines": ("metropilot.cli.catalogue", "List the lines of the catalogue."),
    "trainsets": ("metropilot.cli.catalogue", "List the trainsets of the catalogue."),
    "drivers": (
        "metropilot.cli.catalogue",
        "List the drivers, or those of followers in a convoy.",
    ),
    "tasks": ("metropilot.cli.runs", "List the tasks that can be learned."),
    "show": ("metropilot.cli.show", "Show a line, a trainset, a driver, a policy or a run."),
    "reproduce": (
        "metropilot.cli.reproduce",
        "Reproduce a paper: published, reproduced and optimal values in one table, with its figures.",
    ),
    "studies": ("metropilot.cli.reproduce", "List the studies."),
    "serve": ("metropilot.cli.serve", "Open the web console and the HTTP API."),
    "import": ("metropilot.cli.import_file", "Read a line, trainset or journey file and write it as TOML."),
}
"""Module and help line of each command; modules are imported on use."""


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0 every requirement met, 1 not, 2 invalid input.

    Args:
        argv: Arguments without the program's name; the process's own by default.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        with _lost_interrupts_again():
            code = _run(arguments)
            sys.stdout.flush()
    except (KeyboardInterrupt, typer.Abort) as error:
        code = _fail(str(error) or "interrupted", INTERRUPTED)
    except InputError as error:
        code = _fail(error.line(), BAD_INPUT, error, as_json="--json" in arguments)
    except typer.TyperException as error:
        code = _fail(_usage(error, arguments), BAD_INPUT, as_json="--json" in arguments)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except MetropilotError as error:
        code = _fail(str(error), 1, as_json="--json" in arguments)
    except Exception as error:
        if os.environ.get("METROPILOT_DEBUG") == "1":
            raise
        told = f"internal error: {type(error).__name__}: {error} (METROPILOT_DEBUG=1 shows where)"
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            told = f"the output cannot be written ({error.strerror})"
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = _fail(told, 1, as_json="--json" in arguments)
    sys.exit(code)


@contextmanager
def _lost_interrupts_again() -> Iterator[None]:
    """Raise a Ctrl-C again that fell into a callback (of the garbage collector), where Python drops it."""
    before = sys.unraisablehook

    def hook(lost: UnraisableHookArgs) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            Timer(AGAIN_S, _thread.interrupt_main).start()
        else:
            before(lost)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


def _run(arguments: list[str]) -> int:
    """Build and run the requested command only."""
    _check_values(arguments)
    words = arguments or words_to_complete()
    wanted = next((word for word in words if not word.startswith("-")), None)
    app = typer.Typer(
        name="metropilot",
        no_args_is_help=False,
        rich_markup_mode="rich",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback(help=SUMMARY)(_root)
    for name, (module, summary) in COMMANDS.items():
        if name == wanted:
            found = import_module(module)
            epilog = "\n\n".join(["Examples:", *found.EXAMPLES[name]])
            app.command(name, epilog=epilog)(getattr(found, f"{name}_command"))
        else:
            app.command(name, help=summary)(_stub)
    try:
        code = app(arguments or ["--help"], prog_name="metropilot", standalone_mode=False)
    except InputError as error:
        raise _as_option(error, app, wanted) from error
    except typer.BadParameter as error:
        if (problem := _bad_value(error)) is None:
            raise
        raise problem from error
    if not arguments:
        return BAD_INPUT
    if code == INTERRUPTED:
        raise KeyboardInterrupt  # which typer makes an exit code
    return code if isinstance(code, int) else 0


def _check_values(arguments: list[str]) -> None:
    """Refuse an empty argument or value of an option: an empty path would be the current folder.

    Raises:
        InputError: There is one.
    """
    for before, word in pairwise(["", *arguments]):
        if not word or EMPTY.fullmatch(word):
            name = word.removesuffix("=") or (before if before.startswith("--") else "argument")
            raise InputError("empty", field=name, value="", allowed="a value")


def _as_option(error: InputError, app: typer.Typer, command: str | None) -> InputError:
    """The error with its field renamed to the option on the command line, if there is one.

    A field has its unit in the name (``delay_s``), an option does not (``--delay``).
    """
    if error.file is not None or not error.field or command not in COMMANDS:
        return error
    group = typer.main.get_command(app)
    options = {
        param.name: option.removeprefix("--")
        for param in getattr(group, "commands", {})[command].params
        for option in param.opts
        if option.startswith("--")
    }
    field, _, rest = error.field.partition(" ")
    field = field.replace("-", "_")
    bare = UNIT.sub("", field)
    for name in (field, bare):
        if name in options or name in options.values():
            written = options.get(name, name)
            return error.at(field=f"--{written} {rest}".strip())
    return error


def _bad_value(error: typer.BadParameter) -> InputError | None:
    """The error of a value that is no number, or outside a range; None if it is another one."""
    found = getattr(error.__cause__, "errors", list)()
    options = getattr(error.param, "opts", ())
    if not found or not options:
        return None
    kind, ends = str(found[0]["type"]), [getattr(error.param, name, None) for name in ("min", "max")]
    about = {"field": options[-1], "value": found[0]["input"]}
    if found[0].get("ctx", {}).keys() & {"ge", "le"}:
        low, high = (given if end is None else end for end, given in zip(ends, NO_ENDS, strict=True))
        return InputError("out of range", **about, allowed=Range(low, high).describe(None))
    if kind.startswith("int"):
        return InputError("not a whole number", **about, allowed="a whole number")
    if kind.startswith("float"):
        return InputError("not a number", **about, allowed="a number without its unit, e.g. 1.5")
    return None


def _stub() -> None:
    """Placeholder of a command in the help, never called."""


def _say_version(wanted: bool) -> bool:
    if wanted:
        typer.echo(f"metropilot {metropilot.__version__}")
        raise typer.Exit
    return wanted


def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_say_version, is_eager=True)
    ] = False,
) -> None:
    """Options of the program itself."""


def _usage(error: typer.TyperException, arguments: list[str]) -> str:
    """Format a usage error on one line with a reference to the help."""
    named = next((word for word in arguments if word in COMMANDS), None)
    command = f"metropilot {named}" if named else "metropilot"
    message = " ".join(error.format_message().split()).rstrip(".")
    return f"{message} (see {command} --help)"


def _fail(line: str, code: int, error: InputError | None = None, *, as_json: bool = False) -> int:
    """Print an error on one line of the error stream; with ``--json`` also on the output."""
    if as_json:
        import json

        shape = {name: getattr(error, name, None) for name in ("file", "field", "value", "unit", "allowed")}
        if shape["field"]:
            shape["field"] = shape["field"].removeprefix("--")
        message = error.message if error else line
        with suppress(OSError):  # a full disk, which the line tells
            sys.stdout.write(json.dumps({"error": {"message": message, **shape}}, default=str) + "\n")
    sys.stderr.write(f"metropilot: {' '.join(line.split())}\n")
    return code
