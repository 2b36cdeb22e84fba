"""TTOBench JSON, versions 1.1 to 1.5: tracks, trains and journeys read.

Units are those the file names. What metropilot does not use is kept in ``extra``, written back by
:func:`metropilot.railway.export_ttobench`, and named in ``unused``.

Source: TTOBench v1.5, Kouzoupis et al. 2023, doi 10.1007/s43069-023-00248-x.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from metropilot.errors import InputError
from metropilot.railway.effort import Efficiency, EffortCurve
from metropilot.railway.formats.reader import (
    ACTUATION_TIME,
    ANY,
    EFFICIENCY,
    EMERGENCY_RATE,
    NOT_NEGATIVE,
    POSITIVE,
    SERVICE_RATE,
    SHARE,
    Column,
    Node,
    Range,
)
from metropilot.railway.formats.toml import (
    GRADIENT,
    RADIUS,
    SPEED_LIMIT,
    check_curvature,
    check_inside,
    curvature,
    position_rows,
    read_tunnels,
    steps,
)
from metropilot.railway.journey import Journey, TimingPoint
from metropilot.railway.line import Curve, Line, Station
from metropilot.railway.profile import Steps
from metropilot.railway.trainset import Couplers, Davis, SafeBraking, Trainset

TRACK_KEYS = ("metadata", "altitude", "stops", "speed limits", "gradients", "curvatures", "tunnels")
TIMING_COLUMNS = (
    Column("position", "length"),
    Column("lower time constraint", "time", NOT_NEGATIVE, optional=True),
    Column("upper time constraint", "time", NOT_NEGATIVE, optional=True),
    Column("lower speed constraint", "speed", NOT_NEGATIVE, optional=True),
    Column("upper speed constraint", "speed", NOT_NEGATIVE, optional=True),
)
ETCS = "ETCS braking data"
LOAD = "base"
EFFICIENCIES = ("efficiency traction", "efficiency reg brake")
ASSUMED_EMERGENCY_MPS2 = 1.2
ASSUMED_SERVICE_MPS2 = 1.0
LOWEST_EFFICIENCY = 0.01


def read_ttobench(root: Node, stem: str) -> Line | Trainset | Journey:
    """The track, train or journey that a TTOBench document describes.

    Args:
        root: The whole document.
        stem: The file's name without its ending: the id where the metadata has none.

    Raises:
        InputError: It is none of the three, or anything in it is missing, malformed or out of range.
    """
    try:
        if "timing points" in root:
            return read_ttobench_journey(root, stem)
        if "stops" in root or "speed limits" in root:
            return read_track(root, stem)
        if "mass" in root or any(key.startswith("max ") for key in root.data):
            return read_train(root, stem)
    except InputError as error:
        raise (error if error.file else error.at(file=root.file)) from error
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
        usual = re.sub(r"^\W|[^\w.@,+-]", "_", stem)
        self.id = node.identifier("id", usual) if node else usual
        self.track = node.text("associated track", "") if node else ""
        self.rest: dict[str, Any] = leftovers(node) if node else {}
        cited = [str(self.rest.get(k, "")) for k in ("library version", "created by", "license")]
        self.citation = ", ".join(part for part in (cited[0] or "TTOBench", self.id, *cited[1:]) if part)


def leftovers(node: Node) -> dict[str, Any]:
    """The keys of a table that nothing has read."""
    return {key: value for key, value in node.data.items() if not node.was_read(key)}


def unused_keys(root: Node, metadata: Metadata, blocks: Mapping[str, Node | None]) -> dict[str, Any]:
    """All keys of a document without a field of their own; they are written back on export."""
    extra: dict[str, Any] = {"metadata": metadata.rest} if metadata.rest else {}
    for name, block in blocks.items():
        rest = leftovers(block) if block else {}
        if rest:
            extra[name] = rest
    return extra | leftovers(root)


def scalar(root: Node, key: str, kind: str, bounds: Range, default: float | None = None) -> float:
    """A number that has a table of its own: ``"mass": {"unit": "kg", "value": 278000}``."""
    if key not in root and default is not None:
        return default
    return root.table(key).quantity("value", kind, bounds)


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
    stops.check_increasing(positions, "values[{}]", stops.unit("values", "length"))
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
    extra = unused_keys(root, metadata, blocks)
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
    for index, (start, *radii) in enumerate(position_rows(node, "position", *ends)):
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
    extra = unused_keys(root, metadata, {"timing points": block})
    return Journey(
        id=metadata.id,
        line_id=metadata.track,
        points=tuple(TimingPoint(float(row[0] or 0.0), *row[1:]) for row in points),
        source={"timing_points": metadata.citation},
        extra=extra,
        unused=tuple(key for key in extra if key not in {"metadata", "timing points"}),
    )


def read_train(root: Node, stem: str) -> Trainset:
    """The trainset that a TTOBench train describes.

    Efforts are the smaller of force and power over speed. Full service braking (command -1) is the train's
    ``max deceleration``: the force of its brakes together is what an emergency brake may use. What the format
    leaves open: no bound on acceleration where none is given, all regenerated energy credited (the
    benchmark's convention), ideal actuation, and, where the train gives no deceleration or no ETCS block,
    the rates of service or of protection assumed (said in ``notes``).

    Raises:
        InputError: Anything in it is missing, malformed or out of range.
    """
    metadata = Metadata(root, stem)
    per_speed = ("force", "force per speed", "force per speed squared")
    r0, r1, r2 = (
        scalar(root, f"rolling resistance r{k}", kind, NOT_NEGATIVE) for k, kind in enumerate(per_speed)
    )
    efforts = [
        EffortCurve.force_power(
            scalar(root, f"max {name} force", "force", NOT_NEGATIVE),
            scalar(root, f"max {name} power", "power", NOT_NEGATIVE),
        )
        for name in ("traction", "reg braking")
    ]
    fields: dict[str, Any] = {
        "loads": {LOAD: scalar(root, "mass", "mass", POSITIVE)},
        "rotating_fraction": scalar(root, "rho", "share", SHARE, 0.0),
        "length_m": scalar(root, "length", "length", NOT_NEGATIVE, 0.0),
        "max_speed_mps": scalar(root, "max speed", "speed", Range(0.0, 150.0, above=True)),
        "friction_brake_n": scalar(root, "max pn braking force", "force", NOT_NEGATIVE, 0.0),
        "max_acceleration_mps2": scalar(root, "max acceleration", "acceleration", SERVICE_RATE, math.inf),
        "max_deceleration_mps2": scalar(root, "max deceleration", "acceleration", SERVICE_RATE, math.inf),
    }
    kept_raw = {key: root.data[key] for key in EFFICIENCIES if key in root and "values" in root.table(key)}
    fields["efficiency_traction"] = _efficiency(root, EFFICIENCIES[0], efforts[0], braking=False)
    fields["efficiency_braking"] = _efficiency(root, EFFICIENCIES[1], efforts[1], braking=True)
    fields["tunnel_n_per_mps2"] = _tunnel(root)
    coaches = scalar(root, "num coaches", "share", Range(1.0, 1000.0), 1.0)
    if coaches != int(coaches):
        raise root.fail("must be whole", "num coaches.value", coaches, "a whole number from 1 to 1000")
    fields["couplers"] = Couplers(vehicles=int(coaches))
    safe, unused, notes = _safe_braking(root, efforts[1], fields)
    declared = fields["max_deceleration_mps2"]
    service = service_deceleration(
        declared, efforts[1], fields["friction_brake_n"], fields["loads"][LOAD], fields["rotating_fraction"]
    )
    if service != declared:
        notes = (*notes, f"Full service braking assumed: {service:g} m/s2.")
    if ETCS in root:
        kept_raw[ETCS] = root.data[ETCS]
    extra = unused_keys(root, metadata, {})
    unused += [key for key in extra if key != "metadata"]
    blocks = (
        "mass",
        "body",
        "resistance",
        "traction",
        "electric_brake",
        "friction_brake",
        "limits",
        "energy",
    )
    return Trainset(
        id=metadata.id,
        name=metadata.id,
        load=LOAD,
        davis=Davis(r0, r1, r2),
        traction=efforts[0],
        electric_brake=efforts[1],
        receptivity=1.0,
        service_deceleration_mps2=service,
        safe_braking=safe,
        source=dict.fromkeys((*blocks, *(("protection",) if ETCS in root else ())), metadata.citation),
        notes=notes,
        extra=extra | kept_raw,
        unused=tuple(unused),
        **fields,
    )


def _tunnel(root: Node) -> tuple[tuple[float, float], ...]:
    block = root.optional("tunnel resistance")
    if block is None:
        return ()
    area = Column("cross section", "area", POSITIVE)
    rows = block.rows("values", (area, Column("coefficient", "force per speed squared", NOT_NEGATIVE)))
    block.check_increasing(
        [float(v) for v in rows[:, 0]], "values[{}].cross section", block.unit(area.name, area.kind)
    )
    return tuple((float(section), float(force)) for section, force in rows)


def _efficiency(root: Node, key: str, effort: EffortCurve, *, braking: bool) -> Efficiency:
    """Constant, or from a map of losses over load and speed.

    Where no power flows (at standstill or without load) an efficiency has no meaning: those cells take the
    value of their nearest neighbour with power, and what the train loses when idle is left out.
    """
    if key not in root:
        return Efficiency.constant(1.0)
    block = root.table(key)
    if "values" not in block:
        return Efficiency.constant(block.quantity("value", "share", EFFICIENCY))
    columns = (
        Column("load", "share", SHARE),
        Column("velocity", "speed", NOT_NEGATIVE),
        Column("losses", "power", NOT_NEGATIVE),
    )
    rows = block.rows("values", columns)
    loads, speeds = np.unique(rows[:, 0]), np.unique(rows[:, 1])
    speeds, loads = speeds[speeds > 0], loads[loads > 0]
    cells = {(load, speed): loss for load, speed, loss in rows.tolist()}
    if not (loads.size and speeds.size) or any((p, v) not in cells for p in loads for v in speeds):
        raise block.fail("not a full grid", "values", allowed="a row for each pair of load and velocity")
    power = loads[None, :] * (effort.at(speeds) * speeds)[:, None]
    losses = np.array([[cells[load, speed] for load in loads] for speed in speeds])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (power - losses) / power if braking else power / (power + losses)
    share = np.nan_to_num(share, nan=1.0, neginf=0.0)
    return Efficiency(speeds, loads, np.clip(share, LOWEST_EFFICIENCY, 1.0))


def service_deceleration(
    declared_mps2: float, electric: EffortCurve, friction_n: float, mass_kg: float, rotating_fraction: float
) -> float:
    """Full service braking of a train file: what it declares, m/s2.

    Where it declares nothing, its brakes are the bound, or 1 m/s2 (assumed) if they are stronger than that.
    """
    strongest = (float(electric.at(0.0)) + friction_n) / (mass_kg * (1.0 + rotating_fraction))
    stands = math.isfinite(declared_mps2) or strongest <= ASSUMED_SERVICE_MPS2
    return declared_mps2 if stands else ASSUMED_SERVICE_MPS2


def assumed_braking(
    electric: EffortCurve, friction_n: float, effective_kg: float, top_mps: float
) -> SafeBraking:
    """Guaranteed braking of a train whose file does not declare it.

    An emergency brake of 1.2 m/s2 (assumed: Chinese metro practice), and in service 1 m/s2 or what electric
    and friction brake give at full speed, whichever is less.
    """
    service = (float(electric.at(top_mps)) + friction_n) / effective_kg
    return SafeBraking(ASSUMED_EMERGENCY_MPS2, min(ASSUMED_SERVICE_MPS2, service) or ASSUMED_SERVICE_MPS2)


def _safe_braking(
    root: Node, electric: EffortCurve, fields: dict[str, Any]
) -> tuple[SafeBraking, list[str], tuple[str, ...]]:
    """Guaranteed braking, the entries of the ETCS block without effect, and remarks."""
    effective_kg = fields["loads"][LOAD] * (1.0 + fields["rotating_fraction"])
    assumed = assumed_braking(electric, fields["friction_brake_n"], effective_kg, fields["max_speed_mps"])
    service = assumed.service_deceleration_mps2
    if ETCS not in root:
        note = (
            f"Protection's rates assumed: emergency {ASSUMED_EMERGENCY_MPS2:g}, service {service:.3g} m/s2."
        )
        return assumed, [], (note,)
    block = root.table(ETCS)
    cut_off = scalar(block, "T_traction", "time", ACTUATION_TIME, 0.0)
    dry = scalar(block, "K_dry_rst", "share", EFFICIENCY, 1.0)
    emergency = _lowest(block, "A_brake_emergency", ASSUMED_EMERGENCY_MPS2 / dry)
    built_up = scalar(block, "T_be", "time", ACTUATION_TIME, cut_off)
    safe = SafeBraking(
        emergency_deceleration_mps2=emergency * dry,
        service_deceleration_mps2=_lowest(block, "A_brake_service", service),
        reaction_s=cut_off,
        buildup_s=max(built_up - cut_off, 0.0),
    )
    used = {"T_traction", "K_dry_rst", "A_brake_emergency", "T_be", "A_brake_service"}
    return safe, [f"{ETCS}.{key}" for key in block.data if key not in used], ()


def _lowest(block: Node, key: str, default: float) -> float:
    if key not in block:
        return default
    curve = block.table(key)
    speed = Column("velocity", "speed", NOT_NEGATIVE)
    rows = curve.rows("values", (speed, Column("deceleration", "acceleration", EMERGENCY_RATE)))
    if not len(rows):
        raise curve.fail("needs at least one row", "values", allowed="rows of velocity and deceleration")
    curve.check_increasing(
        [float(v) for v in rows[:, 0]], "values[{}].velocity", curve.unit(speed.name, speed.kind)
    )
    return float(rows[:, 1].min())
