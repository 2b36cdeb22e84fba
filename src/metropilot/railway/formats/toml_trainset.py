"""Trainsets in metropilot's own TOML: read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import get_args

import numpy as np

from metropilot.errors import InputError
from metropilot.railway.effort import Efficiency
from metropilot.railway.formats.ranges import (
    ACTUATION_TIME,
    ANY,
    EFFICIENCY,
    EMERGENCY_JERK,
    EMERGENCY_RATE,
    NOT_NEGATIVE,
    POSITIVE,
    POSITIVE_OR_NONE,
    SHARE,
    Column,
    Range,
)
from metropilot.railway.formats.reader import Node, nearest
from metropilot.railway.formats.toml_common import Document
from metropilot.railway.formats.toml_effort import read_effort
from metropilot.railway.trainset import Actuation, Couplers, CurveFormula, Davis, SafeBraking, Trainset
from metropilot.units import STANDARD_GRAVITY_MPS2, Unit, unit

GRAVITY = Range(9.0, 10.5)


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
        service_deceleration_mps2=limits.quantity(
            "service_deceleration", "acceleration", POSITIVE_OR_NONE, math.inf
        ),
        max_acceleration_mps2=limits.quantity("max_acceleration", "acceleration", POSITIVE_OR_NONE, math.inf),
        max_deceleration_mps2=limits.quantity("max_deceleration", "acceleration", POSITIVE_OR_NONE, math.inf),
        adhesion=limits.quantity("adhesion", "share", POSITIVE_OR_NONE, math.inf),
        efficiency_traction=_efficiency(energy, "traction"),
        efficiency_braking=_efficiency(energy, "braking"),
        receptivity=energy.quantity("receptivity", "share", SHARE, 0.0) if energy else 0.0,
        auxiliary_w=energy.quantity("auxiliary", "power", NOT_NEGATIVE, 0.0) if energy else 0.0,
        actuation=_actuation(document.optional("actuation")),
        safe_braking=_safe_braking(document.optional("protection")),
        couplers=_couplers(document.optional("couplers")),
        notches=_notches(document.optional("notches")),
    )


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
    block.increasing(
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
    table.increasing(axes["speed"], "speed[{}]", speed)
    table.increasing(axes["effort_share"], "effort_share[{}]", of)
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


def _actuation(block: Node | None) -> Actuation:
    if block is None:
        return Actuation()
    return Actuation(
        delay_s=block.quantity("delay", "time", ACTUATION_TIME, 0.0),
        lag_s=block.quantity("lag", "time", ACTUATION_TIME, 0.0),
        jerk_limit_mps3=block.quantity("jerk_limit", "jerk", POSITIVE_OR_NONE, math.inf),
    )


def _safe_braking(block: Node | None) -> SafeBraking:
    if block is None:
        return SafeBraking()
    return SafeBraking(
        emergency_deceleration_mps2=block.quantity("emergency_deceleration", "acceleration", EMERGENCY_RATE),
        service_deceleration_mps2=block.quantity("service_deceleration", "acceleration", POSITIVE),
        reaction_s=block.quantity("reaction", "time", ACTUATION_TIME, 0.0),
        buildup_s=block.quantity("buildup", "time", ACTUATION_TIME, 0.0),
        emergency_jerk_mps3=block.quantity("emergency_jerk", "jerk", EMERGENCY_JERK, math.inf),
    )


def _couplers(block: Node | None) -> Couplers:
    if block is None:
        return Couplers()
    vehicles = block.need("vehicles", "a whole number >= 1")
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
        result[name] = levels
    return result
