"""Journeys: positions with the times allowed there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from metropilot.errors import InputError
from metropilot.railway.line import Line
from metropilot.railway.record import CatalogueRecord
from metropilot.units import tidy


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
        """True if the trainset stands here."""
        return self.fastest_mps == 0.0


@dataclass(frozen=True)
class Journey(CatalogueRecord):
    """Timing points by position and time, on a line.

    Attributes:
        id: Name of the journey.
        line_id: The line it runs on; empty: any on which its positions make sense.
        points: At least a start and an end; positions grow all the way, or fall all the way.
    """

    id: str
    line_id: str
    points: tuple[TimingPoint, ...]

    def __post_init__(self) -> None:
        """Refuse what nothing could drive: windows upside down, positions or times that turn back.

        Raises:
            InputError: Naming the timing point, the value and what is allowed.
        """
        points = self.points
        if len(points) < 2:
            raise InputError(
                "needs timing points", field="timing_points", value=len(points), allowed="at least 2"
            )
        for index, point in enumerate(points):
            where = f"timing_points[{index}]"
            if not math.isfinite(point.position_m):
                raise InputError(
                    "must be finite", field=f"{where}.position", value=point.position_m, unit="m"
                )
            for low, high, name, unit in (
                (point.earliest_s, point.latest_s, "latest", "s"),
                (point.slowest_mps, point.fastest_mps, "fastest", "m/s"),
            ):
                if low is not None and high is not None and not low <= high:
                    raise InputError(
                        "window ends before it begins",
                        field=f"{where}.{name}",
                        value=tidy(high),
                        unit=unit,
                        allowed=f">= {low:g} {unit}",
                    )
        sign = 1.0 if points[-1].position_m >= points[0].position_m else -1.0
        for index, (before, after) in enumerate(pairwise(points), start=1):
            if sign * (after.position_m - before.position_m) < 0:
                raise InputError(
                    "positions turn back",
                    field=f"timing_points[{index}].position",
                    value=tidy(after.position_m),
                    unit="m",
                    allowed=f"{'>=' if sign > 0 else '<='} {before.position_m:g} m",
                )
        _check_times(points)

    def check_line(self, line: Line) -> None:
        """Refuse another line than that of the journey; one that names none is of any.

        Args:
            line: Line to run on.

        Raises:
            InputError: Another line.
        """
        if self.line_id and self.line_id != line.id:
            raise InputError(
                "a journey of another line", file=self.id, field="line", value=self.line_id, allowed=line.id
            )


def _check_times(points: tuple[TimingPoint, ...]) -> None:
    reached = -math.inf
    for index, point in enumerate(points):
        if point.latest_s is not None and point.latest_s < reached:
            raise InputError(
                "earlier than the timing points before it allow",
                field=f"timing_points[{index}].latest",
                value=tidy(point.latest_s),
                unit="s",
                allowed=f">= {reached:g} s",
            )
        reached = max(reached, -math.inf if point.earliest_s is None else point.earliest_s)


def planned_journey(line: Line, *, backward: bool = False, tolerance_s: float = 0.0) -> Journey:
    """The line's own timetable as a journey over all its stations, stopping at each.

    Args:
        line: A line with planned running times and dwells.
        backward: From the last station to the first.
        tolerance_s: Delay allowed to each arrival and departure, s.

    Raises:
        InputError: The line has no planned times.
    """
    runs = (line.planned_backward_s or line.planned_forward_s) if backward else line.planned_forward_s
    dwells = line.dwell_s or (0.0,) * (len(line.stations) - 2)
    if not runs:
        raise InputError("has no planned running times", file=line.id, field="timetable.forward")
    order = slice(None, None, -1) if backward else slice(None)
    stops, runs, dwells = line.stations[order], runs[order], dwells[order]
    clock, points = 0.0, [_stop_point(stops[0].position_m, 0.0, 0.0)]
    for index, (stop, run) in enumerate(zip(stops[1:], runs, strict=True)):
        clock += run
        points.append(_stop_point(stop.position_m, clock, tolerance_s))
        if index < len(dwells):
            clock += dwells[index]
            points.append(_stop_point(stop.position_m, clock, tolerance_s))
    return Journey(
        id=f"{line.id}-{'backward' if backward else 'forward'}",
        line_id=line.id,
        points=tuple(points),
        source={"timing_points": line.source.get("timetable", f"planned times of {line.id}")},
    )


def _stop_point(position_m: float, time_s: float, tolerance_s: float) -> TimingPoint:
    return TimingPoint(position_m, time_s, time_s + tolerance_s, 0.0, 0.0)
