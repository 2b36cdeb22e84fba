"""Logs of runs: CSV files with time, speed and command or effort, units in the header."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot._io import read_text
from metropilot.errors import InputError
from metropilot.units import KINDS, KMH_PER_MPS, Unit, si_unit, unit

LEAST_ROWS = 20
"""Fewest rows of a log from which anything can be estimated."""

QUANTITIES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "time": ("time", ("time", "t", "elapsed", "time stamp", "timestamp")),
    "speed": ("speed", ("speed", "velocity", "v")),
    "command": ("share", ("command", "u", "notch share", "lever")),
    "effort": ("force", ("effort", "wheel force", "force", "tractive effort")),
    "position": ("length", ("position", "distance", "x", "s")),
    "gradient": ("gradient", ("gradient", "slope", "grade")),
    "power": ("power", ("power", "wheel power")),
    "traction": ("force", ("traction",)),
    "electric brake": ("force", ("electric brake",)),
    "friction brake": ("force", ("friction brake",)),
}
"""Quantity to the kind of its unit and the names of its column."""
SUFFIXES = {
    "s": "s",
    "min": "min",
    "mps": "m/s",
    "kmh": "km/h",
    "kph": "km/h",
    "m": "m",
    "km": "km",
    "permil": "permil",
    "percent": "%",
    "n": "N",
    "kn": "kN",
    "w": "W",
    "kw": "kW",
    "mw": "MW",
}
"""Endings of a column's name to the unit they stand for, as in ``speed_kmh``."""
HEADER = re.compile(r"^(?P<name>[^\[\(]*?)\s*(?:[\[\(](?P<unit>[^\]\)]*)[\]\)])?\s*$")


@dataclass(frozen=True, eq=False)
class Log:
    """Log of one or several runs in SI, one row a sample; samples without a speed are left out.

    Attributes:
        name: Name of the file.
        time_s: Time, increasing.
        speed_mps: Measured speed.
        command: Command in force from the row on, in [-1, 1]; None: not logged.
        effort_n: Wheel force from the row on, traction positive; None: not logged.
        position_m: Position of the head; None: not logged.
        gradient_permil: Gradient, the mean over the trainset's length; None: not logged.
    """

    name: str
    time_s: Float[ndarray, " rows"]
    speed_mps: Float[ndarray, " rows"]
    command: Float[ndarray, " rows"] | None = None
    effort_n: Float[ndarray, " rows"] | None = None
    position_m: Float[ndarray, " rows"] | None = None
    gradient_permil: Float[ndarray, " rows"] | None = None


def read_log(path: str | Path) -> Log:
    """Read a log from a CSV file: comma, semicolon or tab between the cells.

    A column is a quantity with its unit: ``speed [km/h]``, ``speed (m/s)`` or ``speed_kmh``. Read are time,
    speed, command, effort (or traction with electric and friction brake), position, gradient and power at the
    wheel, which gives an effort where none is logged; other columns are ignored. `trajectory.csv` is such a
    file. A row with an empty time or speed is a gap;
    cells missing at its end are empty.

    Raises:
        InputError: A column, a unit or a number is missing or cannot be used, or time does not increase.
    """
    path = Path(path)
    header, rows = _cells(path)
    columns = _columns(path, header)
    for name in ("time", "speed"):
        if name not in columns:
            raise InputError(
                "column missing", file=path, field=name, allowed=f"a column such as {_example(name)}"
            )
    values = {name: _numbers(path, header, rows, index, of) for name, (index, of) in columns.items()}
    kept = np.isfinite(values["time"]) & np.isfinite(values["speed"])
    values = {name: value[kept] for name, value in values.items()}
    lines = np.flatnonzero(kept) + 2
    _check_rows(path, values, lines)
    effort = values.get("effort")
    if effort is None and "traction" in values:
        brakes = (values.get(f"{kind} brake", np.zeros(1)) for kind in ("electric", "friction"))
        effort = values["traction"] - sum(brakes)
    if effort is None and "power" in values:
        moving = values["speed"] > 1.0
        effort = np.where(moving, values["power"] / np.maximum(values["speed"], 1.0), np.nan)
    return Log(
        path.name,
        values["time"],
        values["speed"],
        values.get("command"),
        effort,
        values.get("position"),
        values.get("gradient"),
    )


def describe_log(log: Log) -> str:
    """Size, speeds and inputs of a log, in words."""
    inputs = {"command": log.command, "effort": log.effort_n, "position": log.position_m}
    inputs |= {"gradient": log.gradient_permil}
    named = [name for name, column in inputs.items() if column is not None]
    minutes = (log.time_s[-1] - log.time_s[0]) / 60.0
    return (
        f"{log.time_s.size} samples, {minutes:.1f} min, up to {KMH_PER_MPS * log.speed_mps.max():.1f} km/h; "
        + (", ".join(named) or "neither command nor effort")
    )


def _cells(path: Path) -> tuple[list[str], list[list[str]]]:
    text = read_text(path)
    first = text.partition("\n")[0]
    delimiter = max(",;\t", key=first.count)
    try:
        found = [
            row for row in csv.reader(text.splitlines(), delimiter=delimiter) if any(map(str.strip, row))
        ]
    except csv.Error as error:
        raise InputError("not a CSV file", file=path, value=str(error)) from None
    if len(found) < LEAST_ROWS + 1:
        raise InputError(
            "too short", file=path, value=max(len(found) - 1, 0), unit="rows", allowed=f">= {LEAST_ROWS} rows"
        )
    if delimiter == ";":
        found = [found[0], *([cell.replace(",", ".") for cell in row] for row in found[1:])]
    columns = len(found[0])
    for number, row in enumerate(found[1:], 2):
        if any(map(str.strip, row[columns:])):
            allowed = f"at most {columns}, as in the header; with decimal commas, semicolons between cells"
            raise InputError(
                "too many cells", file=path, field=f"line {number}", value=len(row), allowed=allowed
            )
    return [cell.strip().lstrip("\ufeff") for cell in found[0]], found[1:]


def _columns(path: Path, header: Sequence[str]) -> dict[str, tuple[int, Unit]]:
    """Columns by quantity: place and unit."""
    found: dict[str, tuple[int, Unit]] = {}
    for index, cell in enumerate(header):
        split = _split(path, cell)
        if split is None:
            continue
        name, of = split
        if name in found:
            raise InputError("two columns of one quantity", file=path, field=name, value=cell)
        found[name] = (index, of)
    return found


def _split(path: Path, cell: str) -> tuple[str, Unit] | None:
    """Quantity and unit of a column; None where it is none of those read."""
    match = HEADER.match(cell)
    if match is None:
        return None
    name, given = match["name"].strip(), match["unit"]
    words = name.lower().replace("_", " ")
    if given is None:
        head, _, tail = words.rpartition(" ")
        if tail in SUFFIXES and (quantity := _quantity(head)):
            words, given = head, SUFFIXES[tail]
            if given not in KINDS[QUANTITIES[quantity][0]]:
                return None  # another quantity of that name, as the force of the gradient
    quantity = _quantity(words)
    if quantity is None:
        return None
    kind = QUANTITIES[quantity][0]
    if given is None and kind == "share":
        return quantity, si_unit(kind)
    return quantity, unit(given, kind, file=path, field=f"column {name!r}")


def _quantity(words: str) -> str | None:
    return next((key for key, (_, names) in QUANTITIES.items() if words in names), None)


def _example(name: str) -> str:
    units = list(KINDS[QUANTITIES[name][0]])
    return " or ".join(f"'{name} [{one}]'" for one in units[:2])


def _numbers(
    path: Path, header: Sequence[str], rows: Sequence[Sequence[str]], index: int, of: Unit
) -> Float[ndarray, " rows"]:
    """Numbers of a column in SI; an empty cell is NaN."""
    cells = [row[index].strip() if index < len(row) else "" for row in rows]
    values = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        try:
            values[k] = float(cell or "nan")
        except ValueError:
            values[k] = np.inf
        # A gap is an empty cell: the word NaN may also stand for a failed computation.
        if cell and not np.isfinite(values[k]):
            where = f"line {k + 2}, column {header[index]!r}"
            allowed = "a finite number, or an empty cell for a gap"
            raise InputError("not a number", file=path, field=where, value=cell, allowed=allowed)
    return of.to_si(values)


def _check_rows(path: Path, values: Mapping[str, ndarray], lines: ndarray) -> None:
    """Check number, order and range of the rows.

    Raises:
        InputError: One of them is not as it must be.
    """
    time, speed = values["time"], values["speed"]
    if time.size < LEAST_ROWS:
        raise InputError(
            "too short", file=path, value=time.size, unit="rows", allowed=f">= {LEAST_ROWS} rows with a speed"
        )
    late = np.flatnonzero(np.diff(time) <= 0)
    if late.size:
        k = int(late[0]) + 1
        raise InputError(
            "time does not increase",
            file=path,
            field=f"line {lines[k]}",
            value=f"{time[k]:g} s after {time[k - 1]:g} s",
            allowed="each time later than the one before",
        )
    wrong = np.flatnonzero((speed < -0.5) | (speed > 150.0))
    if wrong.size:
        k = int(wrong[0])
        raise InputError(
            "speed out of range",
            file=path,
            field=f"line {lines[k]}",
            value=float(speed[k]),
            unit="m/s",
            allowed="0 to 150 m/s; is the unit right?",
        )
    command = values.get("command")
    if command is not None and np.nanmax(np.abs(command), initial=0.0) > 1.05:
        k = int(np.nanargmax(np.abs(command)))
        raise InputError(
            "command out of range",
            file=path,
            field=f"line {lines[k]}",
            value=float(command[k]),
            allowed="-1 to 1, or -100 to 100 with the unit %",
        )
