"""Journeys: where a trainset has to be when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any



@dataclass(frozen=True)
class TimingPoint:
    """A position with the window of times and speeds allowed there (``None``: free).

    Two timing points with speed 0 at the same position are the arrival and the departure of a stop.

    Attributes:
        position_m: Position along the line, m.
        earliest_s: Earliest time, s.
        latest_s: Latest time, s.
        slowest_mps: Lowest speed, m/s.
        fastest_mps: Highest speed, m/s.
    """

    position_m: float
    earliest_s: float | None = None
    latest_s: float | None = None
    slowest_mps: float | None = None
    fastest_mps: float | None = None

    @property
    def is_stop(self) -> bool:
        """Whether the trainset stands here."""
        return self.fastest_mps == 0.0


@dataclass(frozen=True)
class Journey:
    """Timing points by position and time, on a line.

    Attributes:
        id: Name of the journey.
        line_id: The line it runs on.
        points: At least a start and an end.
        source: Where it comes from.
        extra: Keys of the source file kept for writing back.
    """

    id: str
    line_id: str
    points: tuple[TimingPoint, ...]
    source: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)
