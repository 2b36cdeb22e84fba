"""Journeys in metropilot's own TOML."""

from __future__ import annotations

from typing import Any

from metropilot.railway.formats.ranges import ANY, NOT_NEGATIVE, Range
from metropilot.railway.formats.reader import Node
from metropilot.railway.formats.toml_common import Document, header, with_sources
from metropilot.railway.journey import Journey, TimingPoint
from metropilot.units import pick

POINT_FIELDS = (("earliest", "time"), ("latest", "time"), ("slowest", "speed"), ("fastest", "speed"))


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
    """What the units table of a journey calls a kind of quantity."""
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
