"""Plain values for JSON; numbers that are not finite become null."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from metropilot.railway import Section, Station, Steps


def numbers(values: Iterable[Any], digits: int = 6) -> list[Any]:
    """Convert to a list of rounded numbers; None where one is not finite."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        return array.tolist()
    return [round(x, digits) if math.isfinite(x) else None for x in array.tolist()]


def pieces(steps: Steps) -> dict[str, list[Any]]:
    """Convert a piecewise-constant profile."""
    return {"from_m": numbers(steps.from_m), "value": numbers(steps.value)}


def window(section: Section, name: str) -> dict[str, list[Any]]:
    """Convert a profile of a section, from its origin to its end."""
    return pieces(getattr(section, name).window(0.0, section.length_m))


def station(stop: Station, position_m: float | None = None) -> dict[str, Any]:
    """Convert a station."""
    at = stop.position_m if position_m is None else position_m
    return {"code": stop.code, "name": stop.name, "position_m": at, "local_name": stop.local_name}
