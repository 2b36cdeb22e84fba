"""Lines, stations and the sections between them."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, replace
from itertools import pairwise

import numpy as np

from metropilot._schema import check_fields, declare
from metropilot.errors import InputError
from metropilot.railway.profile import Steps
from metropilot.railway.record import CatalogueRecord, check_positions
from metropilot.units import KINDS, KMH_PER_MPS, tidy

RESTRICTION_KMH = (5.0, 400.0)
"""Speeds a temporary restriction may have, km/h."""
FARTHEST_M = 200_000.0
"""Largest position that a restriction may have in a section."""
RELEASE_KMH = (3.0, 40.0)
"""Release speeds that a line may have, km/h."""
MOST_BEYOND_M = 300.0
"""Largest distance of the end of the movement authority beyond a stop, m."""


@dataclass(frozen=True)
class Station:
    """A stop of the line.

    Attributes:
        code: Short unique code, e.g. ``RJ``.
        name: English name.
        position_m: Stopping point of the trainset's head, m along the line.
        pinyin: Romanised name where it differs from ``name``.
        local_name: Name in the local script.
    """

    code: str
    name: str
    position_m: float
    pinyin: str = ""
    local_name: str = ""


@dataclass(frozen=True)
class Curve:
    """A stretch whose curvature changes linearly from its start to its end (a clothoid; equal ends: an arc).

    Attributes:
        from_m: Start, m; it ends where the next curve begins.
        curvature_start_per_m: Signed curvature 1/radius at the start, 1/m (0 is straight).
        curvature_end_per_m: The same at the end.
    """

    from_m: float
    curvature_start_per_m: float
    curvature_end_per_m: float


@dataclass(frozen=True)
class Tunnel:
    """A tunnel: where it begins, how long it is (m) and its cross section (m^2)."""

    from_m: float
    length_m: float
    cross_section_m2: float


@dataclass(frozen=True)
class Restriction:
    """A temporary speed restriction between two positions local to the section.

    Attributes:
        from_m: Start, m from the section's origin.
        to_m: End, m from the section's origin.
        limit_mps: The restricted speed, 5 to 400 km/h.
    """

    from_m: float = declare(
        MISSING,
        "Start, from the section's origin.",
        unit="m",
        low=0.0,
        high=FARTHEST_M,
        label="From",
        step=50.0,
    )
    to_m: float = declare(
        MISSING,
        "End, from the section's origin.",
        unit="m",
        low=0.0,
        high=FARTHEST_M,
        above=True,
        label="To",
        step=50.0,
    )
    limit_mps: float = declare(
        MISSING,
        "Restricted speed.",
        unit="m/s",
        low=RESTRICTION_KMH[0] / KMH_PER_MPS,
        high=RESTRICTION_KMH[1] / KMH_PER_MPS,
        shown=KINDS["speed"]["km/h"],
        label="Speed",
        step=5.0 / KMH_PER_MPS,
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.from_m >= self.to_m:
            words, allowed = "a restriction must end after it begins", f"> {self.from_m:g} m"
            raise InputError(words, field="to_m", value=self.to_m, unit="m", allowed=allowed)

    def passing_time_s(self, length_m: float) -> float:
        """Time that a trainset of this length takes through it at the restricted speed."""
        return (self.to_m - self.from_m + length_m) / self.limit_mps


@dataclass(frozen=True)
class MovementAuthority:
    """End of the movement authority beyond every stop of a line, and its release speed.

    Protection lets a trainset approach the end at up to the release speed, so that a stop at the platform is
    not disturbed by a braking curve to a point a few metres beyond it; a trainset that passes the end is
    braked by the emergency brake. The head therefore stops no further beyond the end than that brake needs
    from the release speed.

    Attributes:
        distance_m: Distance of the end beyond the stopping point, 0 to 300 m.
        release_mps: Release speed, 3 to 40 km/h.
    """

    distance_m: float = 2.0
    release_mps: float = 15.0 / KMH_PER_MPS

    def __post_init__(self) -> None:
        low, high = RELEASE_KMH
        for name, value, unit, least, most in (
            ("distance", self.distance_m, "m", 0.0, MOST_BEYOND_M),
            ("release_speed", KMH_PER_MPS * self.release_mps, "km/h", low, high),
        ):
            if not least - 1e-6 <= value <= most + 1e-6:
                raise InputError(
                    "out of range",
                    field=f"movement_authority.{name}",
                    value=tidy(value),
                    unit=unit,
                    allowed=f"{least:g} to {most:g} {unit}",
                )


@dataclass(frozen=True)
class Section:
    """The track from one stop to another, in positions local to its origin and in the direction of travel.

    Profiles reach far enough before the origin for the trainset's tail and past the destination for an
    overshoot: their outer pieces hold without end.

    Attributes:
        line_id: The line it was cut from.
        origin: Station the run starts from.
        destination: Station the run stops at.
        length_m: Distance between the two stopping points.
        limit_mps: Speed limits, value in m/s.
        gradient_permil: Gradients in the direction of travel, positive uphill.
        curves: Curves, local positions, by increasing position.
        tunnels: Tunnels, local positions.
        planned_time_s: The timetable's running time, where the line knows it.
        restrictions: Temporary speed restrictions in force.
        authority: End of the movement authority beyond the stop; None: the authority does not end.
    """

    line_id: str
    origin: Station
    destination: Station
    length_m: float
    limit_mps: Steps
    gradient_permil: Steps
    curves: tuple[Curve, ...] = ()
    tunnels: tuple[Tunnel, ...] = ()
    planned_time_s: float | None = None
    restrictions: tuple[Restriction, ...] = ()
    authority: MovementAuthority | None = MovementAuthority()

    def check_restriction(self, restriction: Restriction) -> Restriction:
        """A temporary speed restriction as it was entered, if it makes sense on this section.

        Call it on the section without restrictions: its limits are then the line's own.

        Raises:
            InputError: It does not lie within the section, or is nowhere below the line's own limit.
        """
        where = {
            "field": "restriction",
            "value": f"{restriction.from_m:g} to {restriction.to_m:g}",
            "unit": "m",
        }
        within = f"0 to {self.length_m:g} m"
        if restriction.from_m >= self.length_m:
            raise InputError("a restriction begins beyond the stop", allowed=within, **where)
        if restriction.to_m > self.length_m:
            raise InputError("a restriction ends beyond the stop", allowed=within, **where)
        edges = self.limit_mps.from_m
        inside = edges[(edges > restriction.from_m) & (edges < restriction.to_m)]
        highest_mps = float(self.limit_mps.at(np.append(inside, restriction.from_m)).max())
        if restriction.limit_mps >= highest_mps - 1e-9:
            raise InputError(
                "a restriction has no effect: the line's own limit is no higher there",
                field="restriction",
                value=tidy(KMH_PER_MPS * restriction.limit_mps),
                unit="km/h",
                allowed=f"{RESTRICTION_KMH[0]:g} to below {tidy(KMH_PER_MPS * highest_mps)} km/h",
            )
        return restriction

    def with_restriction(self, restriction: Restriction) -> Section:
        """The section with one more temporary speed restriction in force."""
        limit = self.limit_mps.lower(restriction.from_m, restriction.to_m, restriction.limit_mps)
        return replace(self, limit_mps=limit, restrictions=(*self.restrictions, restriction))

    @property
    def name(self) -> str:
        """``ORIGIN-DESTINATION`` by code."""
        return f"{self.origin.code}-{self.destination.code}"


@dataclass(frozen=True)
class Line(CatalogueRecord):
    """A line: stations and the track between them, positions growing in the forward direction.

    Attributes:
        id: Catalogue id or file stem.
        name: Full name.
        stations: By increasing position, at least two.
        limit_mps: Speed limits, value in m/s; they hold in both directions.
        gradient_permil: Gradients in the forward direction, positive uphill.
        curves: Curves by increasing position (empty: straight).
        tunnels: Tunnels.
        altitude_m: Altitude at position 0.
        planned_forward_s: Planned running time of each section, forward order, or empty.
        planned_backward_s: The same for the opposite direction, listed in *forward* section order
            (entry k is the section between stations k and k+1), or empty.
        authority: End of the movement authority beyond every stop.
        dwell_s: Planned dwell at each intermediate station, forward order, or empty.
    """

    id: str
    name: str
    stations: tuple[Station, ...]
    limit_mps: Steps
    gradient_permil: Steps
    curves: tuple[Curve, ...] = ()
    tunnels: tuple[Tunnel, ...] = ()
    altitude_m: float = 0.0
    planned_forward_s: tuple[float, ...] = ()
    planned_backward_s: tuple[float, ...] = ()
    dwell_s: tuple[float, ...] = ()
    authority: MovementAuthority = MovementAuthority()

    def __post_init__(self) -> None:
        """Refuse a line whose parts do not fit together.

        Raises:
            InputError: Naming the field, its value and what is allowed.
        """
        self._check_track()
        stops = self.stations
        if len(stops) < 2:
            raise InputError("needs stations", field="stations", value=len(stops), allowed="at least 2")
        check_positions("stations", [each.position_m for each in stops])
        seen: set[str] = set()
        for index, stop in enumerate(stops):
            if _key(stop.code) in seen:
                raise InputError(
                    "code used twice",
                    field=f"stations[{index}].code",
                    value=stop.code,
                    allowed="a code of its own",
                )
            seen.add(_key(stop.code))
        wanted = {
            "planned_forward_s": len(stops) - 1,
            "planned_backward_s": len(stops) - 1,
            "dwell_s": len(stops) - 2,
        }
        for name, length in wanted.items():
            table = getattr(self, name)
            if table and len(table) != length:
                each = "section" if length == len(stops) - 1 else "station on the way"
                allowed = f"{length}, one for each {each}"
                raise InputError(
                    "wrong length",
                    field=f"timetable.{TIMETABLE_KEYS[name]}",
                    value=len(table),
                    allowed=allowed,
                )
        slowest = float(self.limit_mps.value.min())
        if not slowest > 0:
            raise InputError(
                "speed limit out of range", field="limit_mps", value=slowest, unit="m/s", allowed="> 0 m/s"
            )

    def _check_track(self) -> None:
        """Refuse tunnels in one another, of which the train would meet one only, and curves without end."""
        for index, (before, after) in enumerate(pairwise(self.tunnels), start=1):
            if after.from_m < (end_m := before.from_m + before.length_m) - 1e-6:
                raise InputError(
                    "begins in the tunnel before it",
                    field=f"tunnels[{index}].from",
                    value=tidy(after.from_m),
                    unit="m",
                    allowed=f">= {end_m:g} m",
                )
        for index, (curve, after) in enumerate(pairwise(self.curves)):
            changes = curve.curvature_start_per_m != curve.curvature_end_per_m
            if changes and after.from_m - curve.from_m > LONGEST_M:
                raise InputError(
                    "the curvature changes over too long a way",
                    field=f"curves[{index}].from",
                    value=f"{curve.from_m:g} to {after.from_m:g}",
                    unit="m",
                    allowed=f"at most {LONGEST_M:g} m",
                )

    def station(self, key: str) -> Station:
        """The station a user means by a code, a name, or a unique beginning of one (case, spaces ignored).

        Raises:
            InputError: No station matches, or more than one does (the matches are listed).
        """
        wanted = _key(key)
        keys = {
            s.code: {_key(t) for t in (s.code, s.name, s.pinyin, s.local_name)} - {""} for s in self.stations
        }
        exact = [s for s in self.stations if wanted in keys[s.code]]
        if len(exact) == 1:
            return exact[0]
        begins = [s for s in self.stations if wanted and any(k.startswith(wanted) for k in keys[s.code])]
        if len(begins) == 1:
            return begins[0]
        listed = ", ".join(f"{s.code} ({s.name})" for s in (exact or begins or self.stations))
        problem = "ambiguous station, it matches several" if (exact or begins) else "unknown station"
        raise InputError(problem, file=self.id, field="station", value=key, allowed=listed)

    def section(self, origin: str | Station, destination: str | Station) -> Section:
        """Cut the run between two stations (not necessarily neighbours) in either direction.

        Raises:
            InputError: A station is unknown or ambiguous, or both are the same.
        """
        start = origin if isinstance(origin, Station) else self.station(origin)
        end = destination if isinstance(destination, Station) else self.station(destination)
        if start.position_m == end.position_m:
            raise InputError(
                "origin and destination are the same station",
                file=self.id,
                field="destination",
                value=end.code,
            )
        zero_m, backward = start.position_m, end.position_m < start.position_m
        if abs(end.position_m - zero_m) > LONGEST_M:
            raise InputError(
                "the section is too long",
                file=self.id,
                field="destination",
                value=f"{start.code}-{end.code}, {abs(end.position_m - zero_m):g}",
                unit="m",
                allowed=f"at most {LONGEST_M:g} m",
            )
        if backward:
            limit = self.limit_mps.mirror(zero_m)
            gradient = self.gradient_permil.mirror(zero_m, -1.0)
            curves = _mirrored_curves(self.curves, zero_m)
            tunnels = tuple(replace(t, from_m=zero_m - t.from_m - t.length_m) for t in self.tunnels[::-1])
        else:
            limit, gradient = self.limit_mps.shift(zero_m), self.gradient_permil.shift(zero_m)
            curves = tuple(replace(c, from_m=c.from_m - zero_m) for c in self.curves)
            tunnels = tuple(replace(t, from_m=t.from_m - zero_m) for t in self.tunnels)
        codes = [s.code for s in self.stations]
        first, last = codes.index(start.code), codes.index(end.code)
        # A timetable has the times between neighbours; without one for the way back, both ways take the same.
        table = self.planned_backward_s if backward and self.planned_backward_s else self.planned_forward_s
        planned_s = float(table[min(first, last)]) if table and abs(last - first) == 1 else None
        return Section(
            line_id=self.id,
            origin=start,
            destination=end,
            length_m=abs(end.position_m - start.position_m),
            limit_mps=limit,
            gradient_permil=gradient,
            curves=curves,
            tunnels=tunnels,
            planned_time_s=planned_s,
            authority=self.authority,
        )

    def sections(self, *, backward: bool = False) -> tuple[Section, ...]:
        """Every section between neighbouring stations, in the order a trainset meets them."""
        stops = self.stations[::-1] if backward else self.stations
        return tuple(self.section(a, b) for a, b in pairwise(stops))

    def select_sections(self, names: str | None = None) -> tuple[Section, ...]:
        """Sections by name, or all of them: forward, then backward.

        Args:
            names: ``ORIGIN-DESTINATION,...``, codes or names of stations; None: all.

        Raises:
            InputError: A name is not that of two stations, or stands twice.
        """
        if names is None:
            return (*self.sections(), *self.sections(backward=True))
        found: list[Section] = []
        for word in names.split(","):
            ends = word.split("-")
            if len(ends) != 2:
                allowed = "ORIGIN-DESTINATION,..."
                raise InputError("not a section", field="sections", value=word, allowed=allowed)
            section = self.section(*ends)
            if section in found:
                allowed = "each section once"
                raise InputError("section named twice", field="sections", value=word, allowed=allowed)
            found.append(section)
        return tuple(found)


def _key(text: str) -> str:
    return "".join(ch for ch in text.casefold() if ch.isalnum())


TIMETABLE_KEYS = {"planned_forward_s": "forward", "planned_backward_s": "backward", "dwell_s": "dwell"}
"""What the fields are called in a file."""
LONGEST_M = 1.2e5
"""Longest run between two stops: grids of a metre are made of it, and no metro has a longer one."""
BEYOND_M = 1e6
"""Reach of a mirrored line's last curve: further than any line."""


def _mirrored_curves(curves: tuple[Curve, ...], origin_m: float) -> tuple[Curve, ...]:
    """Curves seen from the other direction.

    What lies beyond the last curve is straight on as that curve was at its end; before the first, straight.
    """
    if not curves:
        return ()
    starts = [c.from_m for c in curves]
    end = -curves[-1].curvature_end_per_m
    last = Curve(origin_m - starts[-1] - BEYOND_M, end, end)
    turned = [
        Curve(origin_m - starts[k + 1], -curves[k].curvature_end_per_m, -curves[k].curvature_start_per_m)
        for k in range(len(curves) - 2, -1, -1)
    ]
    before = Curve(origin_m - starts[0], 0.0, 0.0)
    return (last, *turned, before)
