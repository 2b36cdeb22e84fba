"""Energy that no timetable undercuts where trains meet too seldom for all that is returned to be received.

A train receives what another one returns only while both are in the same zone. The headway, the windows of
dwells and running times and the offset of the directions say when that is. Two trains of opposite directions
meet in every section of the line, and the times between their departures and arrivals there follow from one
section to the next: the least sum over the line is a shortest path.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray
from scipy.optimize import minimize_scalar

from metropilot._typing import Float
from metropilot.errors import InputError
from metropilot.operation.exchange_floor import SectionFloor, SectionTrips
from metropilot.operation.line_service import LineOperation
from metropilot.operation.path import LeastPath, SectionCost, find_least_path
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import ExchangeTrip, ReceivedEnergy, Receiver, TripBound, is_mapped

GRID_S = 5.0
"""Times of receivers are rounded up to this, which grants them more and asks for fewer plans."""
LAST_S, FIRST_SHARE = 30.0, 0.5
"""Who receives in so many of the last seconds is granted the whole trip, and any the first share of it."""
SAME_J = 2e4
"""Energies nearer than this are one."""
TANGENTS = (-2 / 3, 0.0, 2 / 3)
"""Where in the window of a running time the least energy is found; it is convex in that time,
so elsewhere never below the tangents."""
PROGRAMMES, PRICED, FIRST_PRICE, NEAR_PRICE = 4000, 15, (0.3, 2.0), (0.7, 1.4)
"""Programmes of two trips that are solved for a sharp floor, at most; every so many paths the best price of a
second is sought anew, between these shares of the last one, or of what a second saves on average."""


class TripFloors:
    """Least net energy of each trip by who receives what it returns, found when asked for.

    It depends on neither headway nor zones: one of them does for a line at all headways.

    Args:
        operation: Line in operation.
    """

    def __init__(self, operation: LineOperation) -> None:
        self._own_w = operation.trainset.auxiliary_w
        self._trips: dict[tuple[int, int], _TripFloor] = {}
        self._operation = operation
        self._exchanging: dict[tuple[int, range], ExchangeTrip] = {}

    def exchange_trip(self, trip: int, changes_s: range) -> ExchangeTrip:
        """A trip as one that exchanges energy with another, its running time within a window."""
        key = trip, changes_s
        if key not in self._exchanging:
            silent, asked = self._operation.silent, self._operation.trips[trip]
            track = track_arrays(asked.section, silent)
            self._exchanging[key] = ExchangeTrip(
                vehicle_arrays(silent), track, float(asked.planned_s), changes_s
            )
        return self._exchanging[key]

    def least_energies(
        self, trip: int, cases: Sequence[frozenset[Receiver]], change_s: int = 0
    ) -> list[TripBound]:
        """Least net energy of a trip with each set of receivers, its running time changed."""
        key = trip, change_s
        if key not in self._trips:
            silent, asked = self._operation.silent, self._operation.trips[trip]
            energy = ReceivedEnergy(
                vehicle_arrays(silent), track_arrays(asked.section, silent), float(asked.planned_s + change_s)
            )
            self._trips[key] = _TripFloor(energy, {}, {})
        energy, found, planned = self._trips[key]
        extremes = frozenset({Receiver(math.inf, math.inf, math.inf)}), frozenset[Receiver]()
        ordered = sorted(set(cases), key=_granted_s)
        # halving the order lets most cases fall between two equal ones
        halving = sorted(range(len(ordered)), key=lambda k: f"{k:032b}"[::-1])
        for case in (*extremes, *(ordered[k] for k in halving)):
            if case not in found:
                between = _between(planned, case)
                if between is None:
                    between = planned[case] = energy.bound(self._own_w, case)
                found[case] = between
        return [found[case] for case in cases]


class _TripFloor(NamedTuple):
    """Least energies of a trip in a running time: its programme, by receivers, and those that were solved."""

    energy: ReceivedEnergy
    found: dict[frozenset[Receiver], TripBound]
    planned: dict[frozenset[Receiver], TripBound]


def _between(planned: dict[frozenset[Receiver], TripBound], case: frozenset[Receiver]) -> TripBound | None:
    """The energy with more receivers, if it is that with fewer ones."""
    order = sorted(planned.items(), key=lambda each: -each[1].bound_j)
    more = next((each for other, each in order if _grants(other, case)), None)
    if more is None:
        return None
    near = (other for other, each in order if each.bound_j < more.bound_j + SAME_J)
    return more if any(_grants(case, other) for other in near) else None


def _granted_s(case: frozenset[Receiver]) -> float:
    """Seconds granted, of receivers that take everything above all."""
    weighted = ((each, 1.0 if math.isinf(each.power_w) else 0.1) for each in case)
    return math.fsum(weight * min(time_s, 1e3) for each, weight in weighted for time_s in each[:2])


def _grants(more: frozenset[Receiver], less: frozenset[Receiver]) -> bool:
    """True if receivers take at least what others take, at all times."""

    def inside(one: Receiver, other: Receiver) -> bool:
        return all(a <= b for a, b in zip(one, other, strict=True))

    wide = [each for each in more if math.isinf(each.power_w)]
    left = [each for each in less if not any(inside(each, other) for other in wide)]
    # those of limited power add up: each needs one of its own
    free = list(more - set(wide))
    for each in left:
        match = next((other for other in free if inside(each, other)), None)
        if match is None:
            return False
        free.remove(match)
    return True


class _Stay(NamedTuple):
    """Time in a zone of the train of a trip: before the trip, after it (least and most), and then at rest."""

    before_s: int
    after_s: tuple[int, int]
    rest_s: int


class _Tangents(NamedTuple):
    """Least net energies of the two trips of a section in a running time, and their slopes.

    Attributes:
        changes_s: Change of each running time.
        bound_j: Forward and backward, by the second after the departure of the forward train at which the
            backward one arrives, and by the sum of both running times. Shape (2, H, C).
        second_w: What one more second saves. Shape (2, H, C).
    """

    changes_s: tuple[int, int]
    bound_j: Float[ndarray, "2 headway sums"]
    second_w: Float[ndarray, "2 headway sums"]

    def energy_j(self, which: int, columns: slice, change_s: int | ndarray) -> Float[ndarray, "headway sums"]:
        """Least energy of one of them in other running times."""
        sloped_j = self.second_w[which][:, columns] * (change_s - self.changes_s[which])
        return self.bound_j[which][:, columns] - sloped_j


class _Meeting(NamedTuple):
    """Least net energies of the two trips of a section, by the times at which they meet.

    Attributes:
        tangents: At several running times.
        changes_s: Changes of the running times allowed, of each.
        planned_s: Planned sum of both.
    """

    tangents: tuple[_Tangents, ...]
    changes_s: tuple[range, range]
    planned_s: int

    def energies_j(self) -> Iterator[Float[ndarray, "headway other"]]:
        """Least energy of both trips by the change of the backward one, for each of the forward one."""
        others = np.array(self.changes_s[1])
        for first, change_s in enumerate(self.changes_s[0]):
            columns = slice(first, first + others.size)
            forward_j, backward_j = (
                np.max([each.energy_j(which, columns, change) for each in self.tangents], axis=0)
                for which, change in enumerate((change_s, others))
            )
            yield forward_j + backward_j

    def cost(self) -> SectionCost:
        """Least energy of both trips however the sum of their running times is divided."""
        return SectionCost.divide(self.energies_j(), self.changes_s, self.planned_s)


class _Windows:
    """Running times and dwells that a timetable may have."""

    def __init__(self, operation: LineOperation, *, windows: bool) -> None:
        self.operation = operation
        self.dwell_s = operation.options.dwell_window_s if windows else 0
        self.running_s = [trip.allowed_s if windows else (trip.planned_s,) for trip in operation.trips]

    def stay(self, trip: int) -> _Stay:
        """Time of a train in the zone of one of its trips."""
        trips, planned_s = self.operation.trips, self.operation.options.dwell_s
        here = trips[trip]
        same = [k for k, k_th in enumerate(trips) if (k_th.backward, k_th.zone) == (here.backward, here.zone)]
        low_s, high_s = planned_s - self.dwell_s, planned_s + self.dwell_s
        later = [k for k in same if k > trip]
        terminal = same[-1] in {self.operation.count - 1, len(trips) - 1}
        return _Stay(
            sum(self.running_s[k][-1] + high_s for k in same if k < trip),
            (
                sum(self.running_s[k][0] + low_s for k in later),
                sum(self.running_s[k][-1] + high_s for k in later),
            ),
            0 if terminal else high_s,
        )

    @property
    def moves(self) -> bool:
        """True if a running time may change."""
        return any(len(each) > 1 for each in self.running_s)

    def changes_s(self, trip: int) -> range:
        """Changes of a running time."""
        planned_s = self.operation.trips[trip].planned_s
        return range(self.running_s[trip][0] - planned_s, self.running_s[trip][-1] - planned_s + 1)

    def find_path(self, costs: Sequence[SectionCost]) -> LeastPath:
        """Path of least energy with the dwells that a timetable may have."""
        return find_least_path(costs, 2 * self.operation.options.dwell_s, 2 * self.dwell_s)


def check_sharp(operation: LineOperation) -> None:
    """Refuse a sharp floor of zones with several sections.

    Raises:
        InputError: A zone has several sections.
    """
    if operation.options.zones != operation.count:
        raise InputError(
            "a floor is sharpened where each section is a zone",
            field="zones",
            value=operation.options.zones,
            allowed=f"{operation.count}",
        )


def zone_floor_j(
    operation: LineOperation,
    floors: TripFloors | None = None,
    *,
    windows: bool = False,
    sharp: bool = False,
    programmes: int = PROGRAMMES,
) -> float:
    """Energy that no timetable undercuts, however the trains are driven: only trains that meet can receive.

    Args:
        operation: Line in operation.
        floors: Least energies of its trips, as far as they are there.
        windows: Dwells and running times, whole seconds, may change within their windows, at the same sums in
            each direction.
        sharp: Ask what trains can exchange at the moments at which they meet, where each section is a zone:
            minutes of processor time.
        programmes: Programmes of two trips that are solved for a sharp floor, at most.

    Returns:
        Energy in one headway; minus infinity, for not known, where an efficiency depends on speed or effort.

    Raises:
        InputError: A sharp floor of zones with several sections.
    """
    if is_mapped(vehicle_arrays(operation.silent)):
        return -math.inf
    floors = floors or TripFloors(operation)
    allowed = _Windows(operation, windows=windows)
    aboard_j = operation.trainset.auxiliary_w * sum(operation.journey_s(backward=b) for b in (False, True))
    if sharp:
        check_sharp(operation)
    meetings = [_meeting(allowed, floors, k) for k in range(operation.count)]
    if sharp:
        return aboard_j + _sharp_floor_j(allowed, floors, meetings, programmes)
    costs = [each.cost() for each in meetings]
    price_w = _best_price(allowed, costs) if allowed.moves else 0.0
    return aboard_j + allowed.find_path([each.add_price(price_w) for each in costs]).energy_j


def _sharp_floor_j(
    allowed: _Windows, floors: TripFloors, meetings: Sequence[_Meeting], programmes: int
) -> float:
    """Least energy of the trips: the cells of the least path are bounded more finely, again and again."""
    sections = [_exchange(allowed, floors, k, each) for k, each in enumerate(meetings)]
    price_w, floor_j = 0.0, -math.inf
    for turn in range(programmes):
        costs = [each.cost() for each in sections]
        if allowed.moves and turn % PRICED == 0:
            price_w = _best_price(allowed, costs, price_w)
        path = allowed.find_path([each.add_price(price_w) for each in costs])
        floor_j = max(floor_j, path.energy_j)
        asked = zip(sections, path.arrives_s.tolist(), path.running_change_s.tolist(), strict=True)
        refined = [each.refine(arrives_s, change_s) for each, arrives_s, change_s in asked]
        if not any(refined) or sum(each.solved for each in sections) >= programmes:
            break
    return floor_j


def _best_price(allowed: _Windows, costs: Sequence[SectionCost], last_w: float = 0.0) -> float:
    """Price of a second with which the least path is dearest, near the last one if there is one."""
    shares = NEAR_PRICE if last_w else FIRST_PRICE
    if not last_w:
        dearest_j = [each.energy_j.max(axis=0) for each in costs if each.energy_j.shape[1] > 1]
        last_w = float(np.median([-np.diff(each).mean() for each in dearest_j]))
    low, high = (share * last_w for share in shares)
    found = minimize_scalar(
        lambda price_w: -allowed.find_path([each.add_price(price_w) for each in costs]).energy_j,
        bounds=(low, high),
        method="bounded",
        options={"maxiter": 12},
    )
    return float(found.x)


def _exchange(allowed: _Windows, floors: TripFloors, section: int, meeting: _Meeting) -> SectionFloor:
    """Least energies of a section that is a zone: its trips exchange energy."""
    operation = allowed.operation
    pair = section, len(operation.trips) - 1 - section
    changes_s = allowed.changes_s(pair[0]), allowed.changes_s(pair[1])

    return SectionFloor(
        SectionTrips(
            (floors.exchange_trip(pair[0], changes_s[0]), floors.exchange_trip(pair[1], changes_s[1])),
            (operation.trips[pair[0]].planned_s, operation.trips[pair[1]].planned_s),
            changes_s,
            (allowed.stay(pair[0]).rest_s, allowed.stay(pair[1]).rest_s),
            operation.trainset.auxiliary_w,
            operation.options.headway_s,
        ),
        np.stack(list(meeting.energies_j()), axis=1),
    )


def _meeting(allowed: _Windows, floors: TripFloors, section: int) -> _Meeting:
    operation = allowed.operation
    pair = section, len(operation.trips) - 1 - section
    sums_s = np.arange(*(sum(allowed.running_s[k][end] for k in pair) + (end == -1) for end in (0, -1)))
    # a whole second stands for all instants up to the next one
    behind_s = np.arange(operation.options.headway_s)[:, None] + np.zeros_like(sums_s)
    ahead_s = sums_s - behind_s
    changes_s = allowed.changes_s(pair[0]), allowed.changes_s(pair[1])
    tangents = []
    for of in sorted({tuple(_change_at(every, share) for every in changes_s) for share in TANGENTS}):
        found = [
            _energies(allowed, floors, pair, behind_s, ahead_s, of[0]),
            _energies(allowed, floors, (pair[1], pair[0]), ahead_s - 1, behind_s + 1, of[1]),
        ]
        bound_j, second_w = (np.stack(parts) for parts in zip(*found, strict=True))
        tangents.append(_Tangents((of[0], of[1]), bound_j, second_w))
    return _Meeting(tuple(tangents), changes_s, sum(operation.trips[k].planned_s for k in pair))


def _change_at(changes_s: range, share: float) -> int:
    """Change at a share of the window, on the side of its sign."""
    return round(abs(share) * changes_s[0 if share < 0.0 else -1])


def _energies(
    allowed: _Windows,
    floors: TripFloors,
    pair: tuple[int, int],
    arrives_s: ndarray,
    leads_s: ndarray,
    change_s: int,
) -> tuple[ndarray, ndarray]:
    """Least energy of a trip in one running time, and its slope.

    Args:
        allowed: Running times and dwells.
        floors: Least energies of the trips.
        pair: The trip, and the one of the other direction in its section.
        arrives_s: Arrival of the other after the departure, at most a second later than this.
        leads_s: Arrival after the departure of the other, at most this.
        change_s: Change of the running time of the trip.
    """
    options, (trip, other) = allowed.operation.options, pair
    headway_s, most_s = options.headway_s, allowed.running_s[trip][-1]
    own, met, own_w = allowed.stay(trip), allowed.stay(other), allowed.operation.trainset.auxiliary_w
    longest_s = most_s + allowed.running_s[other][-1]
    longest_s += sum(each.before_s + each.after_s[1] + each.rest_s for each in (own, met))
    cycles = math.ceil(longest_s / headway_s) + 1
    pieces: list[tuple[ndarray | float, ndarray | float, float]] = []
    for shift_s in (headway_s * cycle for cycle in range(-cycles, cycles + 1)):
        gone_s = arrives_s + 1 + shift_s + met.after_s[1]
        pieces.append((gone_s, leads_s - shift_s + met.before_s, math.inf))
        if met.rest_s:
            pieces.append((gone_s + met.rest_s, most_s - arrives_s - shift_s - met.after_s[0], own_w))
    for shift_s in (headway_s * cycle for cycle in range(1, cycles + 1)):
        gone_s = most_s + own.after_s[1] - shift_s
        pieces += [(gone_s, math.inf, math.inf), (math.inf, most_s + own.before_s - shift_s, math.inf)]
        if own.rest_s:
            pieces.append((gone_s + own.rest_s, shift_s - own.after_s[0], own_w))
    rounded = [
        (*_round_up(np.asarray(first), np.asarray(last), most_s), power) for first, last, power in pieces
    ]
    shape = arrives_s.shape
    codes = np.stack([np.broadcast_to(part, shape).ravel() for each in rounded for part in each[:2]], axis=1)
    rows, index = np.unique(codes, axis=0, return_inverse=True)
    powers = [power for *_, power in rounded]
    cases = [_receivers(zip(row[::2], row[1::2], powers, strict=True)) for row in rows.tolist()]
    found = np.array(floors.least_energies(trip, cases, change_s))[index.ravel()]
    return found[:, 0].reshape(shape), found[:, 1].reshape(shape)


def _round_up(first_s: ndarray, last_s: ndarray, most_s: int) -> tuple[ndarray, ndarray]:
    """Times of a receiver that grant it at least as much; none at all if it is there at no time."""
    there = (first_s > 0) & (last_s > 0)
    first_s = GRID_S * np.ceil(np.maximum(first_s, FIRST_SHARE * most_s) / GRID_S)
    last_s = GRID_S * np.ceil(last_s / GRID_S)
    first_s = np.where(first_s >= most_s, math.inf, first_s)
    last_s = np.where(last_s >= LAST_S, math.inf, last_s)
    return np.where(there, first_s, 0.0), np.where(there, last_s, 0.0)


def _receivers(pieces: Iterable[tuple[float, float, float]]) -> frozenset[Receiver]:
    """Receivers that are there at some time, without those who are only where others take everything."""
    there = [Receiver(*each) for each in pieces if each[0] > 0]
    wide = {each for each in there if math.isinf(each.power_w)}
    power_w: dict[tuple[float, float], float] = {}
    for each in there:
        times = each.first_s, each.last_s
        if not any(other.first_s >= times[0] and other.last_s >= times[1] for other in wide):
            power_w[times] = power_w.get(times, 0.0) + each.power_w
    return frozenset(wide | {Receiver(*times, total_w) for times, total_w in power_w.items()})
