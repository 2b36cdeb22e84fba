"""Voltages and currents of a DC network with moving trains, solved for many seconds at once.

Along the line all nodes of a second, substations and trains, stand in the order of their places. At every
node both tracks have a voltage, equal at a substation and at a storage beside the track. That makes the
equations of a second block tridiagonal with blocks of two, and one elimination along the line serves all
seconds together.

Conductor rail and running rails are one loop resistance. That is exact without leakage to earth, as both
carry the same current; the potential of the running rails against earth is not modelled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Bool, Float, Int
from metropilot.errors import Infeasible, SolverError
from metropilot.operation.storage import allowed_w, periodic_start_j, stored_j
from metropilot.railway import Feeding, Storage

CHUNK = 2048
"""Seconds solved together: few enough for a row of numbers to stay in the processor's cache."""
NEAR_M = 0.5
"""Nodes nearer to each other than this count as this far apart."""
BALANCED_A = 1e-7
"""Sum of the currents at a node below which it is balanced."""
ROUNDING_V = 4e-13
"""Rounding of a voltage, which short rails and steep elements turn into current."""
MOST_STEPS = 200
FARTHEST_V = 200.0
"""Longest Newton step: beyond it the kinks of the elements make a tangent worthless."""
BISECTIONS = 30
LEAST_V = 1.0
LEAK_S = 1e-9
"""Conductance added to the tangent alone, which would be singular where every rectifier blocks."""
MOST_ROUNDS, FULL_J = 60, 1.0
"""Times that a network is solved until its storages have room and energy for what they do, within a joule."""
SERVED = 1.0 - 1e-6
"""Share of its power below which a train lacks some."""


class TrainLoads(NamedTuple):
    """Trains on the line second by second, one row for each train and second.

    Attributes:
        second: Second, from 0. Shape (K,).
        train: Number of the train in its direction. Shape (K,).
        backward: True in the direction of falling positions. Shape (K,).
        position_m: Position along the line. Shape (K,).
        power_w: Power that the train wants to draw; negative: to return. Shape (K,).
        journey: Rows of one storage aboard, one after the other in their order; None: one for each train.
            Shape (K,).
    """

    second: Int[ndarray, " rows"]
    train: Int[ndarray, " rows"]
    backward: Bool[ndarray, " rows"]
    position_m: Float[ndarray, " rows"]
    power_w: Float[ndarray, " rows"]
    journey: Int[ndarray, " rows"] | None = None

    def journeys(self) -> list[Int[ndarray, " part"]]:
        """Rows of each journey, in their order."""
        key = 2 * self.train + self.backward if self.journey is None else self.journey
        order = np.lexsort((self.second, key)) if self.journey is None else np.argsort(key, kind="stable")
        return np.split(order, np.flatnonzero(np.diff(key[order])) + 1)

    def part(self, rows: Int[ndarray, " part"]) -> TrainLoads:
        """Some of the rows."""
        journey = None if self.journey is None else self.journey[rows]
        return TrainLoads(
            self.second[rows],
            self.train[rows],
            self.backward[rows],
            self.position_m[rows],
            self.power_w[rows],
            journey,
        )


@dataclass(frozen=True, eq=False)
class NetworkFlow:
    """Voltages and powers of a network second by second, and their sums.

    Attributes:
        loads: Trains.
        train_v: Voltage at each row of the loads. Shape (K,).
        train_w: Power drawn there, negative where it is returned. Shape (K,).
        substation_v: Voltage at each substation. Shape (T, S).
        rectifier_w: Power from the grid into each rectifier, its inner loss included. Shape (T, S).
        inverter_w: Power from each inverter into the grid. Shape (T, S).
        substation_loss_w: Loss in the inner resistances. Shape (T, S).
        rail_loss_w: Loss in the rails. Shape (T,).
        steps: Most Newton steps of a second.
        storage_w: Power into each storage beside the track, negative out of it. Shape (T, G).
        storage_j: Its energy before each second, and after the last. Shape (T+1, G).
        onboard_w: Power into the storage aboard at each row. Shape (K,).
        onboard_change_j: Change of the energy aboard, from the first to the last of each journey.
    """

    loads: TrainLoads
    train_v: Float[ndarray, " rows"]
    train_w: Float[ndarray, " rows"]
    substation_v: Float[ndarray, "seconds substations"]
    rectifier_w: Float[ndarray, "seconds substations"]
    inverter_w: Float[ndarray, "seconds substations"]
    substation_loss_w: Float[ndarray, "seconds substations"]
    rail_loss_w: Float[ndarray, " seconds"]
    steps: int
    storage_w: Float[ndarray, "seconds storages"]
    storage_j: Float[ndarray, "instants storages"]
    onboard_w: Float[ndarray, " rows"]
    onboard_change_j: float

    @property
    def stored_j(self) -> float:
        """Energy that storages hold more at the end than at the beginning."""
        return float((self.storage_j[-1] - self.storage_j[0]).sum()) + self.onboard_change_j

    @property
    def storage_in_j(self) -> float:
        """Energy into storages less that out of them: their losses, and what they hold more in the end."""
        return float(self.storage_w.sum() + self.onboard_w.sum())

    @property
    def lacking_w(self) -> Float[ndarray, " rows"]:
        """Power that each row wants to draw and does not get."""
        return np.maximum(self.loads.power_w, 0.0) - np.maximum(self.train_w, 0.0)

    @property
    def is_served(self) -> Bool[ndarray, " rows"]:
        """True where a train gets what it wants."""
        return (self.loads.power_w <= 0.0) | (self.train_w >= SERVED * self.loads.power_w)

    @property
    def supplied_j(self) -> float:
        """Energy from the grid."""
        return float(self.rectifier_w.sum())

    @property
    def inverted_j(self) -> float:
        """Energy that inverters return to the grid."""
        return float(self.inverter_w.sum())

    @property
    def drawn_j(self) -> float:
        """Energy that trains draw from the rails."""
        return float(np.maximum(self.train_w, 0.0).sum())

    @property
    def offered_j(self) -> float:
        """Energy that braking trains could return."""
        return float(np.maximum(-self.loads.power_w, 0.0).sum())

    @property
    def returned_j(self) -> float:
        """Energy that they return; the rest is squeezed."""
        return float(np.maximum(-self.train_w, 0.0).sum())

    @property
    def loss_j(self) -> float:
        """Energy lost in rails and substations."""
        return float(self.rail_loss_w.sum() + self.substation_loss_w.sum())

    @property
    def imbalance(self) -> float:
        """Energy that the sums lack, over that which flows in, or could where that is less."""
        into = self.supplied_j + self.returned_j
        out = self.inverted_j + self.drawn_j + self.loss_j + self.storage_in_j
        # where all is squeezed what flows is rounding, and nothing to compare with
        whole = max(into, self.offered_j)
        return (into - out) / whole if whole else 0.0

    def lowest(self) -> int | None:
        """Row of the lowest voltage at a train; None without trains."""
        return int(np.argmin(self.train_v)) if self.train_v.size else None

    def check_served(self) -> None:
        """Refuse a network that does not carry its load.

        Raises:
            Infeasible: A train gets less power than it wants; names the train that lacks most.
        """
        lacking = self.lacking_w
        if not lacking.size:
            return
        row = int(np.argmax(lacking))
        if not self.is_served[row]:
            raise _overload_error(self.loads, row, float(self.train_v[row]))


def _overload_error(loads: TrainLoads, row: int, voltage_v: float) -> Infeasible:
    way = "backward" if loads.backward[row] else "forward"
    return Infeasible(
        f"the network cannot carry the load: {way} train {loads.train[row]} at "
        f"{loads.position_m[row]:.0f} m in second {loads.second[row]}, "
        f"which wants {loads.power_w[row] / 1000.0:.0f} kW",
        field="feeding",
        value=round(voltage_v, 1),
        unit="V",
        allowed="a voltage at which its current limit leaves it this power",
    )


def _train_current(
    feeding: Feeding, power_w: ndarray, voltage_v: ndarray
) -> tuple[Float[ndarray, "..."], Float[ndarray, "..."]]:
    """Current that trains draw at a voltage, and its derivative."""
    wanted_a = power_w / voltage_v
    slope = -wanted_a / voltage_v
    span_v = feeding.reduced_below_v - feeding.cut_off_v
    share = np.clip((voltage_v - feeding.cut_off_v) / span_v, 0.0, 1.0)
    limit_a = feeding.max_current_a * share
    limited = wanted_a > limit_a
    ramp = feeding.max_current_a / span_v * ((share > 0.0) & (share < 1.0))
    current_a = np.where(limited, limit_a, wanted_a)
    slope = np.where(limited, ramp, slope)
    span_v = feeding.max_v - feeding.squeezed_above_v
    share = np.clip((feeding.max_v - voltage_v) / span_v, 0.0, 1.0)
    squeezed = (power_w < 0.0) & (share < 1.0)
    slope = np.where(squeezed, slope * share - wanted_a / span_v * (share > 0.0), slope)
    return np.where(squeezed, wanted_a * share, current_a), slope


class _Nodes(NamedTuple):
    """Nodes of some seconds in the order of their places, the first axis; seconds are the second one.

    Attributes:
        power_w: Power that a train wants; 0 elsewhere.
        backward: True where the train is on the track of the backward direction.
        tied: True at a substation, and at a storage beside the track.
        rectifier_s: Conductance of its rectifier; 0 elsewhere.
        inverter_s: Conductance of its inverter; 0 elsewhere.
        no_load_v: No-load voltage of the rectifier.
        inverter_v: Voltage above which the inverter works.
        storage: Conductance and voltage of charging and the same of discharging. Shape (4, N, T), or
            (0, N, T) without any.
        charge_w: Most power of charging.
        discharge_w: Most power of discharging.
        rail_s: Conductance of the rails of one track to the next node. One row less.
    """

    power_w: ndarray
    backward: ndarray
    tied: ndarray
    rectifier_s: ndarray
    inverter_s: ndarray
    no_load_v: ndarray
    inverter_v: ndarray
    storage: ndarray
    charge_w: ndarray
    discharge_w: ndarray
    rail_s: ndarray

    def part(self, seconds: ndarray) -> _Nodes:
        """The nodes of some of the seconds."""
        return _Nodes(*(each[..., seconds] for each in self))

    def element(self, voltage_v: ndarray) -> ndarray:
        """Voltage at each node's train or substation."""
        return np.where(self.backward, voltage_v[1], voltage_v[0])

    def current(self, feeding: Feeding, voltage_v: ndarray) -> tuple[ndarray, ndarray]:
        """Current that each element takes from the rails, and its derivative."""
        at_v = np.maximum(self.element(voltage_v), LEAST_V)
        current_a, slope_s = _train_current(feeding, self.power_w, at_v)
        below_v, above_v = self.no_load_v - at_v, at_v - self.inverter_v
        current_a += self.inverter_s * np.maximum(above_v, 0.0) - self.rectifier_s * np.maximum(below_v, 0.0)
        slope_s += self.inverter_s * (above_v > 0.0) + self.rectifier_s * (below_v >= 0.0)
        if self.storage.size:
            stored_a, stored_s = self.storage_current(at_v)
            current_a, slope_s = current_a + stored_a, slope_s + stored_s
        return current_a, slope_s

    def storage_current(self, at_v: ndarray) -> tuple[ndarray, ndarray]:
        """Current into the storages, and its derivative."""
        if not self.storage.size:
            return np.zeros_like(at_v), np.zeros_like(at_v)
        charge_s, charge_v, discharge_s, discharge_v = self.storage
        total_a, total_s = np.zeros_like(at_v), np.zeros_like(at_v)
        for sign, amps, conductance, most_w in (
            (1.0, charge_s * np.maximum(at_v - charge_v, 0.0), charge_s * (at_v > charge_v), self.charge_w),
            (
                -1.0,
                discharge_s * np.maximum(discharge_v - at_v, 0.0),
                -discharge_s * (at_v < discharge_v),
                self.discharge_w,
            ),
        ):
            most_a = most_w / at_v
            limited = amps > most_a
            total_a += sign * np.where(limited, most_a, amps)
            total_s += sign * np.where(limited, -most_a / at_v, conductance)
        return total_a, total_s

    def residual(self, voltage_v: ndarray, current_a: ndarray) -> ndarray:
        """Sum of the currents out of each node of each track."""
        along = self.rail_s * np.diff(voltage_v, axis=1)
        total = np.zeros_like(voltage_v)
        total[:, :-1] -= along
        total[:, 1:] += along
        total[0] += np.where(self.backward, 0.0, current_a)
        total[1] += np.where(self.backward, current_a, 0.0)
        # what flows into a substation on one track flows out on the other
        total[0] += np.where(self.tied, total[1], 0.0)
        total[1] = np.where(self.tied, 0.0, total[1])
        return total

    def slope_along(self, feeding: Feeding, voltage_v: ndarray, step_v: ndarray, share: ndarray) -> ndarray:
        """Derivative of the potential along a step at a share of it."""
        there_v = voltage_v + share * step_v
        current_a, _ = self.current(feeding, there_v)
        return np.sum(self.residual(there_v, current_a) * step_v, axis=(0, 1))


def _share_of_step(
    feeding: Feeding, nodes: _Nodes, voltage_v: ndarray, step_v: ndarray, descent: ndarray
) -> ndarray:
    """Share of a step that passes the minimum along it, at which the slope has halved or less."""
    low, high = np.zeros(descent.size), np.ones(descent.size)
    share = 0.5 * high
    for _ in range(BISECTIONS):
        slope = nodes.slope_along(feeding, voltage_v, step_v, share)
        if (np.abs(slope) <= -0.5 * descent).all():
            break
        low, high = np.where(slope < 0.0, share, low), np.where(slope < 0.0, high, share)
        share = np.where(np.abs(slope) <= -0.5 * descent, share, 0.5 * (low + high))
    return share


def _newton_step(nodes: _Nodes, slope_s: ndarray, residual_a: ndarray) -> tuple[ndarray, ndarray]:
    """Newton step of all nodes, and True for the seconds whose tangent is positive definite.

    Where it is not, the network holds more constant power than conductance, and the step may lead anywhere.
    """
    count, seconds = slope_s.shape
    inverse = np.empty((count, 3, seconds))
    right = -residual_a
    slope_a = np.where(nodes.backward, 0.0, slope_s)
    slope_b = slope_s - slope_a
    definite = np.ones(seconds, dtype=bool)
    before = np.zeros(seconds)
    for k in range(count):
        after = nodes.rail_s[k] if k < count - 1 else np.zeros(seconds)
        own = before + after + LEAK_S
        a, b, ab = own + slope_a[k], own + slope_b[k], 0.0
        if k:
            square = before * before
            last = inverse[k - 1]
            a = a - square * last[0]
            b = b - square * last[1]
            ab = -square * last[2]
            right[0, k] += before * (last[0] * right[0, k - 1] + last[2] * right[1, k - 1])
            right[1, k] += before * (last[2] * right[0, k - 1] + last[1] * right[1, k - 1])
        tied = nodes.tied[k]
        total, determinant = a + b + 2.0 * ab, a * b - ab * ab
        definite &= np.where(tied, total > 0.0, (determinant > 0.0) & (a > 0.0))
        # a tied node moves as one: its inverse is that of the sum, the same for both tracks
        scale = 1.0 / np.where(tied, total, determinant)
        inverse[k, 0] = np.where(tied, scale, b * scale)
        inverse[k, 1] = np.where(tied, scale, a * scale)
        inverse[k, 2] = np.where(tied, scale, -ab * scale)
        before = after
    step = np.empty_like(right)
    for k in range(count - 1, -1, -1):
        a, b = right[0, k], right[1, k]
        if k < count - 1:
            a, b = a + nodes.rail_s[k] * step[0, k + 1], b + nodes.rail_s[k] * step[1, k + 1]
        step[0, k] = inverse[k, 0] * a + inverse[k, 2] * b
        step[1, k] = inverse[k, 2] * a + inverse[k, 1] * b
    return step, definite


def _solve(feeding: Feeding, nodes: _Nodes) -> tuple[ndarray, ndarray, int]:
    """Voltages of all nodes, the seconds without them, and the most steps of a second.

    Newton's method from the no-load voltage. The voltages of least potential (co-content) are sought, so a
    tangent that is not positive definite is replaced by that of the elements that resist, and a step that
    passes the minimum along its direction is cut back.
    """
    start_v = float(max(each.no_load_v for each in feeding.substations))
    voltage_v = np.full((2, *nodes.power_w.shape), start_v)
    left = np.arange(nodes.power_w.shape[1])
    some, at_v = nodes, voltage_v
    for step_count in range(MOST_STEPS):
        current_a, slope_s = some.current(feeding, at_v)
        residual_a = some.residual(at_v, current_a)
        steepest_s = np.maximum(some.rail_s.max(axis=0, initial=0.0), np.abs(slope_s).max(axis=0))
        rounding_a = ROUNDING_V * steepest_s
        open_ = np.abs(residual_a).max(axis=(0, 1)) > BALANCED_A + rounding_a
        if not open_.all():
            voltage_v[:, :, left] = at_v
            left, some = left[open_], some.part(open_)
            at_v, slope_s, residual_a = at_v[:, :, open_], slope_s[:, open_], residual_a[:, :, open_]
        if not left.size:
            # where all that is returned is squeezed no current flows: any voltage above is as balanced
            return np.minimum(voltage_v, feeding.max_v), left, step_count
        step_v, definite = _newton_step(some, slope_s, residual_a)
        if not definite.all():
            loose = ~definite
            step_v[:, :, loose], _ = _newton_step(
                some.part(loose), np.maximum(slope_s[:, loose], 0.0), residual_a[:, :, loose]
            )
        step_v *= np.minimum(1.0, FARTHEST_V / np.abs(step_v).max(axis=(0, 1)))
        descent = np.sum(residual_a * step_v, axis=(0, 1))
        too_far = some.slope_along(feeding, at_v, step_v, np.ones(left.size)) > -0.5 * descent
        if too_far.any():
            step_v[:, :, too_far] *= _share_of_step(
                feeding, some.part(too_far), at_v[:, :, too_far], step_v[:, :, too_far], descent[too_far]
            )
        at_v = at_v + step_v
    voltage_v[:, :, left] = at_v
    return voltage_v, left, MOST_STEPS


def solve_network(
    feeding: Feeding, loads: TrainLoads, seconds: int, *, periodic: bool = False
) -> NetworkFlow:
    """Solve a network second by second.

    A train draws its power, limited by its current; below a voltage that limit falls to nil. Where it
    lacks power the flow says so (:meth:`NetworkFlow.check_served`). A braking train returns its power, above
    a voltage less and less.

    Storages have room and energy for what they do. Their power in one second alters that of no other but by
    their energy, so all seconds are solved with what that energy allows, until it does.

    Args:
        feeding: Substations, rails and limits.
        loads: Trains, every second below ``seconds``.
        seconds: Number of seconds.
        periodic: True if all repeats: storages then end with the energy they begin with. Else they begin
            half full.

    Raises:
        Infeasible: No voltages were found for a second; names the train with the lowest one.
        SolverError: Storages do not settle.
    """
    count = len(feeding.storages)
    aboard = feeding.onboard
    most = [np.full((seconds, count), np.array([each.power_w for each in feeding.storages])) for _ in "cd"]
    most_aboard = [np.full(loads.second.size, aboard.power_w if aboard else 0.0)] * 2
    journeys = [] if aboard is None else loads.journeys()
    for turn in range(MOST_ROUNDS):
        flow = _solve_all(feeding, loads, seconds, most, most_aboard)
        beside = [_keep(each, flow.storage_w[:, k], periodic) for k, each in enumerate(feeding.storages)]
        on_way = [_keep(aboard, flow.onboard_w[rows], periodic) for rows in journeys if aboard]
        if max((lost_j for *_, lost_j in (*beside, *on_way)), default=0.0) <= FULL_J:
            energy_j = [energy_j for energy_j, _ in beside]
            change_j = math.fsum(energy_j[-1] - energy_j[0] for energy_j, _ in on_way)
            held = np.stack(energy_j, axis=1) if energy_j else np.zeros((seconds + 1, 0))
            return replace(flow, storage_j=held, onboard_change_j=change_j)
        for k, (storage, (energy_j, _)) in enumerate(zip(feeding.storages, beside, strict=True)):
            for which, watts in enumerate(allowed_w(storage, energy_j[:-1])):
                most[which][:, k] = np.minimum(watts, most[which][:, k]) if turn > MOST_ROUNDS // 2 else watts
        if aboard is not None:
            found = [np.empty(loads.second.size) for _ in "cd"]
            for rows, (energy_j, _) in zip(journeys, on_way, strict=True):
                for which, watts in enumerate(allowed_w(aboard, energy_j[:-1])):
                    found[which][rows] = watts
            tight = turn > MOST_ROUNDS // 2
            most_aboard = [
                np.minimum(*each) if tight else each[0] for each in zip(found, most_aboard, strict=True)
            ]
    raise SolverError("the storages of the network do not settle")


def _keep(storage: Storage, power_w: ndarray, periodic: bool) -> tuple[ndarray, float]:
    """Energy before each second and after the last, and how far the power exceeds what there is."""
    begins_j = periodic_start_j(storage, power_w) if periodic else 0.5 * storage.capacity_j
    energy_j = stored_j(storage, power_w, begins_j)
    gain_j = np.where(power_w > 0.0, power_w * storage.efficiency, power_w / storage.efficiency)
    return energy_j, float(np.abs(np.diff(energy_j) - gain_j).max(initial=0.0))


def _solve_all(
    feeding: Feeding, loads: TrainLoads, seconds: int, most: list[ndarray], most_aboard: list[ndarray]
) -> NetworkFlow:
    """Solve all seconds with the most power of charging and discharging."""
    steps, flows = 0, []
    order = np.argsort(loads.second, kind="stable")
    for first in range(0, seconds, CHUNK):
        last = min(first + CHUNK, seconds)
        begin, end = np.searchsorted(loads.second[order], [first, last])
        rows = order[begin:end]
        part = loads.part(rows)
        power = [each[first:last] for each in most], [each[rows] for each in most_aboard]
        nodes, place = _arrange(feeding, part, first, last, power)
        voltage_v, lost, count = _solve(feeding, nodes)
        flow = _measure(feeding, nodes, voltage_v, part, place)
        if lost.size:
            among = np.flatnonzero(np.isin(part.second, first + lost))
            worst = int(among[np.argmin(flow[0][among])])
            raise _overload_error(part, worst, float(flow[0][worst]))
        flows.append(flow)
        steps = max(steps, count)
    back = np.argsort(order)
    train_v, train_w, onboard_w, *rest, storage_w = (
        np.concatenate(each) for each in zip(*flows, strict=True)
    )
    return NetworkFlow(
        loads,
        train_v[back],
        train_w[back],
        *rest,
        steps=steps,
        storage_w=storage_w,
        storage_j=np.zeros((seconds + 1, storage_w.shape[1])),
        onboard_w=onboard_w[back],
        onboard_change_j=0.0,
    )


class _Place(NamedTuple):
    """Row and column in the arrays of nodes.

    Attributes:
        train: Those of each row of the loads.
        substation: Those of each second and substation. Two of shape (T, S).
        storage: Those of each second and storage beside the track. Two of shape (T, G).
    """

    train: tuple[ndarray, ndarray]
    substation: tuple[ndarray, ndarray]
    storage: tuple[ndarray, ndarray]


def _arrange(
    feeding: Feeding,
    loads: TrainLoads,
    first: int,
    last: int,
    most: tuple[Sequence[ndarray], Sequence[ndarray]],
) -> tuple[_Nodes, _Place]:
    """Nodes of the seconds from ``first`` to before ``last``, with the most power of storages."""
    stations, storages, seconds, trains = (
        feeding.substations,
        feeding.storages,
        last - first,
        loads.second.size,
    )
    count, beside = len(stations), len(storages)
    fixed_m = [each.position_m for each in (*stations, *storages)]
    second = np.concatenate([loads.second - first, np.repeat(np.arange(seconds), count + beside)])
    position_m = np.concatenate([loads.position_m, np.tile(fixed_m, seconds)])
    order = np.lexsort((position_m, second))
    start = np.searchsorted(second[order], np.arange(seconds))
    rank = np.empty(order.size, dtype=int)
    rank[order] = np.arange(order.size) - start[second[order]]
    shape = int(rank.max()) + 1, seconds
    at_rank, at_second = (each[trains:].reshape(seconds, count + beside) for each in (rank, second))
    place = _Place(
        (rank[:trains], second[:trains]),
        (at_rank[:, :count], at_second[:, :count]),
        (at_rank[:, count:], at_second[:, count:]),
    )

    def spread(at: tuple[ndarray, ndarray], values: object, other: float | bool = 0.0) -> ndarray:
        found = np.full(shape, other)
        found[at] = values
        return found

    # a second with fewer nodes ends with idle ones beside its last node
    where_m = spread((rank, second), position_m, -np.inf)
    gap_m = np.maximum(np.diff(np.maximum.accumulate(where_m, axis=0), axis=0), NEAR_M)
    inverter_s = [0.0 if each.inverter_v is None else 1.0 / each.inverter_ohm for each in stations]
    inverter_v = [np.inf if each.inverter_v is None else each.inverter_v for each in stations]
    nodes = _Nodes(
        power_w=spread(place.train, loads.power_w),
        backward=spread(place.train, loads.backward, other=False),
        tied=spread((at_rank, at_second), values=True, other=False),
        rectifier_s=spread(place.substation, [1.0 / each.resistance_ohm for each in stations]),
        inverter_s=spread(place.substation, inverter_s),
        no_load_v=spread(place.substation, [each.no_load_v for each in stations]),
        inverter_v=spread(place.substation, inverter_v, np.inf),
        storage=_storages(feeding, place, shape),
        charge_w=_both(place, shape, most[0][0], most[1][0]),
        discharge_w=_both(place, shape, most[0][1], most[1][1]),
        rail_s=1.0 / (feeding.ohm_per_m * gap_m),
    )
    return nodes, place


def _both(place: _Place, shape: tuple[int, int], beside: ndarray, aboard: ndarray | float) -> ndarray:
    """Values at the storages beside the track and aboard the trains; 0 elsewhere."""
    found = np.zeros(shape)
    found[place.train], found[place.storage] = aboard, beside
    return found


def _storages(feeding: Feeding, place: _Place, shape: tuple[int, int]) -> ndarray:
    """Conductances and voltages of all storages."""
    if not feeding.storages and feeding.onboard is None:
        return np.zeros((0, *shape))
    rows = [
        [(s.charge_above_v, s.discharge_below_v, 1.0 / s.resistance_ohm) for s in each]
        for each in (feeding.storages, [] if feeding.onboard is None else [feeding.onboard])
    ]
    beside = np.array(rows[0]).reshape(-1, 3).T
    aboard = rows[1][0] if rows[1] else (0.0, 0.0, 0.0)
    charge_v, discharge_v, conductance = (
        _both(place, shape, fixed, own) for fixed, own in zip(beside, aboard, strict=True)
    )
    return np.stack([conductance, charge_v, conductance, discharge_v])


def _measure(
    feeding: Feeding, nodes: _Nodes, voltage_v: ndarray, loads: TrainLoads, place: _Place
) -> tuple[ndarray, ...]:
    """Values of a :class:`NetworkFlow`, in its order."""
    at_v = nodes.element(voltage_v)
    train_v, substation_v = at_v[place.train], at_v[place.substation]
    train_a, _ = _train_current(feeding, loads.power_w, train_v)
    no_load_v, inverter_v = (each[place.substation] for each in (nodes.no_load_v, nodes.inverter_v))
    rectifier_a = nodes.rectifier_s[place.substation] * np.maximum(no_load_v - substation_v, 0.0)
    inverter_a = nodes.inverter_s[place.substation] * np.maximum(substation_v - inverter_v, 0.0)
    inner_v = np.abs(no_load_v - substation_v), np.maximum(substation_v - inverter_v, 0.0)
    loss_w = rectifier_a * inner_v[0] + inverter_a * inner_v[1]
    rail_loss_w = np.sum(nodes.rail_s * np.diff(voltage_v, axis=1) ** 2, axis=(0, 1))
    inverter_w = inverter_a * np.where(inverter_a > 0.0, inverter_v, 0.0)
    stored_w = at_v * nodes.storage_current(at_v)[0]
    return (
        train_v,
        train_v * train_a,
        stored_w[place.train],
        substation_v,
        no_load_v * rectifier_a,
        inverter_w,
        loss_w,
        rail_loss_w,
        stored_w[place.storage],
    )
