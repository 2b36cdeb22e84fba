"""Cost at the line of a joule at the wheel: constants, or maps over speed and effort made convex.

With an efficiency map the traction force ``f`` costs ``c(f, v) = f / eta(v, f / F(v))`` per metre. In
``f`` this is replaced by its lower convex hull (exact at the points of the map where losses grow with
effort, as they do near full power; where part load is the dear one, the hull says what switching between
nothing and more would cost), in ``v`` by its tangent at the last iterate. What braking gives back is
treated the same way, with the upper concave hull.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.physics import Vehicle, map_value
from metropilot.planning.effort_table import Specific
from metropilot.planning.loads import Loads

Objective = Literal["wheel", "line"]
"""Energy that a plan makes least: at the wheel, or at the line less what is recovered."""
SHARES = 11


class Facets(NamedTuple):
    """Straight lines over a force per kg: a cost is at least the highest, a gain at most the lowest.

    Attributes:
        slope: J at the line per J at the wheel. Shape (K, U).
        offset: Value at force zero, m/s^2. Shape (K, U).
    """

    slope: Float[ndarray, "lines loads"]
    offset: Float[ndarray, "lines loads"]

    @property
    def single(self) -> bool:
        """True if one line through zero is exact."""
        return self.slope.shape[0] == 1


class Prices(NamedTuple):
    """Prices in the objective, per kg of effective mass: for each load of the programme.

    Attributes:
        traction: Cost of traction at the wheel.
        recovered: Worth of electric braking at the wheel.
        second_w: Cost of a second, W per kg of the head (auxiliaries of all trainsets).
        energy: Change of cost per metre with the kinetic energy in the middle of a segment, since efficiency
            depends on speed. Shape (U,).
        energy_at: The kinetic energy it is taken at. Shape (U,).
        received_w: Most power of recovered braking that is worth anything, W per kg; None: all of it.
            Shape (U,).
        surplus_w: Power that others return and nobody else takes, W per kg: traction up to it costs nothing;
            None: no such. Shape (U,).
    """

    traction: Facets
    recovered: Facets
    second_w: float
    energy: Float[ndarray, " loads"]
    energy_at: Float[ndarray, " loads"]
    received_w: Float[ndarray, " loads"] | None = None
    surplus_w: Float[ndarray, " loads"] | None = None


def constant_line(value: float, segments: int) -> Facets:
    """One price for every segment."""
    return Facets(np.full((1, segments), value), np.zeros((1, segments)))


def is_mapped(vehicle: Vehicle) -> bool:
    """True if an efficiency depends on speed or effort."""
    return vehicle.efficiency_traction.size > 1 or vehicle.efficiency_braking.size > 1


def cost_per_metre(
    vehicle: Vehicle, table: Specific, objective: str, middle: ndarray, traction: ndarray, electric: ndarray
) -> Float[ndarray, " segments"]:
    """True cost of forces held on segments, by the plant's own map, J/kg per m.

    Args:
        vehicle: Trainset.
        table: The same, per kg.
        objective: ``wheel`` or ``line``.
        middle: Kinetic energy per kg. Shape (N,).
        traction: Traction per kg. Shape (N,).
        electric: Electric braking per kg. Shape (N,).
    """
    if objective == "wheel":
        return traction
    motoring, braking = _efficiencies(vehicle, table, middle, traction, electric)
    return traction / motoring - electric * braking * float(vehicle.receptivity)


def prices_at(
    loads: Loads,
    objective: str,
    energy: Float[ndarray, " nodes"],
    forces: tuple[ndarray, ndarray] | None,
    *,
    averaged: bool = False,
) -> Prices:
    """Prices of every load about an iterate.

    Args:
        loads: Loads.
        objective: ``wheel`` or ``line``.
        energy: Kinetic energy per kg at the nodes of the last iterate.
        forces: Traction and electric braking of the loads per kg there, or None before the first.
        averaged: One price a load, the average at these forces, instead of convex hulls over the force.
    """
    middle = 0.5 * (energy[1:] + energy[:-1])[loads.segment]
    parts = []
    for kind, (vehicle, table) in enumerate(zip(loads.vehicles, loads.tables, strict=True)):
        own = loads.of_kind(kind)
        of = None if forces is None else (forces[0][own], forces[1][own])
        prices = _prices_of(vehicle, table, objective, middle[own], of, averaged=averaged)
        seconds = prices.second_w * float(np.sum(loads.weight[own], where=loads.segment[own] == 0))
        parts.append(prices._replace(second_w=seconds))
    if len(parts) == 1:
        return parts[0]
    # what is received is set for the plan of one trainset only
    traction, recovered, second_w, slope, at = zip(*(part[:5] for part in parts), strict=True)
    return Prices(
        _join_lines(traction),
        _join_lines(recovered),
        sum(second_w),
        np.concatenate(slope),
        np.concatenate(at),
    )


def _join_lines(parts: tuple[Facets, ...]) -> Facets:
    """Lines of several kinds side by side; of a kind with fewer lines the last one repeats."""
    most = max(part.slope.shape[0] for part in parts)
    filled = [[np.pad(x, ((0, most - x.shape[0]), (0, 0)), "edge") for x in part] for part in parts]
    return Facets(*(np.concatenate(x, axis=1) for x in zip(*filled, strict=True)))


def _prices_of(
    vehicle: Vehicle,
    table: Specific,
    objective: str,
    middle: ndarray,
    forces: tuple[ndarray, ndarray] | None,
    *,
    averaged: bool,
) -> Prices:
    """Prices of the loads of one kind of trainset at their kinetic energies."""
    n, none = middle.size, np.zeros(middle.size)
    if objective == "wheel":
        return Prices(constant_line(1.0, n), constant_line(0.0, n), 0.0, none, middle)
    second_w = float(vehicle.auxiliary_w) / table.mass_kg
    receptivity = float(vehicle.receptivity)
    if not is_mapped(vehicle):
        motoring, braking = vehicle.efficiency_traction.item(), vehicle.efficiency_braking.item()
        lines = constant_line(1.0 / motoring, n), constant_line(braking * receptivity, n)
        return Prices(*lines, second_w, none, middle)
    if averaged and forces is not None:
        motoring, braking = _efficiencies(vehicle, table, middle, *forces)
        lines = Facets(1.0 / motoring[None], none[None]), Facets(receptivity * braking[None], none[None])
    else:
        lines = _hulls(vehicle, table, middle)
    return Prices(*lines, second_w, _speed_slope(vehicle, table, objective, middle, forces), middle)


def _efficiencies(
    vehicle: Vehicle, table: Specific, middle: ndarray, traction: ndarray, electric: ndarray
) -> tuple[ndarray, ndarray]:
    speed = np.sqrt(2 * middle)
    up = traction / np.maximum(np.interp(speed, table.speed_mps, table.traction), 1e-6)
    down = electric / np.maximum(np.interp(speed, table.speed_mps, table.electric), 1e-6)
    return (
        map_value(vehicle, vehicle.efficiency_traction, speed, np.clip(up, 0.0, 1.0)),
        map_value(vehicle, vehicle.efficiency_braking, speed, np.clip(down, 0.0, 1.0)),
    )


def _speed_slope(
    vehicle: Vehicle, table: Specific, objective: str, middle: ndarray, forces: tuple[ndarray, ndarray] | None
) -> ndarray:
    """Change of cost with kinetic energy at held forces, by a central difference."""
    if forces is None:
        return np.zeros(middle.size)
    step = 0.02 * middle + 0.05
    faster, slower = middle + step, np.maximum(middle - step, 0.0)
    change = cost_per_metre(vehicle, table, objective, faster, *forces)
    change -= cost_per_metre(vehicle, table, objective, slower, *forces)
    return change / (faster - slower)


def _hulls(vehicle: Vehicle, table: Specific, middle: ndarray) -> tuple[Facets, Facets]:
    """Cost of traction and worth of braking at these speeds, over the force."""
    speed = np.sqrt(2 * middle)
    share = np.unique(np.append(np.linspace(0.0, 1.0, SHARES), np.clip(vehicle.efficiency_share, 0.0, 1.0)))
    at = [np.full(middle.size, s) for s in share]
    cost = np.stack([s / map_value(vehicle, vehicle.efficiency_traction, speed, s) for s in at])
    gain = np.stack([s * map_value(vehicle, vehicle.efficiency_braking, speed, s) for s in at])
    traction = _facets(share, cost, np.interp(speed, table.speed_mps, table.traction))
    loss = _facets(
        share, -float(vehicle.receptivity) * gain, np.interp(speed, table.speed_mps, table.electric)
    )
    return traction, Facets(-loss.slope, -loss.offset)


def _facets(share: ndarray, cost: ndarray, available: ndarray) -> Facets:
    """Lower convex hull of a cost per available force over the share of it, as lines over the force."""
    hull = np.stack([_hull(share, column) for column in cost.T], axis=1)
    slope = np.diff(hull, axis=0) / np.diff(share)[:, None]
    return Facets(slope, available * (hull[:-1] - slope * share[:-1, None]))


def _hull(x: ndarray, y: ndarray) -> ndarray:
    """The lower convex hull of points, at the same places."""
    kept: list[int] = []
    for k in range(x.size):
        while len(kept) > 1:
            i, j = kept[-2:]
            if (y[j] - y[i]) * (x[k] - x[i]) < (y[k] - y[i]) * (x[j] - x[i]):
                break
            kept.pop()
        kept.append(k)
    return np.interp(x, x[kept], y[kept])
