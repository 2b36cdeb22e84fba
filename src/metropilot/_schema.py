"""Fields that users give: unit, range, help text and option, declared beside the default and checked here.

A dataclass declares them with :func:`declared`. The command line, TOML files, the HTTP API, the forms of the
console and campaigns take names, ranges and help from the declaration; :func:`check_fields` is the one check.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from difflib import get_close_matches
from functools import cache
from numbers import Integral, Real
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from metropilot.errors import InputError
from metropilot.units import Unit

Made = TypeVar("Made")
KIND_WORDS: dict[type, str] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "text",
    dict: "a table",
    list: "a list of texts",
}


@dataclass(frozen=True)
class Range:
    """The range a number must lie in, in SI.

    Attributes:
        low: Lowest value.
        high: Highest value.
        above: True if ``low`` itself is excluded.
        infinite: True if plus infinity ("no bound") is a value too.
    """

    low: int | float = -math.inf
    high: int | float = math.inf
    above: bool = False
    infinite: bool = False

    def admit(self, value: int | float) -> bool:
        """Tell if the value lies in the range."""
        # an integer may be too large for a float
        if abs(value) == math.inf:
            return self.infinite and value > 0
        return bool((value > self.low if self.above else value >= self.low) and value <= self.high)

    def describe(self, of: Unit | None) -> str:
        """Describe the range in words, in the unit the file uses."""
        name = f" {of.name}" if of and of.name not in {"1", "-"} else ""
        low, high = (v if of is None else of.from_si(v) for v in (self.low, self.high))
        if math.isfinite(low) and math.isfinite(high) and not self.above:
            text = " to ".join(str(v) if isinstance(v, int) else f"{v:g}" for v in (low, high)) + name
        else:
            sign = ">" if self.above else ">="
            parts = [f"{sign} {low:g}{name}"] if math.isfinite(low) else []
            parts += [f"<= {high:g}{name}"] if math.isfinite(high) else []
            text = " and ".join(parts) or f"a finite number{' of' + name if name else ''}"
        return text + (", or inf" if self.infinite else "")


@dataclass(frozen=True)
class FieldSpec:
    """Declaration of one field besides its name, type and default.

    Attributes:
        help: One sentence for ``--help`` and the HTTP API.
        unit: SI unit of the number; empty where it has none.
        range: The range of the number; None where it is no number.
        choices: The words it may be; empty where any will do.
        option: Name of the command line's option, without dashes, where it is not the field's without unit.
        form: Form of the option's text, where it is not a number or a word.
        label: Label in a form of the console; empty where a form does not show it.
        step: Step of that form's field, in SI.
        shown: Unit of that field and of errors, where it is not SI.
    """

    help: str = ""
    unit: str = ""
    range: Range | None = None
    choices: tuple[str, ...] = ()
    option: str = ""
    form: str = ""
    label: str = ""
    step: float = 0.0
    shown: Unit | None = None

    @property
    def shown_unit(self) -> Unit | None:
        """Unit of errors and of the console's field; None where the number has none."""
        return self.shown or (Unit(self.unit, "") if self.unit else None)

    def describe_allowed(self) -> str:
        """Describe the allowed values in words."""
        if self.range is None:
            return ", ".join(self.choices)
        return self.range.describe(self.shown_unit)

    def check(self, name: str, value: Any) -> Any:  # noqa: ANN401 (a value passes as it came)
        """The value, where it is allowed.

        Args:
            name: The field.
            value: Of the field's type; None passes.

        Raises:
            InputError: Outside the range, or none of the choices.
        """
        if value is None:
            return value
        if self.choices and value not in self.choices:
            raise InputError(f"unknown {name}", field=name, value=value, allowed=self.describe_allowed())
        if self.range is not None and not self.range.admit(value):
            unit, shown = (
                self.shown_unit,
                value if self.shown is None else round(self.shown.from_si(value), 6),
            )
            unit_name = unit.name if unit else None
            raise InputError(
                "out of range", field=name, value=shown, unit=unit_name, allowed=self.describe_allowed()
            )
        return value


def declare(default: Any, help: str = "", **more: Any) -> Any:  # noqa: A002, ANN401 (as dataclasses.field)
    """A dataclass field with its :class:`FieldSpec`.

    Args:
        default: Of the field.
        help: Of the field; empty where no entry shows it.
        more: The other attributes of :class:`FieldSpec`, the range by those of :class:`Range`.
    """
    bounds = {name: more.pop(name) for name in ("low", "high", "above", "infinite") if name in more}
    if bounds:
        more["range"] = Range(**bounds)
    return field(default=default, metadata={FieldSpec: FieldSpec(help, **more)})


@cache
def field_specs(kind: type[Any]) -> dict[str, FieldSpec]:
    """Declarations of a dataclass's fields, by name; a field that declares nothing is left out."""
    return {f.name: f.metadata[FieldSpec] for f in fields(kind) if FieldSpec in f.metadata}


def check_fields(values: Any) -> None:  # noqa: ANN401 (any dataclass)
    """Check every declared field of a dataclass, or each item of a tuple; for its ``__post_init__``.

    Raises:
        InputError: A field is no number, outside its range, or none of its choices.
    """
    for name, spec in field_specs(type(values)).items():
        value = getattr(values, name)
        for item in value if isinstance(value, tuple) else (value,):
            if spec.range is not None and item is not None:
                check_number(name, item, field_type(type(values), name))
            spec.check(name, item)


def check_number(name: str, value: Any, kind: type = float, within: Range | None = None) -> None:  # noqa: ANN401 (checked here)
    """Refuse what is no number, or no whole one where the kind is ``int``; NumPy's numbers are numbers.

    Args:
        name: The field, for errors.
        value: The value.
        kind: ``float`` or ``int``.
        within: Range of the number; None: any.

    Raises:
        InputError: It is none, or out of range.
    """
    whole = kind is int
    if isinstance(value, bool) or not isinstance(value, Integral if whole else Real):
        allowed = KIND_WORDS[int if whole else float]
        raise InputError("wrong kind of value", field=name, value=str(value), allowed=allowed)
    FieldSpec(range=within).check(name, value)


class CheckedFields:
    """Base of dataclasses whose only check is that of their fields."""

    def __post_init__(self) -> None:
        check_fields(self)


@cache
def field_type(kind: type[Any], name: str) -> type:
    """Type of a field's values, without None: that of the words of a ``Literal``, or a tuple's first item."""
    hint = get_type_hints(kind)[name]
    parts = (hint,) if get_origin(hint) is Literal else get_args(hint) or (hint,)
    hint = next(part for part in parts if part is not type(None))
    hint = get_args(hint)[0] if get_origin(hint) is tuple else hint
    return type(get_args(hint)[0]) if get_origin(hint) is Literal else hint


def field_default(kind: type[Any], name: str) -> Any:  # noqa: ANN401 (of any type)
    """Default of a field, None where it must be given."""
    default = next(f.default for f in fields(kind) if f.name == name)
    return None if default is MISSING else default


def check_name(name: str, names: Iterable[str], what: str, **where: Any) -> None:  # noqa: ANN401 (as InputError)
    """Refuse a name that is none of these; the error gives the nearest one.

    Args:
        name: The name.
        names: All there are.
        what: What it names, for the error.
        where: Attributes of the error.
    """
    if name not in (names := tuple(names)):
        near = get_close_matches(name, names, 1)
        hint = f", did you mean {near[0]}?" if near else ""
        raise InputError(f"unknown {what}{hint}", allowed=", ".join(names) or "none", **where)


def convert(name: str, value: Any, kind: type, range_words: str = "") -> Any:  # noqa: ANN401 (a plain value)
    """A plain value of TOML, JSON or the command line as a field's type; a whole number is a float too.

    Args:
        name: The field, for errors.
        value: The value.
        kind: The type.
        range_words: Allowed numbers, for the error of a whole number that no float can hold.

    Raises:
        InputError: The value is of another kind, or a whole number that no float can hold.
    """
    value = list(value) if isinstance(value, tuple) else value
    fits = type(value) in {float, int} if kind is float else type(value) is kind
    if not fits or (kind is list and not all(isinstance(item, str) for item in value)):
        allowed = KIND_WORDS.get(kind, kind.__name__)
        raise InputError("wrong kind of value", field=name, value=str(value), allowed=allowed)
    try:
        return float(value) if kind is float else value
    except OverflowError:  # a whole number may have more digits than a float has room for
        raise InputError("out of range", field=name, allowed=range_words or None) from None


def from_table(kind: type[Made], values: object, **more: Any) -> Made:  # noqa: ANN401 (of any type)
    """Make a dataclass from plain values of its declared fields.

    Args:
        kind: The dataclass.
        values: By name; a field that is None or not given has its default.
        more: Values of other fields, as they are.
    """
    if not isinstance(values, Mapping):
        raise InputError("wrong kind of value", field=kind.__name__, value=str(values), allowed="a table")
    given = {}
    for name, value in values.items():
        check_name(name, field_specs(kind), "key", field=name)
        if value is not None:
            given[name] = convert(
                name, value, field_type(kind, name), field_specs(kind)[name].describe_allowed()
            )
    return kind(**given, **more)
