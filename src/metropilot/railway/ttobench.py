"""TTOBench JSON, versions 1.1 to 1.5: which kind a file is, and tracks and journeys read.

Units are those the file names. What metropilot does not use is kept in ``extra``, written back by
:func:`metropilot.railway.ttobench_write.export_ttobench`, and named in ``unused``.

Source: TTOBench v1.5, Kouzoupis et al. 2023, doi 10.1007/s43069-023-00248-x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from metropilot.errors import InputError
from metropilot.railway.journey import Journey, TimingPoint
from metropilot.railway.line import Curve, Line, Station
from metropilot.railway.node import ANY, NOT_NEGATIVE, Bounds, Column, Node
from metropilot.railway.profile import Steps
from metropilot.railway.toml_common import located
from metropilot.railway.toml_line import (
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
from metropilot.railway.trainset import Trainset

TRACK_KEYS = ("metadata", "altitude", "stops", "speed limits", "gradients", "curvatures", "tunnels")
TRACK_UNUSED = "ETCS braking data"
TIMING_COLUMNS = (
    Column("position", "length"),
    Column("lower time constraint", "time", ANY, optional=True),
    Column("upper time constraint", "time", ANY, optional=True),
    Column("lower speed constraint", "speed", NOT_NEGATIVE, optional=True),
    Column("upper speed constraint", "speed", NOT_NEGATIVE, optional=True),
)


def read_ttobench(root: Node, stem: str) -> Line | Trainset | Journey:
    """The track, train or journey that a TTOBench document describes.

    Args:
        root: The whole document.
        stem: The file's name without its ending: the id where the metadata has none.

    Raises:
        InputError: It is none of the three, or anything in it is missing, malformed or out of range.
    """
    from metropilot.railway.ttobench_train import read_train

    try:
        if "timing points" in root:
            return read_ttobench_journey(root, stem)
        if "stops" in root or "speed limits" in root:
            return read_track(root, stem)
        if "mass" in root or any(key.startswith("max ") for key in root.data):
            return read_train(root, stem)
    except InputError as error:
        raise (error if error.file else located(error, root.file)) from error
    raise InputError(
        "neither a track, a train nor a journey of TTOBench",
        file=root.file,
        field="stops, mass, timing points",
        allowed="one of these three at the top",
    )


class Metadata:
    """The metadata of a TTOBench document: id, whom to cite, and what to keep.

    Args:
        root: The whole document.
        stem: The id where the document has none.
    """

    def __init__(self, root: Node, stem: str) -> None:
        node = root.optional("metadata")
        self.id = node.text("id", stem) if node else stem
        self.track = node.text("associated track", "") if node else ""
        self.rest: dict[str, Any] = leftovers(node) if node else {}
        cited = [str(self.rest.get(k, "")) for k in ("library version", "created by", "license")]
        self.citation = ", ".join(part for part in (cited[0] or "TTOBench", self.id, *cited[1:]) if part)


def leftovers(node: Node) -> dict[str, Any]:
    """The keys of a table that nothing has read."""
    return {key: value for key, value in node.data.items() if not node.was_read(key)}


def kept(root: Node, metadata: Metadata, blocks: Mapping[str, Node | None]) -> dict[str, Any]:
    """Everything of a document that the object has no place for: what is written back on export."""
    extra: dict[str, Any] = {"metadata": metadata.rest} if metadata.rest else {}
    for name, block in blocks.items():
        rest = leftovers(block) if block else {}
        if rest:
            extra[name] = rest
    return extra | leftovers(root)


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


def scalar(root: Node, key: str, kind: str, bounds: Bounds, default: float | None = None) -> float:
    """A number that has a table of its own: ``"mass": {"unit": "kg", "value": 278000}``."""
    if key not in root and default is not None:
        return default
    return root.table(key).quantity("value", kind, bounds)
