"""Tables of an input file that know where they stand, and the ranges their numbers must lie in."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy import ndarray

from metropilot._schema import Range
from metropilot._typing import Float
from metropilot.errors import InputError
from metropilot.units import Unit, tidy, unit

ANY = Range()
POSITIVE = Range(0.0, above=True)
NOT_NEGATIVE = Range(0.0)
POSITIVE_OR_NONE = Range(0.0, above=True, infinite=True)
SHARE = Range(0.0, 1.0)
EFFICIENCY = Range(0.0, 1.0, above=True)
ACTUATION_TIME = Range(0.0, 30.0)
"""Reaction and build-up times of a brake: longer ones are a wrong unit, not a railway."""
SERVICE_RATE = Range(0.01, 10.0, infinite=True)
"""Bounds of service; a wider one than these is none, ``inf``."""
EMERGENCY_RATE = Range(0.1, 30.0)
EMERGENCY_JERK = Range(0.05, infinite=True)
IDENTIFIER = re.compile(r"\w[\w.@,+-]*")
CODE = re.compile(r"(?!.*\*/)[^\"\\\x00-\x1f\x7f-\x9f\u2028\u2029]+")


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        name: Its key in the units table.
        kind: The kind of its unit.
        bounds: The range of its cells, in SI.
        optional: True if a cell may be empty (null).
    """

    name: str
    kind: str
    bounds: Range = ANY
    optional: bool = False


_SHOWN = 60


def format_value(value: object) -> str | int | float:
    """A value short enough for one line: plain numbers as they are, everything else as text."""
    text = value if isinstance(value, str) else repr(value)
    if len(text) > _SHOWN:
        return text[: _SHOWN - 3] + "..."
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return tidy(value)
    return text


def nearest(word: str, words: Sequence[str]) -> str:
    """``, did you mean X?`` where some word is close, else nothing."""
    close = difflib.get_close_matches(word, words, n=1, cutoff=0.5)
    return f", did you mean {close[0]!r}?" if close else ""


class Node:
    """A table of an input file: reads typed values, remembers which keys were read.

    Args:
        data: The table.
        file: The file it stands in.
        path: Dotted path of the table inside the file.
    """

    def __init__(self, data: Mapping[str, Any], file: object, path: str = "") -> None:
        self.data = data
        self.file = file
        self.path = path
        self._read: set[str] = set()

    def at(self, key: str) -> str:
        """Dotted path of a key."""
        return f"{self.path}.{key}" if self.path else key

    def fail(
        self,
        problem: str,
        key: str,
        value: object = None,
        allowed: str | None = None,
        unit: str | None = None,
    ) -> InputError:
        """The error to raise about a key."""
        given = None if value is None else format_value(value)
        return InputError(
            problem, file=self.file, field=self.at(key), value=given, unit=unit, allowed=allowed
        )

    def was_read(self, key: str) -> bool:
        """True if the key has been read."""
        return key in self._read

    def __contains__(self, key: str) -> bool:
        """True if the file gives the key."""
        return key in self.data

    def get(self, key: str) -> object:
        """The raw value of a key, or ``None``."""
        self._read.add(key)
        return self.data.get(key)

    def require(self, key: str, allowed: str) -> object:
        """The raw value of a key that must be there."""
        value = self.get(key)
        if value is None:
            raise self.fail("missing", key, allowed=allowed)
        return value

    def table(self, key: str) -> Node:
        """A table that must be there."""
        value = self.require(key, "a table")
        if not isinstance(value, Mapping):
            raise self.fail("must be a table", key, value, "a table")
        return Node(value, self.file, self.at(key))

    def optional(self, key: str) -> Node | None:
        """A table that may be missing."""
        return self.table(key) if self.get(key) is not None else None

    def items(self, key: str, *, default: Sequence[object] | None = None) -> list[object]:
        """A list, of anything."""
        value = self.get(key)
        if value is None and default is not None:
            return list(default)
        value = self.require(key, "a list")
        if not isinstance(value, list):
            raise self.fail("must be a list", key, value, "a list in brackets, [ ]")
        return value

    def text(self, key: str, default: str | None = None, *, allowed: str = "text that is not empty") -> str:
        """A text; empty only where that is the default."""
        value = self.get(key)
        if value is None and default is not None:
            return default
        value = self.require(key, allowed)
        if not isinstance(value, str):
            raise self.fail("must be text", key, value, allowed)
        if not value.strip() and value != default:
            raise self.fail("must not be empty", key, allowed=allowed)
        return _encodable(value, self, key)

    def identifier(self, key: str, default: str | None = None) -> str:
        """An id, which becomes part of paths, commands and sources."""
        value = self.text(key, default)
        if not IDENTIFIER.fullmatch(value):
            raise self.fail("not an id", key, value, "letters, digits and . _ - @ , +")
        return value

    def code(self, key: str) -> str:
        """Code of a station, which becomes part of sources."""
        value = self.text(key)
        if not CODE.fullmatch(value):
            allowed = "text without quotation marks, backslashes, */ and control characters"
            raise self.fail("not an id", key, value, allowed)
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts, empty where the key is missing."""
        values = self.items(key, default=())
        for index, value in enumerate(values):
            if not isinstance(value, str):
                raise self.fail("must be text", f"{key}[{index}]", value, "text")
            _encodable(value, self, f"{key}[{index}]")
        return tuple(str(v) for v in values)

    def choice(self, key: str, choices: Sequence[str], default: str) -> str:
        """One of a few words."""
        value = self.text(key, default)
        if value not in choices:
            raise self.fail("unknown value", key, value, ", ".join(choices))
        return value

    def unit(self, name: str, kind: str) -> Unit:
        """The unit of a quantity of this table: its entry in ``units``, else ``unit``."""
        units = self.optional("units")
        if units is not None:
            self._read.add(f"units.{name}")
            return unit(units.get(name), kind, file=self.file, field=units.at(name))
        return unit(self.get("unit"), kind, file=self.file, field=self.at("unit"))

    def may_have_units(self, *names: str) -> None:
        """Allow ``units`` to name quantities that the table then does not give."""
        self._read |= {f"units.{name}" for name in names}

    def quantity(self, key: str, kind: str, bounds: Range = ANY, default: float | None = None) -> float:
        """A number with a unit, in SI.

        Args:
            key: The number's key.
            kind: The quantity its unit measures.
            bounds: The range, in SI.
            default: Value where the key is missing; ``None``: it must be there.
        """
        value = self.get(key)
        self.may_have_units(key)
        if value is None and default is not None:
            return default
        of = self.unit(key, kind)
        self.require(key, bounds.describe(of))
        return self.number(value, key, of, bounds)

    def number(self, value: object, where: str, of: Unit | None, bounds: Range) -> float:
        """A raw value as a number in SI, checked; ``where`` is its path below this table."""
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self._number_error("must be a number", where, value, of, bounds)
        try:
            result = float(value) if of is None else of.to_si(float(value))
        except OverflowError:
            result = math.inf
        if math.isnan(result):
            raise self._number_error("must be a number", where, value, of, bounds)
        if math.isinf(result) and not (bounds.infinite and isinstance(value, float) and math.isinf(value)):
            raise self._number_error("must be finite", where, value, of, bounds)
        if not bounds.admit(result):
            raise self._number_error("out of range", where, value, of, bounds)
        return result

    def _number_error(
        self, problem: str, where: str, value: object, of: Unit | None, bounds: Range
    ) -> InputError:
        return InputError(
            problem,
            file=self.file,
            field=self.at(where),
            value=format_value(value),
            unit=of.name if of else None,
            allowed=bounds.describe(of),
        )

    def quantities(self, key: str, kind: str, bounds: Range = ANY) -> tuple[float, ...]:
        """A list of numbers with one unit, in SI; empty where the key is missing."""
        self.may_have_units(key)
        if self.get(key) is None:
            return ()
        of = self.unit(key, kind)
        return tuple(self.number(v, f"{key}[{i}]", of, bounds) for i, v in enumerate(self.items(key)))

    def rows(self, key: str, columns: Sequence[Column]) -> Float[ndarray, "rows columns"]:
        """A list of rows of numbers, one unit per column, in SI; an empty cell is NaN."""
        units = [self.unit(c.name, c.kind) for c in columns]
        names = ", ".join(c.name for c in columns)
        table = []
        for index, row in enumerate(self.items(key)):
            if not isinstance(row, list) or len(row) != len(columns):
                raise self.fail("wrong row", f"{key}[{index}]", row, f"a list of {len(columns)}: {names}")
            cells = [
                math.nan
                if cell is None and column.optional
                else self.number(cell, f"{key}[{index}].{column.name}", of, column.bounds)
                for cell, column, of in zip(row, columns, units, strict=True)
            ]
            table.append(cells)
        return np.array(table, dtype=np.float64).reshape(len(table), len(columns))

    def check_increasing(self, values: Sequence[float], where: str, of: Unit) -> None:
        """Check that positions or speeds increase; ``where`` is a pattern with ``{}`` for the index."""
        for index, (before, after) in enumerate(pairwise(values), start=1):
            if not after > before:
                raise InputError(
                    "must increase",
                    file=self.file,
                    field=self.at(where.format(index)),
                    value=tidy(of.from_si(after)),
                    unit=of.name,
                    allowed=f"> {of.from_si(before):g} {of.name}",
                )

    def close(self) -> None:
        """Refuse every key that has not been read, naming the nearest that has.

        Raises:
            InputError: The table has an unknown key.
        """
        known = sorted(k for k in self._read if "." not in k)
        for key in self.data:
            if key not in self._read and key not in {"units", "unit"}:
                raise self.fail(f"unknown key{nearest(str(key), known)}", str(key), allowed=", ".join(known))
        units = self.data.get("units")
        if isinstance(units, Mapping):
            known = sorted(k[6:] for k in self._read if k.startswith("units."))
            for key in units:
                if key not in known:
                    where = f"units.{key}"
                    raise self.fail(f"unknown key{nearest(str(key), known)}", where, allowed=", ".join(known))


def _encodable(value: str, node: Node, key: str) -> str:
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise node.fail(
            "must be proper Unicode", key, ascii(value), "text without lone surrogates"
        ) from error
    return value
