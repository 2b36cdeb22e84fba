"""Fields that users give: unit, range, help text and option, declared beside the default and checked here.

A dataclass declares them with :func:`declared`. The command line, TOML files, the HTTP API, the forms of the
console and campaigns take names, ranges and help from the declaration; :func:`check_fields` is the one check.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any

from metropilot.errors import InputError
from metropilot.units import Unit


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
        if math.isinf(value):
            return self.infinite and value > 0
        return bool((value > self.low if self.above else value >= self.low) and value <= self.high)

    def words(self, of: Unit | None) -> str:
        """The range in words, in the unit the file uses."""
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
        step: Step of that form's field.
    """

    help: str
    unit: str = ""
    range: Range | None = None
    choices: tuple[str, ...] = ()
    option: str = ""
    form: str = ""
    label: str = ""
    step: float = 0.0

    @property
    def allowed(self) -> str:
        """Allowed values in words."""
        if self.range is None:
            return ", ".join(self.choices)
        return self.range.words(Unit(self.unit, "") if self.unit else None)

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
            raise InputError(f"unknown {name}", field=name, value=value, allowed=self.allowed)
        if self.range is not None and not self.range.admit(value):
            unit = self.unit or None
            raise InputError("out of range", field=name, value=value, unit=unit, allowed=self.allowed)
        return value


def declared(default: Any, help: str, **more: Any) -> Any:  # noqa: A002, ANN401 (as dataclasses.field)
    """A dataclass field with its :class:`FieldSpec`.

    Args:
        default: Of the field.
        help: Of the field.
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
    """Check every declared field of a dataclass; for its ``__post_init__``.

    Raises:
        InputError: A field is outside its range, or none of its choices.
    """
    for name, spec in field_specs(type(values)).items():
        spec.check(name, getattr(values, name))
