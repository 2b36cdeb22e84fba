"""Limits and stations of a line document that are dragged in its drawing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metropilot.units import KMH_PER_MPS, Unit, tidy, unit

GAP_M = 1.0
"""Least distance between two limits, or two stations, that are dragged towards each other."""
LIMIT = ("from", "speed")
"""Kinds of handles of a speed limit: its begin and its speed, in the order of the file's columns."""
STATION = "station"


def line_handles(document: Mapping[str, Any], end_m: float) -> list[dict[str, Any]]:
    """Handles of the drawing of a line, in metres and km/h.

    Args:
        document: A document that its loader accepts.
        end_m: Position of the last station.

    Returns:
        For each limit its speed (``from_m``, ``to_m``, ``kmh``), for each but the first its begin
        (``from_m``, ``before_kmh``, ``least_m``, ``most_m``), and every station (``from_m``, ``least_m``,
        ``most_m``), each with ``kind`` and ``row`` of its table.
    """
    begin, speed = _limit_units(document)
    limits = [
        (begin.to_si(float(row[0])), KMH_PER_MPS * speed.to_si(float(row[1])))
        for row in document["speed_limits"]["values"]
    ]
    found: list[dict[str, Any]] = []
    for k, (from_m, kmh) in enumerate(limits):
        to_m = limits[k + 1][0] if k + 1 < len(limits) else end_m
        told = {"row": k, "from_m": from_m, "to_m": to_m, "kmh": kmh}
        found.append({"kind": "speed", **told})
        if k:
            last_m = to_m - GAP_M if k + 1 < len(limits) else max(end_m, from_m)
            told |= {"before_kmh": limits[k - 1][1], "least_m": limits[k - 1][0] + GAP_M, "most_m": last_m}
            found.append({"kind": "from", **told})
    # begins lie over speeds, which are wider
    found.sort(key=lambda each: each["kind"] == "from")
    length = _station_unit(document)
    at = [length.to_si(float(row["position"])) for row in document["stations"]["list"]]
    for k, from_m in enumerate(at):
        least = at[k - 1] + GAP_M if k else min(from_m, limits[0][0])
        most = at[k + 1] - GAP_M if k + 1 < len(at) else from_m + (at[-1] - at[0])
        found.append({"kind": STATION, "row": k, "from_m": from_m, "least_m": least, "most_m": most})
    return found


def move_handle(document: Mapping[str, Any], kind: str, row: int, value: float) -> None:
    """Write a handle's new place into the document, in its units.

    Args:
        document: The document, changed in place.
        kind: Kind of the handle.
        row: Row of its table; a row that is not there is passed over.
        value: Position, m, or speed, km/h.
    """
    if kind == STATION:
        rows, column = document["stations"]["list"], "position"
        put = _station_unit(document).from_si(value)
    elif kind in LIMIT:
        rows, column = document["speed_limits"]["values"], LIMIT.index(kind)
        put = _limit_units(document)[column].from_si(value / KMH_PER_MPS if column else value)
    else:
        return
    if 0 <= row < len(rows):
        rows[row][column] = tidy(put)


def _limit_units(document: Mapping[str, Any]) -> tuple[Unit, Unit]:
    units = document["speed_limits"]["units"]
    return unit(units["from"], "length"), unit(units["speed"], "speed")


def _station_unit(document: Mapping[str, Any]) -> Unit:
    return unit(document["stations"]["unit"], "length")
