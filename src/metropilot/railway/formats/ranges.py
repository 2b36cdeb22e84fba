"""Ranges that the numbers of input files must lie in, and how they are worded."""

from __future__ import annotations

import math
from dataclasses import dataclass

from metropilot._schema import Range


def tidy(value: int | float) -> int | float:
    """A number as people would write it: no ``.0``, six digits."""
    if isinstance(value, int) or not math.isfinite(value):
        return value
    return int(value) if value == int(value) and abs(value) < 1e15 else float(f"{value:.6g}")


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
