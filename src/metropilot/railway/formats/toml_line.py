"""Lines in metropilot's own TOML: one block per kind of data, each with its units and its source."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from jaxtyping import Float
from numpy import ndarray

from metropilot.errors import InputError
from metropilot.railway.formats.ranges import ANY, NOT_NEGATIVE, POSITIVE, Column, Range, tidy
from metropilot.railway.formats.reader import Node
from metropilot.railway.formats.toml_common import Document, header, with_sources
from metropilot.railway.line import Curve, Line, Station, Tunnel
from metropilot.railway.profile import Steps
from metropilot.units import pick

SPEED_LIMIT = Range(0.0, 150.0, above=True)
GRADIENT = Range(-150.0, 150.0)
CURVATURE = Range(-0.1, 0.1)
RADIUS = Range(infinite=True)


def read_line(root: Node) -> Line:
    """The line that a TOML document describes.

    Raises:
        InputError: Anything in it is missing, malformed or out of range.
    """
    document = Document(root)
    stations = _stations(document.block("stations"))
    limits = steps(document.block("speed_limits"), "from", Column("speed", "speed", SPEED_LIMIT))
    gradients = document.block("gradients")
    gradient = steps(gradients, "from", Column("gradient", "gradient", GRADIENT))
    where = [s.position_m for s in stations]
    check_inside(root.table("stations"), where, "list[{}].position", limits, gradient)
    curves, tunnels = document.optional("curves"), document.optional("tunnels")
    timetable = document.optional("timetable")
    return document.build(
        Line,
        name=root.text("name"),
        stations=stations,
        limit_mps=limits,
        gradient_permil=gradient,
        altitude_m=gradients.quantity("altitude", "length", ANY, 0.0),
        curves=_curves(curves) if curves else (),
        tunnels=read_tunnels(tunnels, "from", "cross_section") if tunnels else (),
        planned_forward_s=timetable.quantities("forward", "time", POSITIVE) if timetable else (),
        planned_backward_s=timetable.quantities("backward", "time", POSITIVE) if timetable else (),
        dwell_s=timetable.quantities("dwell", "time", NOT_NEGATIVE) if timetable else (),
    )


def _stations(block: Node) -> tuple[Station, ...]:
    stations = []
    of = block.unit("position", "length")
    for index, entry in enumerate(block.items("list")):
        where = f"list[{index}]"
        if not isinstance(entry, dict):
            raise block.fail("must be a table", where, entry, "{ code, name, position }")
        node = Node(entry, block.file, block.at(where))
        stations.append(
            Station(
                code=node.text("code"),
                name=node.text("name"),
                position_m=node.number(node.need("position", f"a number of {of.name}"), "position", of, ANY),
                pinyin=node.text("pinyin", ""),
                local_name=node.text("local_name", ""),
            )
        )
        node.close()
    block.increasing([s.position_m for s in stations], "list[{}].position", of)
    return tuple(stations)


def check_inside(block: Node, positions: Sequence[float], where: str, limit: Steps, gradient: Steps) -> None:
    """Refuse a station before the data of speed limits or gradients begin.

    Raises:
        InputError: Naming the station, its position and where the data begin.
    """
    first = max(float(limit.from_m[0]), float(gradient.from_m[0]))
    for index, position in enumerate(positions):
        if position < first:
            raise InputError(
                "outside the data of speed limits and gradients",
                file=block.file,
                field=block.at(where.format(index)),
                value=tidy(position),
                unit="m",
                allowed=f">= {first:g} m",
            )


def steps(block: Node, position: str, value: Column) -> Steps:
    """A piecewise-constant profile from rows of position and value.

    Raises:
        InputError: No row, a bad cell, or positions that do not increase.
    """
    table = placed_rows(block, position, value)
    return Steps(table[:, 0], table[:, 1])


def placed_rows(block: Node, position: str, *values: Column) -> Float[ndarray, "rows columns"]:
    """Rows of a table that has at least one, the first column an increasing position.

    Raises:
        InputError: No row, a bad cell, or positions that do not increase.
    """
    table = block.rows("values", (Column(position, "length"), *values))
    if not len(table):
        raise block.fail("needs at least one row", "values", allowed="at least one row")
    block.increasing(
        [float(v) for v in table[:, 0]], f"values[{{}}].{position}", block.unit(position, "length")
    )
    return table


def _curves(block: Node) -> tuple[Curve, ...]:
    if "radius" in block.table("units"):
        rows = placed_rows(block, "from", Column("radius", "length", RADIUS))
        arcs = [(float(a), curvature(float(r))) for a, r in rows]
        for index, (_, bend) in enumerate(arcs):
            check_curvature(block, f"values[{index}].radius", bend)
        return tuple(Curve(a, bend, bend) for a, bend in arcs)
    bend = Column("curvature", "curvature", CURVATURE)
    return tuple(Curve(*(float(x) for x in row)) for row in placed_rows(block, "from", bend, bend))


def curvature(radius_m: float) -> float:
    """Curvature of a radius, 1/m; 0 and infinity are both straight."""
    return 0.0 if radius_m == 0.0 or math.isinf(radius_m) else 1.0 / radius_m


def check_curvature(block: Node, where: str, bend: float) -> None:
    """Refuse a radius below 10 m."""
    if not CURVATURE.admit(bend):
        raise block.fail(
            "radius too small", where, 1 / bend, "a radius of 10 m or more; 0 or inf: straight", "m"
        )


def read_tunnels(block: Node, position: str, section: str) -> tuple[Tunnel, ...]:
    """Tunnels from rows of position, length and cross section."""
    length, area = Column("length", "length", POSITIVE), Column(section, "area", POSITIVE)
    return tuple(Tunnel(*(float(x) for x in row)) for row in placed_rows(block, position, length, area))


def line_document(line: Line) -> dict[str, Any]:
    """The TOML document of a line, in the units people read wherever that loses nothing."""
    at, of = pick("length", [s.position_m for s in line.stations], "m")
    stations = [
        {
            "code": s.code,
            "name": s.name,
            "position": at(s.position_m),
            **({"pinyin": s.pinyin} if s.pinyin else {}),
            **({"local_name": s.local_name} if s.local_name else {}),
        }
        for s in line.stations
    ]
    document = header("line", line, name=line.name)
    document["stations"] = {"unit": of, "list": stations}
    document["speed_limits"] = _profile(line.limit_mps, "speed", "speed", "km/h")
    document["gradients"] = _profile(line.gradient_permil, "gradient", "gradient", "permil")
    if line.altitude_m:
        document["gradients"]["units"]["altitude"] = "m"
        document["gradients"]["altitude"] = line.altitude_m
    if line.curves:
        document["curves"] = _curve_block(line.curves)
    if line.tunnels:
        document["tunnels"] = {
            "units": {"from": "m", "length": "m", "cross_section": "m^2"},
            "values": [[t.from_m, t.length_m, t.cross_section_m2] for t in line.tunnels],
        }
    planned = {"forward": line.planned_forward_s, "backward": line.planned_backward_s, "dwell": line.dwell_s}
    if any(planned.values()):
        document["timetable"] = {"unit": "s", **{k: list(v) for k, v in planned.items() if v}}
    return with_sources(document, line.source)


def _profile(profile: Steps, name: str, kind: str, wish: str) -> dict[str, Any]:
    value, of = pick(kind, profile.value.tolist(), wish)
    rows = [[a, value(v)] for a, v in zip(profile.from_m.tolist(), profile.value.tolist(), strict=True)]
    return {"units": {"from": "m", name: of}, "values": rows}


def _curve_block(curves: tuple[Curve, ...]) -> dict[str, Any]:
    arcs = all(c.curvature_start_per_m == c.curvature_end_per_m for c in curves)
    radii = [short_radius(c.curvature_start_per_m) for c in curves]
    if arcs and None not in radii:
        rows = [[c.from_m, r] for c, r in zip(curves, radii, strict=True)]
        return {"units": {"from": "m", "radius": "m"}, "values": rows}
    rows = [[c.from_m, c.curvature_start_per_m, c.curvature_end_per_m] for c in curves]
    return {"units": {"from": "m", "curvature": "1/m"}, "values": rows}


def short_radius(bend: float) -> float | None:
    """The radius in m that reads back as this curvature (0: straight), or ``None`` where none does."""
    if bend == 0.0:
        return 0.0
    exact = 1.0 / bend
    candidates = [float(f"{exact:.{digits}g}") for digits in range(6, 18)]
    candidates += [math.nextafter(exact, math.inf), math.nextafter(exact, -math.inf)]
    return next((radius for radius in candidates if 1.0 / radius == bend), None)
