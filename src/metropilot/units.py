"""Units that input files may use, each with its factor to SI.

Conversion happens here and nowhere else: a loader asks for a unit of a kind and multiplies. Gradients are the
one quantity kept outside SI: they are in permil, as is usual in railway engineering.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy import ndarray

from metropilot.errors import InputError

STANDARD_GRAVITY_MPS2 = 9.81
KMH_PER_MPS = 3.6
"""Kilometres per hour in one metre per second. Divide by it: multiplying by the inverse rounds otherwise."""
J_PER_KWH = 3.6e6
"""Joules in one kilowatt-hour."""


def tidy(value: int | float) -> int | float:
    """A number for display: six digits, no trailing ``.0``."""
    if isinstance(value, int) or not math.isfinite(value):
        return value
    return int(value) if value == int(value) and abs(value) < 1e15 else float(f"{value:.6g}")


@dataclass(frozen=True)
class Unit:
    """A unit of a kind of quantity: one of it is ``numerator / denominator`` of the kind's first unit.

    Attributes:
        name: Spelling in files.
        kind: The quantity it measures, a key of ``KINDS``.
        numerator: Factor to SI.
        denominator: Divisor to SI (kept apart so that 80 km/h is exactly ``80 / 3.6``).
    """

    name: str
    kind: str
    numerator: float = 1.0
    denominator: float = 1.0

    @overload
    def to_si(self, value: float) -> float: ...
    @overload
    def to_si(self, value: ndarray) -> ndarray: ...
    def to_si(self, value: float | ndarray) -> float | ndarray:
        """The value in SI."""
        return value * self.numerator / self.denominator

    def from_si(self, value: float) -> float:
        """The value in this unit, rounded to the shortest number that reads back as it stood."""
        exact = value * self.denominator / self.numerator
        if not np.isfinite(exact):
            return exact
        for digits in range(6, 17):
            short = float(f"{exact:.{digits}g}")
            if self.to_si(short) == value:
                return short
        return exact

    def exact(self, values: Sequence[float]) -> bool:
        """Tell if every SI value survives being written in this unit and read back."""
        return all(self.to_si(self.from_si(v)) == v for v in values)


def _table(kind: str, factors: Mapping[str, tuple[float, float]]) -> dict[str, Unit]:
    return {name: Unit(name, kind, top, bottom) for name, (top, bottom) in factors.items()}


_FORCES = {"N": (1.0, 1.0), "kN": (1000.0, 1.0)}
_SPEEDS = {"m/s": (1.0, 1.0), "km/h": (1.0, KMH_PER_MPS)}


def _per_speed(power: int) -> dict[str, tuple[float, float]]:
    suffix = "" if power == 1 else f"^{power}"
    return {
        f"{force}/({speed}){suffix}": (top * bottom**power, 1.0)
        for force, (top, _) in _FORCES.items()
        for speed, (_, bottom) in _SPEEDS.items()
    }


KINDS: dict[str, dict[str, Unit]] = {
    kind: _table(kind, factors)
    for kind, factors in {
        "length": {"m": (1.0, 1.0), "km": (1000.0, 1.0)},
        "area": {"m^2": (1.0, 1.0)},
        "curvature": {"1/m": (1.0, 1.0), "1/km": (1.0, 1000.0)},
        "time": {"s": (1.0, 1.0), "min": (60.0, 1.0), "h": (3600.0, 1.0)},
        "speed": _SPEEDS,
        "acceleration": {"m/s^2": (1.0, 1.0)},
        "jerk": {"m/s^3": (1.0, 1.0)},
        "mass": {"kg": (1.0, 1.0), "t": (1000.0, 1.0)},
        "force": _FORCES,
        "energy": {"J": (1.0, 1.0), "kJ": (1000.0, 1.0), "MJ": (1e6, 1.0), "kWh": (J_PER_KWH, 1.0)},
        "power": {"W": (1.0, 1.0), "kW": (1000.0, 1.0), "MW": (1e6, 1.0)},
        "voltage": {"V": (1.0, 1.0), "kV": (1000.0, 1.0)},
        "current": {"A": (1.0, 1.0), "kA": (1000.0, 1.0)},
        "resistance": {"ohm": (1.0, 1.0), "mohm": (1.0, 1000.0)},
        "resistance per length": {
            "ohm/m": (1.0, 1.0),
            "ohm/km": (1.0, 1000.0),
            "mohm/km": (1.0, 1e6),
        },
        "gradient": {"permil": (1.0, 1.0), "%": (10.0, 1.0)},
        "share": {"1": (1.0, 1.0), "-": (1.0, 1.0), "%": (1.0, 100.0)},
        "specific force": {"N/kg": (1.0, 1.0), "N/t": (1.0, 1000.0), "N/kN": (STANDARD_GRAVITY_MPS2, 1000.0)},
        "force per speed": _per_speed(1),
        "force per speed squared": {**_per_speed(2), "kg/m": (1.0, 1.0)},
        "stiffness": {"N/m": (1.0, 1.0), "kN/m": (1000.0, 1.0), "MN/m": (1e6, 1.0)},
    }.items()
}
"""Kind of quantity to its units; the first of each is the one used inside."""

_SPELLINGS = str.maketrans({"²": "^2", "³": "^3", "‰": "permil", "−": "-"})


def unit(name: object, kind: str, *, file: object = None, field: str | None = None) -> Unit:
    """The unit of a kind that a file names.

    Args:
        name: Spelling in the file; ``None`` where it has none.
        kind: The quantity expected, a key of ``KINDS``.
        file: The file, for the message.
        field: The dotted path of the unit's own entry, for the message.

    Raises:
        InputError: The unit is missing, or is not a unit of this quantity.
    """
    allowed = f"{kind} in " + ", ".join(KINDS[kind])
    if name is None:
        raise InputError("missing unit", file=file, field=field, allowed=allowed)
    if not isinstance(name, str):
        raise InputError("a unit must be text", file=file, field=field, value=repr(name), allowed=allowed)
    found = KINDS[kind].get(name.strip().translate(_SPELLINGS))
    if found is None:
        raise InputError("unknown unit", file=file, field=field, value=name, allowed=allowed)
    return found


def si_unit(kind: str) -> Unit:
    """The unit of a kind that is used inside."""
    return next(iter(KINDS[kind].values()))


def pick(kind: str, values: Sequence[float], wish: str) -> tuple[Callable[[float], float], str]:
    """The unit to write values in: the preferred one if every value is read back unchanged, else SI.

    Args:
        kind: The quantity, a key of ``KINDS``.
        values: The values to write, in SI.
        wish: The preferred unit.

    Returns:
        The conversion from SI, and the unit's name.
    """
    liked = KINDS[kind][wish]
    chosen = liked if liked.exact(values) else si_unit(kind)
    return chosen.from_si, chosen.name


CLOCK = re.compile(r"([0-9]{1,2}):([0-5][0-9])(?::([0-5][0-9]))?")


def parse_clock(
    text: str, *, file: object = None, field: str | None = None, latest_s: float = math.inf
) -> int:
    """Seconds from the midnight that a day begins with; hours go on after 24 in the night that follows.

    Args:
        text: ``HH:MM`` or ``HH:MM:SS``.
        file: The file, for the message.
        field: The field, for the message.
        latest_s: Latest time allowed.

    Raises:
        InputError: It is no time, or too late.
    """
    match = CLOCK.fullmatch(text.strip())
    if match is None:
        raise InputError("not a time", file=file, field=field, value=text, allowed="HH:MM or HH:MM:SS")
    hours, minutes, seconds = (int(part or 0) for part in match.groups())
    time_s = 3600 * hours + 60 * minutes + seconds
    if time_s > latest_s:
        allowed = f"{format_clock(0)} to {format_clock(latest_s)}"
        raise InputError("out of range", file=file, field=field, value=text, allowed=allowed)
    return time_s


def format_clock(time_s: int | float) -> str:
    """A time from midnight as ``HH:MM:SS``, rounded to whole seconds."""
    minutes, seconds = divmod(round(time_s), 60)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{seconds:02d}"
