"""Effort curves in metropilot's own TOML: pieces, a table, or a force/power hyperbola."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from metropilot.railway.effort import EffortCurve, EffortPiece
from metropilot.railway.formats.ranges import ANY, NOT_NEGATIVE, POSITIVE, POSITIVE_OR_NONE, Column
from metropilot.railway.formats.reader import Node

_FORMS = ("pieces", "table", "force")
_FORM_WORDS = "one of: pieces, table, force with power"


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
    block.increasing(speeds, where, block.unit("speed", "speed"))


def _piece(block: Node, entry: object, where: str) -> EffortPiece:
    if not isinstance(entry, Mapping):
        raise block.fail("must be a table", where, entry, "{ from, polynomial, power, cap }")
    node = Node(entry, block.file, block.at(where))
    speed, force = block.unit("speed", "speed"), block.unit("force", "force")
    begin = node.number(node.need("from", f"a number of {speed.name}"), "from", speed, NOT_NEGATIVE)
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
    """Whether the curve is one piece ``min(force, power / v)``."""
    first = curve.pieces[0]
    return len(curve.pieces) == 1 and not np.any(first.polynomial) and math.isfinite(first.cap_n)
