"""Arguments and options that several commands share; those of a run are generated from its declaration."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, cast, get_type_hints

import typer

from metropilot._schema import FieldSpec, field_default, field_specs, field_type
from metropilot.cli import complete
from metropilot.errors import Infeasible, InputError

if TYPE_CHECKING:
    from metropilot.railway import Section, Trainset

Command = TypeVar("Command", bound=Callable[..., int])
UNIT = re.compile(r"_(s|m|mps|mps2|mps3|mb)$")
"""Unit suffixes of field names, absent from option names."""
INTERRUPTED = 130
"""Exit code."""
ENDLESS = 10**9
"""A highest whole number that the help leaves out: that of a seed."""
ABOUT, WORLD, OUTPUT = "What to drive", "Disturbances", "Output"
ABOUT_FIELDS = ("time_s", "trainset", "load", "driver", "options", "objective", "dt_s")

LINE = typer.Argument(
    help="Line: catalogue id or path to a .toml or .json file.", autocompletion=complete.lines
)
ORIGIN = typer.Argument(help="Station of departure: code or name.", autocompletion=complete.stations)
DESTINATION = typer.Argument(help="Station of arrival: code or name.", autocompletion=complete.stations)
LineArgument = Annotated[str, LINE]
OriginArgument = Annotated[str, ORIGIN]
DestinationArgument = Annotated[str, DESTINATION]
Out = Annotated[Path | None, typer.Option(help="Folder for the results.", rich_help_panel=OUTPUT)]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.", rich_help_panel=OUTPUT)]


COMPLETIONS = {
    "trainset": complete.trainsets,
    "driver": complete.drivers,
    "head_driver": complete.drivers,
    "follower": complete.followers,
}
POSITIONAL = ("line", "origin", "destination")
BESIDE_FILE = ("again", "out", "as_json")
"""Options that may stand beside ``--from``."""


def check_source(context: Any, again: Path | None, file: str, *ends: str | None) -> None:  # noqa: ANN401
    """Check that a command was given a line and two stations, or a file whose run it repeats.

    Args:
        context: The command's typer.Context.
        again: The file.
        file: Name that such a file has.
        ends: Line, origin and destination.

    Raises:
        InputError: Neither is given in full, or both are, or an option of the run beside the file.
    """
    if again is not None:
        if ends[0] is not None:
            raise InputError(f"a line and a {file} cannot be driven at once", field="from", value=str(again))
        beside = [
            param.opts[0]
            for param in context.command.params
            if is_typed(context, param.name) and param.name not in BESIDE_FILE
        ]
        if beside:
            words = f"the run is that of the file, without {', '.join(beside)}"
            raise InputError(words, field="from", value=str(again), allowed="--out and --json beside it")
        return
    for name, end in zip(POSITIONAL, ends, strict=True):
        if end is None:
            allowed = f"LINE ORIGIN DESTINATION, or --from {file.upper()}"
            raise InputError("missing", field=name, allowed=allowed)


def is_typed(context: Any, name: str) -> bool:  # noqa: ANN401 (typer.Context, as far as typer knows)
    """Tell if an argument or option of a command was given on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def check_both(origin: str | None, destination: str | None) -> None:
    """Check that a command was given two stations or none."""
    if (origin is None) != (destination is None):
        missing = "destination" if origin else "origin"
        raise InputError("missing", field=missing, allowed="both stations or none")


@contextmanager
def name_stall(sections: Iterable[Section], trainset: Trainset) -> Iterator[None]:
    """Let an error about a trainset that stalls, which knows the metre, name the section too.

    Args:
        sections: Sections between neighbouring stops.
        trainset: Trainset.
    """
    try:
        yield
    except Infeasible as error:
        if error.field != "section" or error.value is not None:
            raise
        from metropilot.planning import minimum_running_time

        never = (each for each in sections if not math.isfinite(minimum_running_time(each, trainset)))
        if (found := next(never, None)) is None:
            raise
        raise Infeasible(error.message, file=error.file, field="section", value=found.name) from error


def with_run_options(
    *left_out: str,
    only: Sequence[str] | None = None,
    more: Sequence[Parameter] = (),
    **defaults: Any,  # noqa: ANN401 (of any type)
) -> Callable[[Command], Command]:
    """Give a command an option for every field of a run, in place of its ``**given``.

    Name, type, default and help come from :func:`metropilot.evaluate.run_fields`; the values arrive by the
    fields' names, as :meth:`metropilot.evaluate.RunSpec.from_values` takes them.

    Args:
        left_out: Fields without an option.
        only: Fields with an option; None: all.
        more: Further options in ``**given``, before those of the run.
        defaults: Defaults of the command that differ from the declaration.
    """

    def decorate(command: Command) -> Command:
        from metropilot.evaluate import run_fields

        keys = [
            key for key in (run_fields() if only is None else only) if key not in (*POSITIONAL, *left_out)
        ]
        hints = get_type_hints(command, include_extras=True)
        # typer passes the context of the click that it brings along, which is no typer.Context
        hints = {name: hint for name, hint in hints.items() if hint is not Any}
        own = [
            parameter.replace(annotation=hints.get(parameter.name, typer.Context))
            for parameter in signature(command).parameters.values()
            if parameter.kind is not Parameter.VAR_KEYWORD
        ]
        first = sum(each.name in POSITIONAL or each.default is Parameter.empty for each in own)
        run = [run_option(key, **defaults) for key in keys]
        parameters = [*own[:first], *more, *run, *own[first:]]

        @wraps(command)
        def parse_and_call(**given: Any) -> int:  # noqa: ANN401 (what was typed)
            from metropilot.evaluate import parse_option

            if "options" in keys:
                given["options"] = dict(map(parse_option, given["options"] or ()))
            return command(**given)

        parse_and_call.__signature__ = Signature(parameters, return_annotation=int)  # pyright: ignore[reportAttributeAccessIssue]
        parse_and_call.__annotations__ = {p.name: p.annotation for p in parameters} | {"return": int}
        return cast("Command", parse_and_call)

    return decorate


def run_option(key: str, **defaults: Any) -> Parameter:  # noqa: ANN401 (of any type)
    """Typer parameter of a command's option for a field of a run."""
    from metropilot.evaluate import RunSpec, key_type, run_fields
    from metropilot.sim import Disturbance

    default = defaults.get(key, getattr(RunSpec, key, getattr(Disturbance, key, None)))
    panel = ABOUT if key in ABOUT_FIELDS else WORLD
    return option_of(key, run_fields()[key], key_type(key), default, panel)


def options_of(kind: type[Any], panel: str, prefix: str = "") -> tuple[Parameter, ...]:
    """Typer parameters of the options for all declared fields of a dataclass.

    Args:
        kind: The dataclass.
        panel: Panel of the help.
        prefix: Beginning of the values' names.
    """
    return tuple(
        option_of(prefix + name, spec, field_type(kind, name), field_default(kind, name), panel)
        for name, spec in field_specs(kind).items()
    )


def option_of(name: str, spec: FieldSpec, kind: type, default: Any, panel: str) -> Parameter:  # noqa: ANN401
    """Typer parameter of the option for a declared field.

    Args:
        name: Name of the value.
        spec: Declaration of the field.
        kind: Type of its values.
        default: Default of the command.
        panel: Panel of the help.
    """
    flag = f"--{spec.option or UNIT.sub('', name).replace('_', '-')}"
    if kind is bool:
        option = typer.Option(flag, help=spec.help, rich_help_panel=panel)
        return Parameter(
            name, Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=Annotated[bool, option]
        )
    hint: Any = list[str] if kind in {list, dict} else kind
    if default is None or kind in {list, dict}:
        hint, default = hint | None, None
    option = typer.Option(
        flag,
        help=f"{spec.help.rstrip('.')}, {spec.describe_allowed()}."
        if spec.range and (kind is float or spec.range.high < ENDLESS)
        else spec.help,
        metavar=spec.form or None,
        rich_help_panel=panel,
        autocompletion=COMPLETIONS.get(name),
    )
    return Parameter(
        name, Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=Annotated[hint, option]
    )
