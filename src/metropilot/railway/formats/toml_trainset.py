"""Trainsets and their effort curves in metropilot's own TOML, read and written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np

from metropilot.errors import InputError
from metropilot.railway.effort import Efficiency, EffortCurve, EffortPiece
from metropilot.railway.formats.reader import (
    ACTUATION_TIME,
    ANY,
    EFFICIENCY,
    EMERGENCY_JERK,
    EMERGENCY_RATE,
    NOT_NEGATIVE,
    POSITIVE,
    POSITIVE_OR_NONE,
    SERVICE_RATE,
    SHARE,
    Column,
    Node,
    Range,
    nearest,
)
from metropilot.railway.formats.toml import Document, header, with_sources, write_document
from metropilot.railway.trainset import (
    COMMAND_TIME,
    SERVICE_JERK,
    Actuation,
    Couplers,
    CurveFormula,
    Davis,
    SafeBraking,
    Trainset,
)
from metropilot.units import STANDARD_GRAVITY_MPS2, Unit, pick, si_unit, unit

GRAVITY = Range(9.0, 10.5)
Keys = dict[str, tuple[str, str, Range, float | None]]
LIMITS: Keys = {
    "service_deceleration": ("service_deceleration_mps2", "acceleration", SERVICE_RATE, math.inf),
    "max_acceleration": ("max_acceleration_mps2", "acceleration", SERVICE_RATE, math.inf),
    "max_deceleration": ("max_deceleration_mps2", "acceleration", SERVICE_RATE, math.inf),
    "adhesion": ("adhesion", "share", POSITIVE_OR_NONE, math.inf),
}
ACTUATION: Keys = {
    "delay": ("delay_s", "time", COMMAND_TIME, 0.0),
    "lag": ("lag_s", "time", COMMAND_TIME, 0.0),
    "jerk_limit": ("jerk_limit_mps3", "jerk", SERVICE_JERK, math.inf),
}
PROTECTION: Keys = {
    "emergency_deceleration": ("emergency_deceleration_mps2", "acceleration", EMERGENCY_RATE, None),
    "service_deceleration": ("service_deceleration_mps2", "acceleration", POSITIVE, None),
    "reaction": ("reaction_s", "time", ACTUATION_TIME, 0.0),
    "buildup": ("buildup_s", "time", ACTUATION_TIME, 0.0),
    "emergency_jerk": ("emergency_jerk_mps3", "jerk", EMERGENCY_JERK, math.inf),
}
"""Fields of blocks by key, with quantity, range and default; None: it must be there."""
_FORMS = ("pieces", "table", "force")
_FORM_WORDS = "one of: pieces, table, force with power"


def read_trainset(root: Node) -> Trainset:
    """The trainset that a TOML document describes.

    Raises:
        InputError: Anything in it is missing, malformed or out of range.
    """
    document = Document(root)
    mass, body = document.block("mass"), document.block("body")
    loads = _loads(mass)
    resistance = document.block("resistance")
    gravity = resistance.quantity("gravity", "acceleration", GRAVITY, STANDARD_GRAVITY_MPS2)
    traction, electric = document.block("traction"), document.block("electric_brake")
    friction = document.optional("friction_brake")
    limits = document.block("limits")
    energy = document.optional("energy")
    formula = resistance.choice("curve_formula", get_args(CurveFormula), "none")
    return document.build(
        Trainset,
        name=root.text("name"),
        loads=loads,
        load=_load(mass, loads),
        rotating_fraction=mass.quantity("rotating_fraction", "share", SHARE, 0.0),
        length_m=body.quantity("length", "length", NOT_NEGATIVE, 0.0),
        max_speed_mps=body.quantity("max_speed", "speed", Range(0.0, 150.0, above=True)),
        davis=_davis(resistance, gravity),
        curve_formula=formula,
        gravity_mps2=gravity,
        tunnel_n_per_mps2=_tunnel(resistance),
        traction=read_effort(traction),
        electric_brake=read_effort(electric),
        friction_brake_n=friction.quantity("force", "force", NOT_NEGATIVE) if friction else 0.0,
        **_read(limits, LIMITS),
        efficiency_traction=_efficiency(energy, "traction"),
        efficiency_braking=_efficiency(energy, "braking"),
        receptivity=energy.quantity("receptivity", "share", SHARE, 0.0) if energy else 0.0,
        auxiliary_w=energy.quantity("auxiliary", "power", NOT_NEGATIVE, 0.0) if energy else 0.0,
        actuation=Actuation(**_read(document.optional("actuation"), ACTUATION)),
        safe_braking=SafeBraking(**_read(document.optional("protection"), PROTECTION)),
        couplers=_couplers(document.optional("couplers")),
        notches=_notches(document.optional("notches")),
    )


def _read(block: Node | None, keys: Keys) -> dict[str, float]:
    """Values of a block by field; nothing without the block."""
    if block is None:
        return {}
    return {name: block.quantity(key, of, bounds, usual) for key, (name, of, bounds, usual) in keys.items()}


def _loads(mass: Node) -> dict[str, float]:
    of = mass.unit("loads", "mass")
    table = mass.table("loads")
    if not table.data:
        raise mass.fail("needs at least one load", "loads", allowed=f"name = mass in {of.name}")
    return {name: mass.number(value, f"loads.{name}", of, POSITIVE) for name, value in table.data.items()}


def _load(mass: Node, loads: Mapping[str, float]) -> str:
    load = mass.text("load", next(iter(loads)))
    if load not in loads:
        raise mass.fail(f"unknown load{nearest(load, list(loads))}", "load", load, ", ".join(loads))
    return load


def _davis(block: Node, gravity: float) -> Davis:
    name = block.table("units").get("davis")
    per_mass = isinstance(name, str) and "/" in name
    of = unit(name, "specific force" if per_mass else "force", file=block.file, field=block.at("units.davis"))
    block.unit("davis", of.kind)
    if of.name == "N/kN":
        of = Unit(of.name, of.kind, gravity, 1000.0)
    speed = block.unit("speed", "speed")
    values = block.items("davis")
    if len(values) != 3:
        raise block.fail(
            "wrong length", "davis", values, "three coefficients: constant, linear, quadratic in speed"
        )
    per_speed = [
        Unit(of.name, of.kind, of.numerator * speed.denominator**k, of.denominator * speed.numerator**k)
        for k in range(3)
    ]
    a, b, c = (block.number(v, f"davis[{k}]", per_speed[k], NOT_NEGATIVE) for k, v in enumerate(values))
    return Davis(a, b, c, per_mass=per_mass)


def _tunnel(block: Node) -> tuple[tuple[float, float], ...]:
    block.may_have_units("cross_section", "tunnel")
    if "tunnel" not in block:
        return ()
    columns = (
        Column("cross_section", "area", POSITIVE),
        Column("tunnel", "force per speed squared", NOT_NEGATIVE),
    )
    rows = block.rows("tunnel", columns)
    block.check_increasing(
        [float(v) for v in rows[:, 0]], "tunnel[{}].cross_section", block.unit("cross_section", "area")
    )
    return tuple((float(area), float(force)) for area, force in rows)


def _efficiency(block: Node | None, key: str) -> Efficiency:
    if block is not None:
        block.may_have_units(key, "speed")
    if block is None or key not in block:
        return Efficiency.constant(1.0)
    if not isinstance(block.get(key), Mapping):
        return Efficiency.constant(block.quantity(key, "share", EFFICIENCY))
    of, speed = block.unit(key, "share"), block.unit("speed", "speed")
    table = block.table(key)
    axes = {
        name: [table.number(v, f"{name}[{i}]", to, bounds) for i, v in enumerate(table.items(name))]
        for name, to, bounds in (("speed", speed, NOT_NEGATIVE), ("effort_share", None, SHARE))
    }
    table.check_increasing(axes["speed"], "speed[{}]", speed)
    table.check_increasing(axes["effort_share"], "effort_share[{}]", of)
    wanted = f"{len(axes['speed'])} rows (speeds) of {len(axes['effort_share'])} (effort shares)"
    rows = table.items("value")
    shapes_fit = all(isinstance(row, list) and len(row) == len(axes["effort_share"]) for row in rows)
    if not (axes["speed"] and axes["effort_share"] and shapes_fit and len(rows) == len(axes["speed"])):
        raise table.fail("wrong shape", "value", allowed=wanted)
    cells = [
        [table.number(v, f"value[{i}][{j}]", of, EFFICIENCY) for j, v in enumerate(row)]
        for i, row in enumerate(rows)
        if isinstance(row, list)
    ]
    table.close()
    return Efficiency(np.array(axes["speed"]), np.array(axes["effort_share"]), np.array(cells))


def _couplers(block: Node | None) -> Couplers:
    if block is None:
        return Couplers()
    vehicles = block.require("vehicles", "a whole number >= 1")
    if isinstance(vehicles, bool) or not isinstance(vehicles, int) or not 1 <= vehicles <= 1000:
        raise block.fail("out of range", "vehicles", vehicles, "a whole number from 1 to 1000")
    default = Couplers()
    return Couplers(
        vehicles=vehicles,
        stiffness_n_per_m=block.quantity("stiffness", "stiffness", POSITIVE, default.stiffness_n_per_m),
        damping_n_s_per_m=block.quantity(
            "damping", "force per speed", NOT_NEGATIVE, default.damping_n_s_per_m
        ),
    )


def _notches(block: Node | None) -> dict[str, tuple[float, ...]]:
    if block is None:
        return {}
    of = block.unit("levels", "force")
    table = block.table("levels")
    result = {}
    for name in table.data:
        levels = tuple(table.number(v, f"{name}[{i}]", of, ANY) for i, v in enumerate(table.items(name)))
        if not levels:
            raise InputError(
                "needs at least one level", file=table.file, field=table.at(name), allowed="forces"
            )
        table.check_increasing(levels, f"{name}[{{}}]", of)
        result[name] = levels
    return result


def read_effort(block: Node) -> EffortCurve:
    """The effort curve of a block, in whichever of its three forms.

    ``pieces = [{ from, polynomial, power, cap }]``, ``table = [[speed, force], ...]`` (linear between the
    points), or ``force`` with ``power`` (the smaller of the force and the power over the speed).

    Raises:
        InputError: No form or several, a bad number, speeds that do not begin at 0 and increase.
    """
    block.may_have_units("speed", "force", "power")
    forms = [form for form in _FORMS if form in block]
    if len(forms) != 1:
        raise block.fail("needs exactly one form", forms[1] if forms else "pieces", allowed=_FORM_WORDS)
    if forms == ["force"]:
        force = block.quantity("force", "force", POSITIVE)
        return EffortCurve.force_power(force, block.quantity("power", "power", POSITIVE))
    if forms == ["table"]:
        rows = block.rows(
            "table", (Column("speed", "speed", NOT_NEGATIVE), Column("force", "force", NOT_NEGATIVE))
        )
        _from_zero(block, [float(v) for v in rows[:, 0]], "table[{}].speed")
        return EffortCurve.table(rows[:, 0], rows[:, 1])
    pieces = [_piece(block, entry, f"pieces[{i}]") for i, entry in enumerate(block.items("pieces"))]
    _from_zero(block, [p.from_mps for p in pieces], "pieces[{}].from")
    return EffortCurve(tuple(pieces))


def _from_zero(block: Node, speeds: list[float], where: str) -> None:
    if not speeds:
        raise block.fail(
            "needs at least one row", where.partition("[")[0], allowed="rows by increasing speed, from 0"
        )
    if speeds[0] != 0.0:
        raise block.fail("must begin at standstill", where.format(0), speeds[0], "0 m/s", "m/s")
    block.check_increasing(speeds, where, block.unit("speed", "speed"))


def _piece(block: Node, entry: object, where: str) -> EffortPiece:
    if not isinstance(entry, Mapping):
        raise block.fail("must be a table", where, entry, "{ from, polynomial, power, cap }")
    node = Node(entry, block.file, block.at(where))
    speed, force = block.unit("speed", "speed"), block.unit("force", "force")
    begin = node.number(node.require("from", f"a number of {speed.name}"), "from", speed, NOT_NEGATIVE)
    given = node.items("polynomial", default=())
    if len(given) > 4:
        raise node.fail("wrong length", "polynomial", given, "up to four coefficients, the constant first")
    per_speed = speed.denominator / speed.numerator
    terms = [node.number(v, f"polynomial[{k}]", force, ANY) * per_speed**k for k, v in enumerate(given)]
    c0, c1, c2, c3 = (terms + [0.0] * 4)[:4]
    power, cap = node.get("power"), node.get("cap")
    piece = EffortPiece(
        from_mps=begin,
        polynomial=(c0, c1, c2, c3),
        power_w=0.0
        if power is None
        else node.number(power, "power", block.unit("power", "power"), NOT_NEGATIVE),
        cap_n=math.inf if cap is None else node.number(cap, "cap", force, POSITIVE_OR_NONE),
    )
    if not given and power is None:
        raise node.fail("needs a polynomial or a power", "polynomial", allowed="polynomial, power or both")
    node.close()
    return piece


def effort_block(curve: EffortCurve) -> dict[str, Any]:
    """The TOML block of an effort curve, as pieces in SI, which lose nothing."""
    pieces = []
    for piece in curve.pieces:
        entry: dict[str, Any] = {"from": piece.from_mps, "polynomial": list(piece.polynomial)}
        if piece.power_w:
            entry["power"] = piece.power_w
        if math.isfinite(piece.cap_n):
            entry["cap"] = piece.cap_n
        pieces.append(entry)
    units = {"speed": "m/s", "force": "N"}
    if any(piece.power_w for piece in curve.pieces):
        units["power"] = "W"
    return {"units": units, "pieces": pieces}


def is_force_power(curve: EffortCurve) -> bool:
    """True if the curve is one piece ``min(force, power / v)``."""
    first = curve.pieces[0]
    return len(curve.pieces) == 1 and not np.any(first.polynomial) and math.isfinite(first.cap_n)


def write_trainset(trainset: Trainset, path: str | Path) -> Path:
    """Write a trainset as metropilot TOML; reading it back gives an equal trainset.

    Raises:
        InputError: The file cannot be written.
    """
    return write_document(trainset_document(trainset), path)


def trainset_document(trainset: Trainset) -> dict[str, Any]:
    """The TOML document of a trainset."""
    t = trainset
    mass, of_mass = pick("mass", list(t.loads.values()), "t")
    top, of_speed = pick("speed", [t.max_speed_mps], "km/h")
    document = header("trainset", t, name=t.name)
    document["mass"] = {
        "units": {"loads": of_mass, "rotating_fraction": "1"},
        "loads": {name: mass(value) for name, value in t.loads.items()},
        "load": t.load,
        "rotating_fraction": t.rotating_fraction,
    }
    document["body"] = {
        "units": {"length": "m", "max_speed": of_speed},
        "length": t.length_m,
        "max_speed": top(t.max_speed_mps),
    }
    document["resistance"] = {
        "units": {"davis": "N/kg" if t.davis.per_mass else "N", "speed": "m/s", "gravity": "m/s^2"},
        "davis": [t.davis.a, t.davis.b, t.davis.c],
        "curve_formula": t.curve_formula,
        "gravity": t.gravity_mps2,
    }
    if t.tunnel_n_per_mps2:
        document["resistance"]["units"] |= {"cross_section": "m^2", "tunnel": "N/(m/s)^2"}
        document["resistance"]["tunnel"] = [list(row) for row in t.tunnel_n_per_mps2]
    document["traction"] = effort_block(t.traction)
    document["electric_brake"] = effort_block(t.electric_brake)
    document["friction_brake"] = {"unit": "N", "force": t.friction_brake_n}
    document |= _blocks(t)
    return with_sources(document, t.source)


def _blocks(t: Trainset) -> dict[str, Any]:
    blocks: dict[str, Any] = {
        "limits": _block(t, LIMITS),
        "energy": _energy_block(t),
        "actuation": _block(t.actuation, ACTUATION),
        "protection": _block(t.safe_braking, PROTECTION),
        "couplers": {
            "units": {"stiffness": "N/m", "damping": "N/(m/s)"},
            "vehicles": t.couplers.vehicles,
            "stiffness": t.couplers.stiffness_n_per_m,
            "damping": t.couplers.damping_n_s_per_m,
        },
    }
    if t.notches:
        blocks["notches"] = {
            "unit": "N",
            "levels": {name: list(forces) for name, forces in t.notches.items()},
        }
    return blocks


def _block(values: object, keys: Keys) -> dict[str, Any]:
    """Values with their units, in one block; those without a bound are left out where that is the default."""
    given = {key: value for key, (name, *_) in keys.items() if math.isfinite(value := getattr(values, name))}
    return {"units": {key: si_unit(keys[key][1]).name for key in given}, **given}


def _energy_block(t: Trainset) -> dict[str, Any]:
    block: dict[str, Any] = {
        "units": {"traction": "1", "braking": "1", "receptivity": "1", "auxiliary": "W"},
        "traction": _efficiency_block(t.efficiency_traction),
        "braking": _efficiency_block(t.efficiency_braking),
        "receptivity": t.receptivity,
        "auxiliary": t.auxiliary_w,
    }
    if isinstance(block["traction"], dict) or isinstance(block["braking"], dict):
        block["units"]["speed"] = "m/s"
    return block


def _efficiency_block(efficiency: Efficiency) -> float | dict[str, Any]:
    plain = efficiency.is_constant and not (efficiency.speed_mps.any() or efficiency.effort_share.any())
    if plain:
        return float(efficiency.value[0, 0])
    return {
        "speed": efficiency.speed_mps.tolist(),
        "effort_share": efficiency.effort_share.tolist(),
        "value": efficiency.value.tolist(),
    }
