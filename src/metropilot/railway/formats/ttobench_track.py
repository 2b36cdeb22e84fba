"""TTOBench JSON: tracks and journeys read."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from metropilot.railway.formats.ranges import ANY, NOT_NEGATIVE, Column
from metropilot.railway.formats.reader import Node
from metropilot.railway.formats.toml_line import (
    GRADIENT,
    RADIUS,
    SPEED_LIMIT,
    check_curvature,
    check_inside,
    curvature,
    placed_rows,
    read_tunnels,
    steps,
)
from metropilot.railway.formats.ttobench_common import Metadata, kept
from metropilot.railway.journey import Journey, TimingPoint
from metropilot.railway.line import Curve, Line, Station
from metropilot.railway.profile import Steps

TRACK_KEYS = ("metadata", "altitude", "stops", "speed limits", "gradients", "curvatures", "tunnels")
TIMING_COLUMNS = (
    Column("position", "length"),
    Column("lower time constraint", "time", NOT_NEGATIVE, optional=True),
    Column("upper time constraint", "time", NOT_NEGATIVE, optional=True),
    Column("lower speed constraint", "speed", NOT_NEGATIVE, optional=True),
    Column("upper speed constraint", "speed", NOT_NEGATIVE, optional=True),
)


def read_track(root: Node, stem: str) -> Line:
    """The line that a TTOBench track describes; its stops become stations ``S1``, ``S2`` and so on.

    Raises:
        InputError: Anything in it is missing, malformed or out of range.
    """
    metadata = Metadata(root, stem)
    stops, limits = root.table("stops"), root.table("speed limits")
    altitude, gradients = root.optional("altitude"), root.optional("gradients")
    curvatures, tunnels = root.optional("curvatures"), root.optional("tunnels")
    positions = stops.quantities("values", "length", NOT_NEGATIVE)
    stops.increasing(positions, "values[{}]", stops.unit("values", "length"))
    limit = steps(limits, "position", Column("velocity", "speed", SPEED_LIMIT))
    slope = Column("slope", "gradient", GRADIENT)
    gradient = steps(gradients, "position", slope) if gradients else Steps(limit.from_m[:1], np.zeros(1))
    check_inside(stops, positions, "values[{}]", limit, gradient)
    fields: dict[str, Any] = {
        "altitude_m": altitude.quantity("value", "length", ANY) if altitude else 0.0,
        "curves": _clothoids(curvatures) if curvatures else (),
        "tunnels": read_tunnels(tunnels, "position", "cross section") if tunnels else (),
    }
    blocks = {
        "stops": stops,
        "speed limits": limits,
        "altitude": altitude,
        "gradients": gradients,
        "curvatures": curvatures,
        "tunnels": tunnels,
    }
    extra = kept(root, metadata, blocks)
    ours = {"stops": "stations", "speed limits": "speed_limits", "curvatures": "curves", "altitude": ""}
    names = [ours.get(name, name) for name, block in blocks.items() if block is not None]
    return Line(
        id=metadata.id,
        name=metadata.id,
        stations=tuple(Station(f"S{k}", f"Stop {k}", p) for k, p in enumerate(positions, start=1)),
        limit_mps=limit,
        gradient_permil=gradient,
        **fields,
        source={name: metadata.citation for name in names if name},
        extra=extra,
        unused=tuple(key for key in extra if key not in TRACK_KEYS),
    )


def _clothoids(block: Node) -> tuple[Curve, ...]:
    values = [
        [_radius(cell) if k else cell for k, cell in enumerate(row)] if isinstance(row, list) else row
        for row in block.items("values")
    ]
    for key in ("units", "unit"):
        block.get(key)
    node = Node({**block.data, "values": values}, block.file, block.path)
    ends = [Column(f"radius at {end}", "length", RADIUS) for end in ("start", "end")]
    curves = []
    for index, (start, *radii) in enumerate(placed_rows(node, "position", *ends)):
        bends = [curvature(float(r)) for r in radii]
        for end, bend in zip(ends, bends, strict=True):
            check_curvature(block, f"values[{index}].{end.name}", bend)
        curves.append(Curve(float(start), *bends))
    return tuple(curves)


def _radius(cell: object) -> object:
    """A radius as a number, where the file gives it as text (``infinity``)."""
    try:
        value = float(cell) if isinstance(cell, str) else cell
    except ValueError:
        return cell
    return math.inf if isinstance(value, float) and math.isinf(value) else value


def read_ttobench_journey(root: Node, stem: str) -> Journey:
    """The journey that a TTOBench journey describes.

    Raises:
        InputError: Anything in it is missing, malformed or out of range.
    """
    metadata = Metadata(root, stem)
    block = root.table("timing points")
    table = block.rows("values", TIMING_COLUMNS)
    points = [[None if math.isnan(cell) else float(cell) for cell in row] for row in table]
    extra = kept(root, metadata, {"timing points": block})
    return Journey(
        id=metadata.id,
        line_id=metadata.track,
        points=tuple(TimingPoint(float(row[0] or 0.0), *row[1:]) for row in points),
        source={"timing_points": metadata.citation},
        extra=extra,
        unused=tuple(key for key in extra if key not in {"metadata", "timing points"}),
    )
