"""Trainsets as metropilot's own TOML, and the files of all three kinds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from metropilot._io import atomic_write
from metropilot.errors import InputError
from metropilot.railway.effort import Efficiency
from metropilot.railway.formats.toml_common import header, with_sources
from metropilot.railway.formats.toml_effort import effort_block
from metropilot.railway.formats.toml_journey import journey_document
from metropilot.railway.formats.toml_line import line_document
from metropilot.railway.formats.toml_text import toml_text
from metropilot.railway.journey import Journey
from metropilot.railway.line import Line
from metropilot.railway.trainset import Trainset
from metropilot.units import pick


def write_line(line: Line, path: str | Path) -> Path:
    """Write a line as metropilot TOML; reading it back gives an equal line.

    Raises:
        InputError: The file cannot be written.
    """
    return _write(line_document(line), path)


def write_trainset(trainset: Trainset, path: str | Path) -> Path:
    """Write a trainset as metropilot TOML; reading it back gives an equal trainset.

    Raises:
        InputError: The file cannot be written.
    """
    return _write(trainset_document(trainset), path)


def write_journey(journey: Journey, path: str | Path) -> Path:
    """Write a journey as metropilot TOML; reading it back gives an equal journey.

    Raises:
        InputError: The file cannot be written.
    """
    return _write(journey_document(journey), path)


def _write(document: Mapping[str, Any], path: str | Path) -> Path:
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
    safe = t.safe_braking
    rate, time, jerk = "m/s^2", "s", "m/s^3"
    blocks: dict[str, Any] = {
        "limits": _block(
            service_deceleration=(t.service_deceleration_mps2, rate),
            max_acceleration=(t.max_acceleration_mps2, rate),
            max_deceleration=(t.max_deceleration_mps2, rate),
            adhesion=(t.adhesion, "1"),
        ),
        "energy": _energy(t),
        "actuation": _block(
            delay=(t.actuation.delay_s, time),
            lag=(t.actuation.lag_s, time),
            jerk_limit=(t.actuation.jerk_limit_mps3, jerk),
        ),
        "protection": _block(
            emergency_deceleration=(safe.emergency_deceleration_mps2, rate),
            service_deceleration=(safe.service_deceleration_mps2, rate),
            reaction=(safe.reaction_s, time),
            buildup=(safe.buildup_s, time),
            emergency_jerk=(safe.emergency_jerk_mps3, jerk),
        ),
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


def _block(**values: tuple[float, str]) -> dict[str, Any]:
    """Values with their units, in one block; those without a bound are left out where that is the default."""
    given = {name: pair for name, pair in values.items() if math.isfinite(pair[0])}
    return {
        "units": {name: unit for name, (_, unit) in given.items()},
        **{n: v for n, (v, _) in given.items()},
    }


def _energy(t: Trainset) -> dict[str, Any]:
    block: dict[str, Any] = {
        "units": {"traction": "1", "braking": "1", "receptivity": "1", "auxiliary": "W"},
        "traction": _efficiency(t.efficiency_traction),
        "braking": _efficiency(t.efficiency_braking),
        "receptivity": t.receptivity,
        "auxiliary": t.auxiliary_w,
    }
    if isinstance(block["traction"], dict) or isinstance(block["braking"], dict):
        block["units"]["speed"] = "m/s"
    return block


def _efficiency(efficiency: Efficiency) -> float | dict[str, Any]:
    plain = efficiency.is_constant and not (efficiency.speed_mps.any() or efficiency.effort_share.any())
    if plain:
        return float(efficiency.value[0, 0])
    return {
        "speed": efficiency.speed_mps.tolist(),
        "effort_share": efficiency.effort_share.tolist(),
        "value": efficiency.value.tolist(),
    }
