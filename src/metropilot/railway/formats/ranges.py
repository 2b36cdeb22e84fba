"""Ranges that the numbers of input files must lie in, and how they are worded."""

from __future__ import annotations

import math
from dataclasses import dataclass

from metropilot.units import Unit


def tidy(value: int | float) -> int | float:
    """A number as people would write it: no ``.0``, six digits."""
    if isinstance(value, int) or not math.isfinite(value):
        return value
    return int(value) if value == int(value) and abs(value) < 1e15 else float(f"{value:.6g}")


@dataclass(frozen=True)
class Range:
    """The range a number must lie in, in SI.

    Attributes:
        low: Lowest value.
        high: Highest value.
        above: Whether ``low`` itself is excluded.
        infinite: Whether plus infinity ("no bound") is a value too.
    """

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    infinite: bool = False

    def admit(self, value: float) -> bool:
        """Whether the value lies in the range."""
        if math.isinf(value):
            return self.infinite and value > 0
        return (value > self.low if self.above else value >= self.low) and value <= self.high

    def words(self, of: Unit | None) -> str:
        """The range in words, in the unit the file uses."""
        name = f" {of.name}" if of and of.name not in {"1", "-"} else ""
        low, high = (v if of is None else of.from_si(v) for v in (self.low, self.high))
        sign = ">" if self.above else ">="
        parts = [f"{sign} {low:g}{name}"] if math.isfinite(low) else []
        parts += [f"<= {high:g}{name}"] if math.isfinite(high) else []
        text = " and ".join(parts) or f"a finite number{' of' + name if name else ''}"
        return text + (", or inf" if self.infinite else "")


ANY = Range()
POSITIVE = Range(0.0, above=True)
NOT_NEGATIVE = Range(0.0)
POSITIVE_OR_NONE = Range(0.0, above=True, infinite=True)
SHARE = Range(0.0, 1.0)
EFFICIENCY = Range(0.0, 1.0, above=True)
ACTUATION_TIME = Range(0.0, 30.0)
"""Dead times, lags and build-up times: longer ones are a wrong unit, not a railway."""
EMERGENCY_RATE = Range(0.1, 30.0)
EMERGENCY_JERK = Range(0.05, infinite=True)


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        name: What the units table calls it.
        kind: The kind of its unit.
        bounds: The range of its cells, in SI.
        optional: Whether a cell may be empty (null).
    """

    name: str
    kind: str
    bounds: Range = ANY
    optional: bool = False
