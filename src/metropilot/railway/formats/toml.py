"""Metropilot's own TOML: the parts that all files share, and lines and journeys read and written."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from numpy import ndarray

from metropilot._io import atomic_write
from metropilot._typing import Float
from metropilot.errors import InputError
from metropilot.railway.formats.reader import ANY, NOT_NEGATIVE, POSITIVE, Column, Node, Range
from metropilot.railway.journey import Journey, TimingPoint
from metropilot.railway.line import (
    MOST_BEYOND_M,
    RELEASE_KMH,
    Curve,
    Line,
    MovementAuthority,
    Station,
    Tunnel,
)
from metropilot.railway.profile import Steps
from metropilot.railway.trainset import Trainset
from metropilot.units import KMH_PER_MPS, pick, tidy

T = TypeVar("T")
SPEED_LIMIT = Range(0.0, 150.0, above=True)
GRADIENT = Range(-150.0, 150.0)
CURVATURE = Range(-0.1, 0.1)
RADIUS = Range(infinite=True)
BEYOND = Range(0.0, MOST_BEYOND_M)
RUNNING_TIME = Range(0.0, 86_400.0, above=True)
DWELL = Range(0.0, 86_400.0)
RELEASE = Range(RELEASE_KMH[0] / KMH_PER_MPS, RELEASE_KMH[1] / KMH_PER_MPS)
POINT_FIELDS = (("earliest", "time"), ("latest", "time"), ("slowest", "speed"), ("fastest", "speed"))
_WIDTH = 110
_BARE = re.compile(r"[A-Za-z0-9_-]+")


class Document:
    """The root of a TOML document: reads header and blocks, and refuses keys that nothing has read.

    Args:
        root: The whole document.
    """

    def __init__(self, root: Node) -> None:
        self.root = root
        self._blocks: list[Node] = []
        self.source: dict[str, str] = {}
        root.get("kind")
        self.header: dict[str, Any] = {
            "id": root.identifier("id"),
            "notes": root.texts("notes"),
            "unused": root.texts("unused"),
            "extra": self._extra(),
        }

    def _extra(self) -> dict[str, Any]:
        text = self.root.text("extra", "{}")
        try:
            extra = json.loads(text)
        except (ValueError, RecursionError):
            extra = None
        if not isinstance(extra, dict):
            raise self.root.fail("must be a JSON object", "extra", text, "a JSON object as text")
        return extra

    def optional(self, name: str) -> Node | None:
        """A block that may be missing; its ``source`` is taken note of."""
        block = self.root.optional(name)
        if block is not None:
            self._blocks.append(block)
            source = block.text("source", "")
            if source:
                self.source[name] = source
        return block

    def block(self, name: str) -> Node:
        """A block that must be there."""
        self.root.require(name, "a table")
        block = self.optional(name)
        if block is None:
            raise self.root.fail("missing", name, allowed="a table")
        return block

    def build(self, make: Callable[..., T], **fields: object) -> T:
        """Close every table and make the object, naming the file in whatever its own checks say.

        Raises:
            InputError: An unknown key, or data that does not fit together.
        """
        sources = self.root.optional("sources")
        for key in sources.data if sources else ():
            self.source[key] = sources.text(key) if sources else ""
        for block in self._blocks:
            block.close()
        self.root.close()
        try:
            return make(**self.header, **fields, source=self.source)
        except InputError as error:
            raise error.at(file=self.root.file) from error


def header(kind: str, thing: Line | Trainset | Journey, **more: str) -> dict[str, Any]:
    """The header of a document, without what is empty."""
    document: dict[str, Any] = {"kind": kind, "id": thing.id, **more}
    for key in ("notes", "unused"):
        if getattr(thing, key):
            document[key] = list(getattr(thing, key))
    if thing.extra:
        document["extra"] = json.dumps(thing.extra)
    return document


def with_sources(document: dict[str, Any], source: Mapping[str, str]) -> dict[str, Any]:
    """The document with each source in its block, and those without a block in ``sources``."""
    rest = {}
    for name, text in source.items():
        if isinstance(document.get(name), dict):
            document[name] = {"source": text, **document[name]}
        else:
            rest[name] = text
    if rest:
        document["sources"] = rest
    return document


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
    timetable, authority = document.optional("timetable"), document.optional("movement_authority")
    return document.build(
        Line,
        name=root.text("name"),
        stations=stations,
        limit_mps=limits,
        gradient_permil=gradient,
        altitude_m=gradients.quantity("altitude", "length", ANY, 0.0),
        curves=_curves(curves) if curves else (),
        tunnels=read_tunnels(tunnels, "from", "cross_section") if tunnels else (),
        planned_forward_s=timetable.quantities("forward", "time", RUNNING_TIME) if timetable else (),
        planned_backward_s=timetable.quantities("backward", "time", RUNNING_TIME) if timetable else (),
        dwell_s=timetable.quantities("dwell", "time", DWELL) if timetable else (),
        authority=_authority(authority) if authority else MovementAuthority(),
    )


def _authority(block: Node) -> MovementAuthority:
    usual = MovementAuthority()
    return MovementAuthority(
        block.quantity("distance", "length", BEYOND, usual.distance_m),
        block.quantity("release_speed", "speed", RELEASE, usual.release_mps),
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
                code=node.code("code"),
                name=node.text("name"),
                position_m=node.number(
                    node.require("position", f"a number of {of.name}"), "position", of, ANY
                ),
                pinyin=node.text("pinyin", ""),
                local_name=node.text("local_name", ""),
            )
        )
        node.close()
    block.check_increasing([s.position_m for s in stations], "list[{}].position", of)
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
    table = position_rows(block, position, value)
    return Steps(table[:, 0], table[:, 1])


def position_rows(block: Node, position: str, *values: Column) -> Float[ndarray, "rows columns"]:
    """Rows of a table that has at least one, the first column an increasing position.

    Raises:
        InputError: No row, a bad cell, or positions that do not increase.
    """
    table = block.rows("values", (Column(position, "length"), *values))
    if not len(table):
        raise block.fail("needs at least one row", "values", allowed="at least one row")
    block.check_increasing(
        [float(v) for v in table[:, 0]], f"values[{{}}].{position}", block.unit(position, "length")
    )
    return table


def _curves(block: Node) -> tuple[Curve, ...]:
    if "radius" in block.table("units"):
        rows = position_rows(block, "from", Column("radius", "length", RADIUS))
        arcs = [(float(a), curvature(float(r))) for a, r in rows]
        for index, (_, bend) in enumerate(arcs):
            check_curvature(block, f"values[{index}].radius", bend)
        return tuple(Curve(a, bend, bend) for a, bend in arcs)
    bend = Column("curvature", "curvature", CURVATURE)
    return tuple(Curve(*(float(x) for x in row)) for row in position_rows(block, "from", bend, bend))


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
    return tuple(Tunnel(*(float(x) for x in row)) for row in position_rows(block, position, length, area))


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
    if line.authority != MovementAuthority():
        value, of = pick("speed", [line.authority.release_mps], "km/h")
        document["movement_authority"] = {
            "units": {"distance": "m", "release_speed": of},
            "distance": line.authority.distance_m,
            "release_speed": value(line.authority.release_mps),
        }
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


def read_journey(root: Node) -> Journey:
    """The journey that a TOML document describes.

    Raises:
        InputError: Anything in it is missing, malformed or out of range.
    """
    document = Document(root)
    block = document.block("timing_points")
    block.may_have_units("position", "time", "speed")
    points = tuple(_point(block, entry, f"list[{i}]") for i, entry in enumerate(block.items("list")))
    return document.build(Journey, line_id=root.text("line", ""), points=points)


def _point(block: Node, entry: object, where: str) -> TimingPoint:
    if not isinstance(entry, dict):
        raise block.fail("must be a table", where, entry, "{ position, earliest, latest, slowest, fastest }")
    node = Node(entry, block.file, block.at(where))
    values: dict[str, float | None] = {}
    for name, kind in (("position", "length"), *POINT_FIELDS):
        raw = node.get(name)
        bounds: Range = ANY if name == "position" else NOT_NEGATIVE
        values[name] = (
            None if raw is None else node.number(raw, name, block.unit(kind_name(kind), kind), bounds)
        )
    position = values["position"]
    if position is None:
        raise node.fail("missing", "position", allowed="a position along the line")
    node.close()
    return TimingPoint(position, values["earliest"], values["latest"], values["slowest"], values["fastest"])


def kind_name(kind: str) -> str:
    """Name that the units table of a journey gives a kind of quantity."""
    return "position" if kind == "length" else kind


def journey_document(journey: Journey) -> dict[str, Any]:
    """The TOML document of a journey."""
    speeds = [v for p in journey.points for v in (p.slowest_mps, p.fastest_mps) if v is not None]
    speed, of = pick("speed", speeds, "km/h")
    points = []
    for p in journey.points:
        entry = {"position": p.position_m, "earliest": p.earliest_s, "latest": p.latest_s}
        entry["slowest"] = None if p.slowest_mps is None else speed(p.slowest_mps)
        entry["fastest"] = None if p.fastest_mps is None else speed(p.fastest_mps)
        points.append({k: v for k, v in entry.items() if v is not None})
    document = header("journey", journey, line=journey.line_id)
    document["timing_points"] = {"units": {"position": "m", "time": "s", "speed": of}, "list": points}
    return with_sources(document, journey.source)


def write_line(line: Line, path: str | Path) -> Path:
    """Write a line as metropilot TOML; reading it back gives an equal line.

    Raises:
        InputError: The file cannot be written.
    """
    return write_document(line_document(line), path)


def write_journey(journey: Journey, path: str | Path) -> Path:
    """Write a journey as metropilot TOML; reading it back gives an equal journey.

    Raises:
        InputError: The file cannot be written.
    """
    return write_document(journey_document(journey), path)


def write_document(document: Mapping[str, Any], path: str | Path) -> Path:
    """Write a document; see :func:`save`."""
    return save(toml_text(document), path, ".toml")


def save(text: str, path: str | Path, suffix: str) -> Path:
    """Write a text file whose name must end in a suffix, whole or not at all, making its folder.

    Raises:
        InputError: Another suffix, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != suffix:
        raise InputError("wrong kind of file to write", file=path, allowed=f"a name ending in {suffix}")
    atomic_write(path, lambda partial: partial.write_text(text, encoding="utf-8"))
    return path


def toml_text(document: Mapping[str, Any]) -> str:
    """A document as TOML: plain values first, then one block per table.

    Args:
        document: Texts, booleans, numbers, lists and tables of them, tables one level deep as blocks.
    """
    lines = [f"{_key(k)} = {_value(v)}" for k, v in document.items() if not isinstance(v, Mapping)]
    for name, block in document.items():
        if isinstance(block, Mapping):
            lines += ["", f"[{_key(name)}]", *(f"{_key(k)} = {_value(v)}" for k, v in block.items())]
    return "\n".join(lines) + "\n"


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _text(key)


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _number(value: float) -> str:
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if math.isnan(value):
        return "nan"
    whole = value == int(value) and abs(value) < 1e15 and not (value == 0 and math.copysign(1.0, value) < 0)
    return str(int(value)) if whole else repr(value)


def _value(value: object) -> str:
    match value:
        case bool():
            text = "true" if value else "false"
        case int():
            text = str(value)
        case float():
            text = _number(value)
        case str():
            text = _text(value)
        case Mapping():
            inner = ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items())
            text = f"{{ {inner} }}" if inner else "{}"
        case list() | tuple():
            text = _list(value)
        case _:
            raise TypeError(f"TOML has no place for {type(value).__name__}")
    return text


def _list(value: Sequence[object]) -> str:
    items = [_value(item) for item in value]
    flat = "[" + ", ".join(items) + "]"
    nested = any(isinstance(item, (Mapping, list, tuple)) for item in value)
    if not nested and len(flat) <= _WIDTH:
        return flat
    return "[\n" + "".join(f"  {item},\n" for item in items) + "]"
