"""TTOBench JSON v1.5, written."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from metropilot.errors import InputError
from metropilot.railway.effort import Efficiency, EffortCurve
from metropilot.railway.formats.toml import save, short_radius
from metropilot.railway.formats.toml_trainset import is_force_power
from metropilot.railway.formats.ttobench import (
    EFFICIENCIES,
    ETCS,
    TIMING_COLUMNS,
    assumed_braking,
    service_deceleration,
)
from metropilot.railway.journey import Journey
from metropilot.railway.line import Line
from metropilot.railway.trainset import Couplers, Trainset
from metropilot.units import pick

VERSION = "TTOBench v1.5"


def export_ttobench(thing: Line | Trainset | Journey, path: str | Path) -> tuple[str, ...]:
    """Write a line, a trainset or a journey as TTOBench JSON.

    What came from a TTOBench file is written back whole, keys that metropilot does not use included.

    Args:
        thing: Line, trainset or journey.
        path: Destination, a name ending in ``.json``.

    Returns:
        The fields that the format has no place for and that were therefore left out.

    Raises:
        InputError: An effort curve that is not ``min(force, power / v)``, an efficiency map that did not come
            from TTOBench, or a file that cannot be written.
    """
    document, lost = _WRITERS[type(thing)](thing)
    save(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n", path, ".json")
    return tuple(lost)


def _merge(thing: Line | Trainset | Journey, document: dict[str, Any], **metadata: str) -> dict[str, Any]:
    """The document with metadata in front and what the source file had beyond it."""
    extra = dict(thing.extra)
    rest = extra.pop("metadata", {})
    rest = rest if isinstance(rest, dict) else {}
    whole: dict[str, Any] = {
        "metadata": {"id": thing.id, "library version": VERSION, **rest, **metadata},
        **document,
    }
    for key, value in extra.items():
        mine = whole.get(key)
        if mine is None:
            whole[key] = value
        elif isinstance(mine, dict) and isinstance(value, dict):
            whole[key] = {**value, **mine}
    return whole


def _line(line: Line) -> tuple[dict[str, Any], list[str]]:
    document: dict[str, Any] = {
        "altitude": {"unit": "m", "value": line.altitude_m},
        "stops": {"unit": "m", "values": [s.position_m for s in line.stations]},
    }
    for name, profile, cell, kind, wish in (
        ("speed limits", line.limit_mps, "velocity", "speed", "km/h"),
        ("gradients", line.gradient_permil, "slope", "gradient", "permil"),
    ):
        value, of = pick(kind, profile.value.tolist(), wish)
        rows = [[a, value(v)] for a, v in zip(profile.from_m.tolist(), profile.value.tolist(), strict=True)]
        document[name] = {"units": {"position": "m", cell: of}, "values": rows}
    if line.curves:
        rows = [
            [c.from_m, _radius(c.curvature_start_per_m), _radius(c.curvature_end_per_m)] for c in line.curves
        ]
        units = {"position": "m", "radius at start": "m", "radius at end": "m"}
        document["curvatures"] = {"units": units, "values": rows}
    if line.tunnels:
        rows = [[t.from_m, t.length_m, t.cross_section_m2] for t in line.tunnels]
        units = {"position": "m", "length": "m", "cross section": "m^2"}
        document["tunnels"] = {"units": units, "values": rows}
    plain = all((s.code, s.name) == (f"S{k}", f"Stop {k}") for k, s in enumerate(line.stations, start=1))
    lost = [] if plain else ["stations.code", "stations.name"]
    lost += ["name"] if line.name != line.id else []
    lost += [n for n in ("planned_forward_s", "planned_backward_s", "dwell_s", "notes") if getattr(line, n)]
    return _merge(line, document), lost


def _radius(bend: float) -> float | str:
    radius = short_radius(bend)
    if bend == 0.0 or math.isinf(1.0 / bend):
        return "infinity"
    return 1.0 / bend if radius is None else radius


def _journey(journey: Journey) -> tuple[dict[str, Any], list[str]]:
    rows = [[p.position_m, p.earliest_s, p.latest_s, p.slowest_mps, p.fastest_mps] for p in journey.points]
    speeds = [v for row in rows for v in row[3:] if v is not None]
    speed, of = pick("speed", speeds, "km/h")
    values = [row[:3] + [None if v is None else speed(v) for v in row[3:]] for row in rows]
    units = {column.name: {"length": "m", "time": "s", "speed": of}[column.kind] for column in TIMING_COLUMNS}
    document = {"timing points": {"units": units, "values": values}}
    track = {"associated track": journey.line_id} if journey.line_id else {}
    return _merge(journey, document, **track), ["notes"] if journey.notes else []


def _scalar(value: float, kind: str, wish: str) -> dict[str, Any]:
    convert, of = pick(kind, [value], wish)
    return {"unit": "-" if of == "1" else of, "value": convert(value)}


def _effort(trainset: Trainset, field: str) -> tuple[float, float]:
    curve: EffortCurve = getattr(trainset, field)
    if not is_force_power(curve):
        raise InputError(
            "effort curve that TTOBench cannot express",
            file=trainset.id,
            field=field,
            value=f"{len(curve.pieces)} pieces",
            allowed="one piece, the smaller of a force and a power over the speed",
        )
    return curve.pieces[0].cap_n, curve.pieces[0].power_w


def _efficiency(trainset: Trainset, key: str, efficiency: Efficiency) -> dict[str, Any]:
    if efficiency.is_constant:
        return _scalar(float(efficiency.value[0, 0]), "share", "%")
    raw = trainset.extra.get(key)
    if isinstance(raw, dict):
        return raw
    raise InputError(
        "efficiency map that TTOBench cannot express",
        file=trainset.id,
        field=key,
        allowed="a constant efficiency",
    )


def _trainset(trainset: Trainset) -> tuple[dict[str, Any], list[str]]:
    t = trainset
    force, power = _effort(t, "traction")
    brake_force, brake_power = _effort(t, "electric_brake")
    r0, r1, r2 = t.davis.newtons(t.mass_kg)
    document: dict[str, Any] = {
        "mass": _scalar(t.mass_kg, "mass", "kg"),
        "rho": _scalar(t.rotating_fraction, "share", "%"),
        "max traction power": _scalar(power, "power", "kW"),
        "max reg braking power": _scalar(brake_power, "power", "kW"),
        "max traction force": _scalar(force, "force", "kN"),
        "max reg braking force": _scalar(brake_force, "force", "kN"),
        "max pn braking force": _scalar(t.friction_brake_n, "force", "kN"),
        "max speed": _scalar(t.max_speed_mps, "speed", "km/h"),
        "rolling resistance r0": _scalar(r0, "force", "kN"),
        "rolling resistance r1": _scalar(r1, "force per speed", "kN/(km/h)"),
        "rolling resistance r2": _scalar(r2, "force per speed squared", "kN/(km/h)^2"),
        EFFICIENCIES[0]: _efficiency(t, EFFICIENCIES[0], t.efficiency_traction),
        EFFICIENCIES[1]: _efficiency(t, EFFICIENCIES[1], t.efficiency_braking),
    }
    if t.length_m:
        document["length"] = _scalar(t.length_m, "length", "m")
    if t.couplers.vehicles > 1:
        document["num coaches"] = {"unit": "-", "value": t.couplers.vehicles}
    for name, rate in (("acceleration", t.max_acceleration_mps2), ("deceleration", t.max_deceleration_mps2)):
        if math.isfinite(rate):
            document[f"max {name}"] = {"unit": "m/s^2", "value": rate}
    if t.tunnel_n_per_mps2:
        units = {"cross section": "m^2", "coefficient": "N/(m/s)^2"}
        document["tunnel resistance"] = {"units": units, "values": [list(row) for row in t.tunnel_n_per_mps2]}
    return _merge(t, document), _lost(t)


def _lost(t: Trainset) -> list[str]:
    plain = Trainset("", "", {"base": 1.0}, "base", t.davis, t.traction, t.electric_brake, receptivity=1.0)
    names = (
        "curve_formula",
        "receptivity",
        "auxiliary_w",
        "actuation",
        "adhesion",
    )
    lost = [name for name in (*names, "notches", "gravity_mps2") if getattr(t, name) != getattr(plain, name)]
    service = service_deceleration(
        t.max_deceleration_mps2, t.electric_brake, t.friction_brake_n, t.mass_kg, t.rotating_fraction
    )
    lost += ["service_deceleration_mps2"] if t.service_deceleration_mps2 != service else []
    lost += ["loads"] if len(t.loads) > 1 else []
    lost += ["davis.per_mass"] if t.davis.per_mass else []
    lost += ["couplers"] if t.couplers != Couplers(vehicles=t.couplers.vehicles) else []
    guess = assumed_braking(t.electric_brake, t.friction_brake_n, t.effective_mass_kg, t.max_speed_mps)
    lost += ["safe_braking"] if ETCS not in t.extra and t.safe_braking != guess else []
    return lost


_WRITERS: dict[type, Any] = {Line: _line, Trainset: _trainset, Journey: _journey}
