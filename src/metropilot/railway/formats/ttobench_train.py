"""TTOBench JSON: trains read."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from metropilot.railway.effort import Efficiency, EffortCurve
from metropilot.railway.formats.ranges import (
    ACTUATION_TIME,
    EFFICIENCY,
    EMERGENCY_RATE,
    NOT_NEGATIVE,
    POSITIVE,
    SHARE,
    Column,
    Range,
)
from metropilot.railway.formats.reader import Node
from metropilot.railway.formats.ttobench_common import Metadata, kept, scalar
from metropilot.railway.trainset import Couplers, Davis, SafeBraking, Trainset

ETCS = "ETCS braking data"
LOAD = "base"
EFFICIENCIES = ("efficiency traction", "efficiency reg brake")
ASSUMED_EMERGENCY_MPS2 = 1.2
ASSUMED_SERVICE_MPS2 = 1.0
LOWEST_EFFICIENCY = 0.01


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
        "max_acceleration_mps2": scalar(root, "max acceleration", "acceleration", POSITIVE, math.inf),
        "max_deceleration_mps2": scalar(root, "max deceleration", "acceleration", POSITIVE, math.inf),
    }
    kept_raw = {key: root.data[key] for key in EFFICIENCIES if key in root and "values" in root.table(key)}
    fields["efficiency_traction"] = _efficiency(root, EFFICIENCIES[0], efforts[0], braking=False)
    fields["efficiency_braking"] = _efficiency(root, EFFICIENCIES[1], efforts[1], braking=True)
    fields["tunnel_n_per_mps2"] = _tunnel(root)
    fields["couplers"] = _couplers(root)
    safe, unused, notes = _safe_braking(root, efforts[1], fields)
    declared = fields["max_deceleration_mps2"]
    service = service_deceleration(
        declared, efforts[1], fields["friction_brake_n"], fields["loads"][LOAD], fields["rotating_fraction"]
    )
    if service != declared:
        notes = (*notes, f"Full service braking assumed: {service:g} m/s2.")
    if ETCS in root:
        kept_raw[ETCS] = root.data[ETCS]
    extra = kept(root, metadata, {})
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


def _couplers(root: Node) -> Couplers:
    coaches = scalar(root, "num coaches", "share", Range(1.0, 1000.0), 1.0)
    if coaches != int(coaches):
        raise root.fail("must be whole", "num coaches.value", coaches, "a whole number from 1 to 1000")
    return Couplers(vehicles=int(coaches))


def _tunnel(root: Node) -> tuple[tuple[float, float], ...]:
    block = root.optional("tunnel resistance")
    if block is None:
        return ()
    area = Column("cross section", "area", POSITIVE)
    rows = block.rows("values", (area, Column("coefficient", "force per speed squared", NOT_NEGATIVE)))
    block.increasing(
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
    """What protection may rely on where a train file does not say.

    An emergency brake of 1.2 m/s2 (assumed: Chinese metro practice), and in service 1 m/s2 or what electric
    and friction brake give at full speed, whichever is less.
    """
    service = (float(electric.at(top_mps)) + friction_n) / effective_kg
    return SafeBraking(ASSUMED_EMERGENCY_MPS2, min(ASSUMED_SERVICE_MPS2, service) or ASSUMED_SERVICE_MPS2)


def _safe_braking(
    root: Node, electric: EffortCurve, fields: dict[str, Any]
) -> tuple[SafeBraking, list[str], tuple[str, ...]]:
    """What protection may rely on, the entries of the ETCS block without effect, and remarks."""
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
    curve.increasing(
        [float(v) for v in rows[:, 0]], "values[{}].velocity", curve.unit(speed.name, speed.kind)
    )
    return float(rows[:, 1].min())
