"""A working day of a line: periods with their headways, and the trains that there are."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from metropilot._schema import check_fields, declare
from metropilot.errors import InputError
from metropilot.railway.line import Line
from metropilot.railway.record import CatalogueRecord
from metropilot.units import format_clock

LATEST_S = 36.0 * 3600
"""Latest time of a day, counted from its midnight; the night after belongs to it."""

LONGEST_WAIT_S = 900


@dataclass(frozen=True, kw_only=True)
class Period:
    """A part of a day with one headway.

    Attributes:
        name: Name, e.g. ``morning peak``.
        from_s: Time of its first departures, from midnight.
        to_s: Its end: no departure at this time or later.
        headway_s: Time between two trains of a direction.
        dwell_s: Time at every platform on the way; None: that of the operation.
    """

    name: str
    from_s: int = declare(0, unit="s", low=0.0, high=LATEST_S)
    to_s: int = declare(0, unit="s", low=0.0, high=LATEST_S)
    headway_s: int = declare(180, unit="s", low=10.0, high=7200.0)
    dwell_s: int | None = declare(None, unit="s", low=0.0, high=600.0)

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.to_s > self.from_s:
            raise InputError(
                f"period ends before it begins: {self.name}",
                field="to_s",
                value=format_clock(self.to_s),
                allowed=f"after {format_clock(self.from_s)}",
            )


@dataclass(frozen=True, kw_only=True)
class ServiceDay(CatalogueRecord):
    """A working day of one line.

    Attributes:
        id: Catalogue id or file stem.
        name: Name.
        line_id: Line.
        periods: Periods, one after the other; between two of them nothing has to depart.
        fleet: Trains that there are; None: as many as it takes.
        longest_wait_s: A train that would wait longer at a terminal station goes to the depot.
    """

    id: str
    name: str
    line_id: str
    periods: tuple[Period, ...]
    fleet: int | None = declare(None, low=1, high=10_000)
    longest_wait_s: int = declare(LONGEST_WAIT_S, unit="s", low=0.0, high=LATEST_S)

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.periods:
            raise InputError("needs periods", field="periods", value=0, allowed="at least 1")
        for index, (before, after) in enumerate(pairwise(self.periods), start=1):
            if after.from_s < before.to_s:
                raise InputError(
                    "begins before the period before it ends",
                    field=f"periods.list[{index}].from",
                    value=format_clock(after.from_s),
                    allowed=f"{format_clock(before.to_s)} or later",
                )

    def check_line(self, line: Line) -> None:
        """Refuse another line than that of the day.

        Args:
            line: Line to operate.

        Raises:
            InputError: Another line.
        """
        if self.line_id != line.id:
            raise InputError(
                "a day of another line", file=self.id, field="line", value=self.line_id, allowed=line.id
            )
