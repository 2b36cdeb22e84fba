"""Constant tables of a source file: each stored once, in the shortest of some forms that give the same bits.

A table of a section is long and says little: a limit holds for hundreds of metres, a time falls by the same
amount from node to node but for the rounding of a sum. Forms, besides the numbers one by one:

* ``line``: whole steps from entry to entry, computed;
* ``coded``: the distinct numbers, and for each entry which it is;
* ``runs``: each number once where it begins, and one bit an entry that says where;
* ``halves``: the upper half of numbers in single precision whose lower half is zero, as rounded weights;
* ``steps``: fixed point, see :class:`StepTable`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from math import frexp
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

TYPES: Mapping[str, str] = MappingProxyType(
    {"float64": "double", "float32": "float", "int32": "int32_t", "int64": "int64_t", "bool": "bool"}
)
WIDTH = 110
LEAST_BYTES, LEAST_SHARE = 512, 0.85
"""A table from this size on is stored in another form where that takes at most such a share of it."""
WORD = 32
"""Entries to a word of bits."""
BLOCK_BITS = MappingProxyType({False: 4, True: 6})
"""Rows to a block of steps, as a power of two: of one column, read entry by entry, and of several."""
MOST_COLUMNS = 16
LARGEST = 2.0**60
SYMBOLS = 16
"""Symbols of steps: four bits. The last says that the step is written out."""
LARGEST_CHANGE = 127


class StepTable(NamedTuple):
    """Rows in fixed point: each entry by the change of its step from the row before.

    A step is predicted to be the one before it in the column, or the one beside it in the row; a symbol of
    four bits says which and by how much it is missed. A step that none of the symbols fits is written out.
    Every few rows a block begins with its first row and the step to it.

    Attributes:
        unit: What the whole numbers are multiples of, a power of two.
        columns: Columns.
        bits: Rows to a block, as a power of two.
        base: First rows of the blocks. Shape (blocks * columns,), int64.
        step: Steps to them. The same shape.
        first: Number of steps written out before each block. Shape (blocks,), uint16.
        literal: Steps written out. int64.
        codes: Symbols, two to a byte, the first in its lower half. uint8.
        beside: Of each symbol 1 if its prediction is the step beside. Shape (16,), int8.
        change: And what it misses. Shape (16,), int8.
    """

    unit: float
    columns: int
    bits: int
    base: np.ndarray
    step: np.ndarray
    first: np.ndarray
    literal: np.ndarray
    codes: np.ndarray
    beside: np.ndarray
    change: np.ndarray

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by their names."""
        return {name: value for name, value in self._asdict().items() if isinstance(value, np.ndarray)}


def encode_steps(values: np.ndarray, columns: int) -> StepTable | None:
    """A table in steps; None: its numbers have no common unit of 60 bits.

    Args:
        values: Numbers, row by row.
        columns: Numbers to a row.
    """
    unit = _unit(values)
    if unit is None or columns > MOST_COLUMNS:
        return None
    whole = (values.astype(np.float64) / unit).astype(np.int64).reshape(-1, columns)
    bits = BLOCK_BITS[columns > 1]
    rows = 1 << bits
    steps = np.diff(whole, axis=0, prepend=whole[:1])
    changes = np.stack(
        [np.diff(steps, axis=0, prepend=steps[:1]), np.diff(steps, axis=1, prepend=steps[:, :1])]
    )
    # the first column has none beside it
    changes[1, :, 0] = LARGEST_CHANGE + 1
    inner = np.arange(len(whole)) % rows != 0
    symbol = np.full(whole.shape, SYMBOLS - 1)
    symbol[~inner] = 0
    beside, change = np.zeros(SYMBOLS, np.int8), np.zeros(SYMBOLS, np.int8)
    for number in range(SYMBOLS - 1):
        open_ = inner[:, None] & (symbol == SYMBOLS - 1)
        fits = open_ & (abs(changes) <= LARGEST_CHANGE)
        found = [
            (np.bincount(kind[fit] + LARGEST_CHANGE, minlength=1))
            for kind, fit in zip(changes, fits, strict=True)
        ]
        kind = int(found[1].max() > found[0].max())
        if not found[kind].max():
            break
        beside[number], change[number] = kind, found[kind].argmax() - LARGEST_CHANGE
        symbol[open_ & (changes[kind] == change[number])] = number
    spelt = (symbol == SYMBOLS - 1) & inner[:, None]
    before = np.concatenate([[0], np.cumsum(spelt.sum(axis=1))])[:-1]
    if before[-1] >= 1 << 16:
        return None
    pairs = np.append(symbol.ravel(), [0] * (symbol.size % 2)).reshape(-1, 2)
    return StepTable(
        unit=unit,
        columns=columns,
        bits=bits,
        base=whole[::rows].ravel(),
        step=steps[::rows].ravel(),
        first=before[::rows].astype(np.uint16),
        literal=np.append(steps[spelt], 0),
        codes=(pairs[:, 0] + 16 * pairs[:, 1]).astype(np.uint8),
        beside=beside,
        change=change,
    )


def _unit(values: np.ndarray) -> float | None:
    """Largest power of two that all numbers are whole multiples of; None: there is none that is useful."""
    if not np.isfinite(values).all() or (np.signbit(values) & (values == 0)).any():
        return None
    least = 1.0
    for each in set(np.abs(values[values != 0]).astype(np.float64).tolist()):
        whole, exponent = frexp(each)
        whole = int(whole * 2.0**53)
        least = min(least, 2.0 ** (exponent - 53 + (whole & -whole).bit_length() - 1))
    return least if np.abs(values).max() < LARGEST * least and least > 1e-30 else None


class Form(NamedTuple):
    """Form in which a table is stored.

    Attributes:
        bytes: Its size.
        arrays: Arrays to write, by what follows the table's name in theirs.
        entry: Expression of an entry, of the name and the entry's number; ``{}`` are their places.
        row: The table of steps, of which a whole row is read at once; None in every other form.
        heads: Lines after the arrays.
    """

    bytes: int
    arrays: Mapping[str, np.ndarray]
    entry: str
    row: StepTable | None = None
    heads: tuple[str, ...] = ()


class Tables:
    """Constant tables of a source file, each stored once.

    Attributes:
        lines: Their definitions, and those of functions that read them.
        bytes: Their size in the object file.
        functions: Name of each function, entries that its caller lends, and graph, by the identity of this.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.bytes = 0
        self.known: dict[Any, tuple[str, Form]] = {}
        self.written: dict[Any, str] = {}
        self.functions: dict[int, tuple[str, dict[str, int], Any]] = {}

    def at(self, array: np.ndarray, flat: str) -> str:
        """Expression of one entry, a number of the table's own type."""
        _, form = self.form(array)
        return form.entry.replace("@", flat)

    def row(self, array: np.ndarray) -> tuple[str, StepTable] | None:
        """Name of a table of which rows are read at once, and the table; None: of this they are not."""
        name, form = self.form(array)
        return None if form.row is None or form.row.columns == 1 else (name, form.row)

    def form(self, array: np.ndarray) -> tuple[str, Form]:
        """Name of a table, and its form."""
        key = (array.dtype.str, array.tobytes())
        if key not in self.known:
            name = f"t{len(self.known)}"
            columns = array.shape[-1] if array.ndim > 1 and array.shape[-1] <= MOST_COLUMNS else 1
            form = _choose(array.reshape(-1), columns)
            self.known[key] = name, form
            names = {
                f"{name}{end}": self._write(f"{name}{end}", values) for end, values in form.arrays.items()
            }
            for line in form.heads:
                self.lines.append(_rename(line.replace("#", name), names))
            entry = _rename(form.entry.replace("#", name), names)
            self.known[key] = name, form._replace(entry=entry)
        return self.known[key]

    def _write(self, name: str, values: np.ndarray) -> str:
        """Write an array; returns its name, or that of an equal one."""
        key = (values.dtype.str, values.tobytes())
        if key in self.written:
            return self.written[key]
        self.written[key] = name
        self.bytes += values.nbytes
        kind = TYPES.get(values.dtype.name, f"{values.dtype.name}_t")
        texts = [literal(value, values.dtype) for value in values]
        self.lines.append(f"static const {kind} {name}[{values.size}] = {{")
        self.lines += fill(f"{text}," for text in texts)
        self.lines.append("};")
        return name


def _choose(flat: np.ndarray, columns: int) -> Form:
    """The shortest form of a table."""
    plain = _as_plain(flat)
    if plain.bytes < LEAST_BYTES:
        return plain
    others = [
        form
        for form in (
            _as_line(flat),
            _as_values(flat),
            _as_runs(flat),
            _as_halves(flat),
            _as_steps(flat, columns),
        )
        if form
    ]
    best = min(others, key=lambda form: form.bytes, default=plain)
    return best if best.bytes <= LEAST_SHARE * plain.bytes else plain


def _number(values: np.ndarray, kind: np.dtype, entry: str) -> tuple[np.ndarray, str]:
    """Numbers in single precision where they fit, as those of a network, and an entry in their own type."""
    if kind == np.float64 and np.array_equal(values.astype(np.float32), values):
        # what is computed with it, is computed in its own type
        return values.astype(np.float32), f"(double){entry}"
    return values, entry


def _as_plain(flat: np.ndarray) -> Form:
    values, entry = _number(flat, flat.dtype, "#[@]")
    return Form(values.nbytes, {"": values}, entry)


def _as_line(flat: np.ndarray) -> Form | None:
    if flat.dtype.kind == "b" or not np.isfinite(flat).all():
        return None
    first, step = flat[0], flat[1] - flat[0]
    numbers = np.arange(flat.size, dtype=flat.dtype)
    if (first + step * numbers).tobytes() != flat.tobytes():
        return None
    kind = flat.dtype
    if (first, step) == (0, 1) and not np.signbit(first):
        return Form(0, {}, f"({TYPES[kind.name]})(@)")
    return Form(0, {}, f"({literal(first, kind)} + {literal(step, kind)} * ({TYPES[kind.name]})(@))")


def _bits(flat: np.ndarray) -> np.ndarray:
    """Entries by their bits: of the two zeros, and of the bits of NaN, none may stand for the other."""
    return flat.view(f"u{flat.dtype.itemsize}") if flat.dtype.kind == "f" else flat


def _as_values(flat: np.ndarray) -> Form | None:
    values, numbers = np.unique(_bits(flat), return_inverse=True)
    if values.size > 1 << 16:
        return None
    index = numbers.astype(np.uint8 if values.size <= 1 << 8 else np.uint16)
    stored, entry = _number(values.view(flat.dtype), flat.dtype, "#[#_of[@]]")
    return Form(stored.nbytes + index.nbytes, {"": stored, "_of": index}, entry)


def _as_runs(flat: np.ndarray) -> Form | None:
    bits = _bits(flat)
    begins = np.concatenate([[True], bits[1:] != bits[:-1]])
    count = int(begins.sum())
    if count >= 1 << 15:
        return None
    padded = np.pad(begins, (0, -flat.size % WORD)).reshape(-1, WORD)
    words = (padded.astype(np.uint64) << np.arange(WORD, dtype=np.uint64)).sum(axis=1).astype(np.uint32)
    # one less, so that the run of an entry is what began up to it, itself included
    before = (np.concatenate([[0], np.cumsum(padded.sum(axis=1))])[:-1] - 1).astype(np.int16)
    stored, entry = _number(flat[begins], flat.dtype, "#[run_of(#_begins, #_runs, @)]")
    arrays = {"": stored, "_begins": words, "_runs": before}
    return Form(sum(each.nbytes for each in arrays.values()), arrays, entry)


def _as_halves(flat: np.ndarray) -> Form | None:
    single = _number(flat, flat.dtype, "")[0]
    if single.dtype != np.float32 or not np.isfinite(single).all():
        return None
    bits = single.view(np.uint32)
    if (bits & 0xFFFF).any():
        return None
    entry = "single_of(#[@])" if flat.dtype == np.float32 else "(double)single_of(#[@])"
    return Form(single.nbytes // 2, {"": (bits >> 16).astype(np.uint16)}, entry)


def _as_steps(flat: np.ndarray, columns: int) -> Form | None:
    table = encode_steps(flat, columns) if flat.dtype.kind == "f" else None
    if table is None:
        return None
    arrays = {f"_{name}": value for name, value in table.arrays.items()}
    members = ", ".join(f"#{name}" for name in arrays)
    head = f"static const step_table # = {{{table.columns}, {table.bits}, {members}}};"
    kind = TYPES[flat.dtype.name]
    entry = f"(({kind})step_entry(&#, @) * {literal(flat.dtype.type(table.unit), flat.dtype)})"
    size = sum(each.nbytes for each in arrays.values()) + 8 * len(arrays) + 8
    return Form(size, arrays, entry, table, (head,))


def literal(value: Any, dtype: np.dtype) -> str:  # noqa: ANN401 (a number)
    """A number of a type as C writes it; reads back as the same number."""
    if dtype.kind == "b":
        return "true" if value else "false"
    if dtype.kind in "iu":
        return str(int(value)) if int(value) >= 0 else f"({int(value)})"
    kind = TYPES[dtype.name]
    if np.isnan(value):
        return f"({kind})NAN"
    if np.isinf(value):
        return f"({'-' if value < 0 else ''}({kind})INFINITY)"
    text = repr(float(value)) if dtype == np.float64 else f"{np.format_float_scientific(value, unique=True)}f"
    return f"({text})" if text.startswith("-") else text


def fill(words: Iterable[str], indent: str = "    ") -> list[str]:
    """Lines of words, none longer than ``WIDTH``."""
    lines, line = [], indent.rstrip(" ") + indent[:-1]
    for word in words:
        if len(line) + len(word) + 1 > WIDTH:
            lines.append(line)
            line = indent[:-1]
        line += " " + word
    return [*lines, line]


def _rename(text: str, names: Mapping[str, str]) -> str:
    """A text with arrays named as those that are equal to them."""
    return re.sub(r"\bt\d+\w*", lambda match: names.get(match[0], match[0]), text)
