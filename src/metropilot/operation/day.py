"""A day of a line, journey by journey: its timetable, its trains, its power minute by minute.

A journey is one train from end to end. Every period of a day has a periodic timetable of its own, from which
its journeys take departures, running times and plans. Power is summed hour by hour, as over a headway.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Int
from metropilot.operation.feeding import FeedingEnergy, train_loads
from metropilot.operation.line_service import EnergyBalance, LineOperation, Profiles, Timetable
from metropilot.operation.network import TrainLoads, solve_network
from metropilot.operation.power import PowerProfile, add_periodic
from metropilot.railway import Feeding
from metropilot.units import J_PER_KWH

HOUR_S, MINUTE_S = 3600, 60


class Journeys(NamedTuple):
    """Journeys of one direction, in the order of their first departures.

    Attributes:
        departure_s: Departure from every station but the last, from midnight. Shape (J, S).
        running_time_s: Running time to the next one, a key of its profiles. Shape (J, S).
        plan: Number of the profiles that it is driven by. Shape (J, S).
        period: Number of the period of the day. Shape (J,).
    """

    departure_s: Float[ndarray, "journeys sections"]
    running_time_s: Int[ndarray, "journeys sections"]
    plan: Int[ndarray, "journeys sections"]
    period: Int[ndarray, " journeys"]

    @property
    def arrival_s(self) -> Float[ndarray, "journeys sections"]:
        """Arrival at every station but the first."""
        return self.departure_s + self.running_time_s

    @property
    def stop_times_s(self) -> Float[ndarray, "journeys times"]:
        """Departures and arrivals in their order, for a train graph. Shape (J, 2 S); J may be zero."""
        both = np.stack([self.departure_s, self.arrival_s], axis=2)
        return both.reshape(len(both), both.shape[1] * 2)


class DayTimetable(NamedTuple):
    """Timetable of a day.

    Attributes:
        forward: Journeys in the direction of rising positions.
        backward: Journeys in the other one.
    """

    forward: Journeys
    backward: Journeys

    @property
    def journeys(self) -> int:
        """Number of journeys."""
        return sum(each.period.size for each in self)

    @property
    def span_s(self) -> tuple[float, float]:
        """First departure and last arrival."""
        first = min(float(each.departure_s.min()) for each in self if each.period.size)
        return first, max(float(each.arrival_s.max()) for each in self if each.period.size)

    def with_plans(self, count: int, random: np.random.Generator) -> DayTimetable:
        """The same with every trip driven by one of so many profiles, drawn at random."""
        return DayTimetable(
            *(each._replace(plan=random.integers(count, size=each.plan.shape)) for each in self)
        )

    def scatter(self, seconds: float, random: np.random.Generator) -> DayTimetable:
        """The same with every departure moved by up to so many seconds either way; dwells take it up.

        A train that arrives too late for its departure leaves at once.
        """
        moved = []
        for each in self:
            departure_s = each.departure_s + random.uniform(-seconds, seconds, each.departure_s.shape)
            moved.append(each._replace(departure_s=_leave_after(departure_s, each.running_time_s)))
        return DayTimetable(*moved)


def _leave_after(departure_s: ndarray, running_s: ndarray) -> ndarray:
    """Departures, none of them before the arrival."""
    departure_s = departure_s.copy()
    for k in range(1, departure_s.shape[1]):
        departure_s[:, k] = np.maximum(departure_s[:, k], departure_s[:, k - 1] + running_s[:, k - 1])
    return departure_s


class PeriodicPart(NamedTuple):
    """A period of a day with its periodic timetable.

    Attributes:
        from_s: Time of its first departures.
        to_s: Its end.
        headway_s: Its headway.
        timetable: Timetable of one train each way.
        plan: Number of the profiles of each of its trips. Shape (M,).
    """

    from_s: int
    to_s: int
    headway_s: int
    timetable: Timetable
    plan: Int[ndarray, " trips"]


def repeat_timetables(
    parts: Sequence[PeriodicPart], least_s: Callable[[int, int, int], int] = lambda *_: 0
) -> DayTimetable:
    """Timetable of a day whose periods repeat their own.

    A headway after the last departure of a period comes the next one, in whatever period that is, and later
    where protection asks for more. Forward trains so begin each period; backward ones keep the offset to
    them, and at its beginning no less than the shorter headway to the train before.

    Args:
        parts: Periods in their order.
        least_s: Least time from the last departure of a period to the first of a later one by their numbers
            and the direction, 0 forward and 1 backward.
    """
    count = parts[0].plan.size // 2
    starts: tuple[list[tuple[int, int]], list[tuple[int, int]]] = ([], [])
    for index, part in enumerate(parts):
        before = parts[index - 1] if index and parts[index - 1].to_s == part.from_s else None
        offset_s = round(float(part.timetable.departure_s[count] - part.timetable.departure_s[0]))
        usual_s = (0, 0) if before is None else (before.headway_s, min(before.headway_s, part.headway_s))
        first_s = [
            max(
                [
                    part.from_s,
                    *(last_s + max(usual_s[way], least_s(of, index, way)) for last_s, of in own[-1:]),
                ]
            )
            for way, own in enumerate(starts)
        ]
        leads_s = [first_s[0], part.from_s + (first_s[0] + offset_s - part.from_s) % part.headway_s]
        # a whole number of headways later, so that the offset stays
        leads_s[1] += -min(0, (leads_s[1] - first_s[1]) // part.headway_s) * part.headway_s
        for own, lead_s in zip(starts, leads_s, strict=True):
            own += [(start_s, index) for start_s in range(lead_s, part.to_s, part.headway_s)]
    journeys = []
    for backward, own in enumerate(starts):
        of = slice(count * backward, count * (backward + 1))
        period = np.array([index for _, index in own], dtype=int)
        relative_s = np.array(
            [p.timetable.departure_s[of] - p.timetable.departure_s[of.start] for p in parts]
        )
        start_s = np.array([start for start, _ in own], dtype=float)
        journeys.append(
            Journeys(
                start_s[:, None] + relative_s[period],
                np.array([p.timetable.running_time_s[of] for p in parts])[period],
                np.array([p.plan[of] for p in parts])[period],
                period,
            )
        )
    return DayTimetable(*journeys)


class TrainLinks(NamedTuple):
    """Trains of a day: who drives which journey.

    Attributes:
        train: Train of every journey forward and backward, numbered from 0.
        fleet: Trains that it takes.
        pull_outs: Departures of a train that comes from the depot.
        pull_ins: Arrivals after which a train goes there.
    """

    train: tuple[Int[ndarray, " forward"], Int[ndarray, " backward"]]
    fleet: int
    pull_outs: int
    pull_ins: int


def link_trains(timetable: DayTimetable, turnround_s: int, longest_wait_s: int) -> TrainLinks:
    """Link journeys to trains: whoever arrived first takes the next departure after the turn-round.

    A train that would wait too long goes to the depot, which is reached from both terminal stations; one
    that is missing comes from there. Empty runs count neither as time nor as energy.

    Args:
        timetable: Timetable of the day.
        turnround_s: Least time between arrival and departure.
        longest_wait_s: Longest wait after it.
    """
    departures = sorted(
        (float(start_s), way, j)
        for way, each in enumerate(timetable)
        for j, start_s in enumerate(each.departure_s[:, 0])
    )
    ready: tuple[list[tuple[float, int]], list[tuple[float, int]]] = ([], [])
    train = tuple(np.zeros(each.period.size, dtype=int) for each in timetable)
    depot: list[tuple[float, int]] = []
    fleet = pull_outs = 0
    for start_s, way, j in departures:
        for waiting in ready:
            while waiting and start_s - waiting[0][0] > longest_wait_s:
                depot.append(waiting.pop(0))
        waiting = ready[way]
        if waiting and waiting[0][0] <= start_s:
            number = waiting.pop(0)[1]
        else:
            pull_outs += 1
            at = next((k for k, (from_s, _) in enumerate(depot) if from_s <= start_s), None)
            number = fleet if at is None else depot.pop(at)[1]
            fleet += at is None
        train[way][j] = number
        arrives_s = float(timetable[way].arrival_s[j, -1])
        ready[1 - way].append((arrives_s + turnround_s, number))
        ready[1 - way].sort()
    # whoever comes from the depot goes back to it, at the latest in the evening
    return TrainLinks((train[0], train[1]), fleet, pull_outs, pull_outs)


@dataclass(frozen=True, eq=False)
class DayPower:
    """Power of a line over a day, by minutes.

    Attributes:
        first_s: Beginning of the first minute, a full hour.
        supplied_w: Mean power from the substations of each zone. Shape (minutes, zones).
        unused_w: Mean power that nobody receives, after the transfer loss. Shape (minutes, zones).
    """

    first_s: int
    supplied_w: Float[ndarray, "minutes zones"]
    unused_w: Float[ndarray, "minutes zones"]

    @property
    def hourly_kwh(self) -> Float[ndarray, " hours"]:
        """Energy from the substations, hour by hour."""
        return self.supplied_w.sum(axis=1).reshape(-1, HOUR_S // MINUTE_S).sum(axis=1) * MINUTE_S / J_PER_KWH


class LineDay:
    """A line over a day.

    Args:
        operation: Line in operation; its headway and dwell are without effect.
        timetable: Timetable of the day. A train that arrives after its departure leaves at once.
        plans: Powers of the trips, those that the timetable names by number.

    Attributes:
        operation: Line in operation.
        timetable: Timetable, with departures as they are driven.
        plans: Powers of the trips.
    """

    def __init__(self, operation: LineOperation, timetable: DayTimetable, plans: Sequence[Profiles]) -> None:
        self.operation, self.plans = operation, plans
        driven, ends_s = [], [0.0]
        for way, each in enumerate(timetable):
            lasts_s = np.empty_like(each.departure_s)
            for rows, k, profile in self._groups(each, way):
                lasts_s[rows, k] = profile.running_time_s
            # a plan is nanoseconds off its running time
            late = lasts_s > each.running_time_s + 1e-3
            running_s = np.where(late, lasts_s, each.running_time_s)
            driven.append(each._replace(departure_s=_leave_after(each.departure_s, running_s)))
            ends_s += (driven[-1].departure_s[:, -1] + running_s[:, -1]).tolist()
        self.timetable, self._end_s = DayTimetable(*driven), max(ends_s)

    def _groups(self, journeys: Journeys, way: int) -> Iterator[tuple[ndarray, int, PowerProfile]]:
        """Journeys that share the profile of a section: their rows, the section, the profile."""
        if not journeys.period.size:
            return
        most = int(journeys.plan.max()) + 1
        for k in range(self.operation.count):
            codes = journeys.running_time_s[:, k] * most + journeys.plan[:, k]
            for code in np.unique(codes):
                running_s, plan = divmod(int(code), most)
                profile = self.plans[plan][self.operation.count * way + k][running_s]
                yield np.flatnonzero(codes == code), k, profile

    def power(self) -> DayPower:
        """Power of every zone, minute by minute; energies are exact up to rounding."""
        first_s = self.timetable.span_s[0]
        begin_s = HOUR_S * int(first_s // HOUR_S)
        hours = int(np.ceil((self._end_s - begin_s) / HOUR_S))
        parts = [self._hour(begin_s + HOUR_S * hour) for hour in range(hours)]
        supplied_w, unused_w = (np.concatenate(each) for each in zip(*parts, strict=True))
        return DayPower(begin_s, supplied_w, unused_w)

    def _hour(self, begin_s: int) -> tuple[ndarray, ndarray]:
        """Mean powers supplied and unused in the minutes of an hour, in each zone."""
        end_s, aboard_w = begin_s + HOUR_S, self.operation.trainset.auxiliary_w
        zones = self.operation.options.zones
        # pieces of no power put a knot at the beginning of every minute
        edges = np.arange(0.0, HOUR_S, MINUTE_S)
        pieces = [
            [(edges, np.full(edges.size, float(MINUTE_S)), np.zeros((edges.size, 2)))] for _ in range(zones)
        ]
        for way, whole in enumerate(self.timetable):
            # a running time of a late train is longer than the timetable's
            about = (whole.departure_s[:, 0] < end_s) & (whole.arrival_s[:, -1] > begin_s - HOUR_S)
            each = Journeys(*(part[about] for part in whole))
            for rows, k, profile in self._groups(each, way):
                leaves_s = each.departure_s[rows, k]
                arrives_s = leaves_s + profile.running_time_s
                last = k == self.operation.count - 1
                gone_s = arrives_s if last else each.departure_s[rows, k + 1]
                here = (leaves_s < end_s) & (gone_s > begin_s)
                if not here.any():
                    continue
                zone = pieces[self.operation.trips[self.operation.count * way + k].zone]
                net_w = profile.net_w(self.operation.options.transfer_loss) + aboard_w
                start_s = (leaves_s[here, None] + profile.time_s[:-1]).ravel()
                lasts_s = np.tile(np.diff(profile.time_s), int(here.sum()))
                zone.append(_cut(start_s, lasts_s, np.tile(net_w, (int(here.sum()), 1)), begin_s, end_s))
                standing_s = np.maximum(gone_s - arrives_s, 0.0)[here]
                level_w = np.full((standing_s.size, 2), aboard_w)
                zone.append(_cut(arrives_s[here], standing_s, level_w, begin_s, end_s))
        sums = []
        for zone in pieces:
            start_s, lasts_s, power_w = (np.concatenate(each) for each in zip(*zone, strict=True))
            sums.append(add_periodic(start_s, lasts_s, power_w, float(HOUR_S)))
        found = np.stack([total.split(HOUR_S // MINUTE_S) for total in sums]) / MINUTE_S
        return found[:, 0].T, found[:, 1].T

    def energy(self, power: DayPower | None = None) -> EnergyBalance:
        """Energy of the day.

        Args:
            power: Its power, where it is there already.
        """
        power = power or self.power()
        drawn_j = returned_j = aboard_s = 0.0
        for way, each in enumerate(self.timetable):
            for rows, k, profile in self._groups(each, way):
                drawn_j += rows.size * profile.drawn_j
                returned_j += rows.size * profile.returned_j
                if k == self.operation.count - 1:
                    arrives_s = each.departure_s[rows, k] + profile.running_time_s
                    aboard_s += float(np.sum(arrives_s - each.departure_s[rows, 0]))
        return EnergyBalance.from_sums(
            supplied_j=float(power.supplied_w.sum()) * MINUTE_S,
            unused_j=float(power.unused_w.sum()) * MINUTE_S,
            drawn_j=drawn_j + self.operation.trainset.auxiliary_w * aboard_s,
            returned_j=returned_j,
            through=1.0 - self.operation.options.transfer_loss,
        )

    def loads(self, links: TrainLinks | None = None) -> tuple[TrainLoads, int]:
        """Places and powers of all trains second by second, and the number of seconds.

        Seconds count from the first departure. Departures count as whole seconds.

        Args:
            links: Trains, each with one storage aboard for all its journeys; None: one for each journey.
        """
        rows: list[TrainLoads] = []
        first_s = int(np.floor(self.timetable.span_s[0]))
        for way, each in enumerate(self.timetable):
            whole_s = np.ceil(each.departure_s - 1e-6).astype(int)
            patterns, index = np.unique(
                np.hstack([whole_s - whole_s[:, :1], each.running_time_s, each.plan]),
                axis=0,
                return_inverse=True,
            )
            for number, pattern in enumerate(patterns):
                journeys = np.flatnonzero(index.ravel() == number)
                part = self._pattern_loads(way, pattern, whole_s[journeys, 0] - first_s)
                train = journeys[part.train]
                aboard = 2 * train + way if links is None else links.train[way][train]
                rows.append(part._replace(train=train, journey=aboard))
        loads = TrainLoads(*(np.concatenate(each) for each in zip(*rows, strict=True)))
        if links is not None:
            # a storage aboard goes through the journeys of its train one after the other
            loads = loads.part(np.argsort(loads.second, kind="stable"))
        return loads, int(loads.second.max()) + 1

    def _pattern_loads(self, way: int, pattern: ndarray, starts_s: ndarray) -> TrainLoads:
        """Loads of the journeys of a direction that are alike but for their start."""
        count = self.operation.count
        departure_s, running_s, plan = (
            np.zeros(2 * count),
            np.zeros(2 * count, dtype=int),
            np.zeros(2 * count, dtype=int),
        )
        of = slice(count * way, count * (way + 1))
        departure_s[of], running_s[of], plan[of] = pattern.reshape(3, count)
        profiles: list[dict[int, PowerProfile]] = []
        for k in range(2 * count):
            known = self.plans[int(plan[k])][k]
            # no train of the other direction starts, but its trips have profiles too
            running_s[k] = running_s[k] or next(iter(known))
            profiles.append({int(running_s[k]): known[int(running_s[k])]})
        starts = [int(start_s) for start_s in starts_s]
        timetable = Timetable(departure_s, running_s)
        loads, _ = train_loads(self.operation, timetable, profiles, ([], starts) if way else (starts, []))
        return loads._replace(second=loads.second + min(starts))


def _cut(
    start_s: ndarray, lasts_s: ndarray, power_w: ndarray, begin_s: int, end_s: int
) -> tuple[ndarray, ndarray, ndarray]:
    """Pieces of power within an hour: start from its beginning, duration, power at both ends."""
    low, high = np.maximum(start_s, begin_s), np.minimum(start_s + lasts_s, end_s)
    kept = high > low
    start_s, lasts_s, power_w, low, high = (each[kept] for each in (start_s, lasts_s, power_w, low, high))
    share = np.stack([low - start_s, high - start_s], axis=1) / lasts_s[:, None]
    return low - begin_s, high - low, power_w[:, :1] + share * (power_w[:, 1:] - power_w[:, :1])


def feed_day(day: LineDay, feeding: Feeding, links: TrainLinks) -> FeedingEnergy:
    """Feed all trains of a day by a DC network, the same day after day: storages end as they begin.

    Args:
        day: Day of a line.
        feeding: Network.
        links: Its trains, which keep their storage from journey to journey.

    Raises:
        InputError: A substation off the line.
        Infeasible: The network cannot carry the load.
    """
    feeding.check_line(day.operation.line)
    flow = solve_network(feeding, *day.loads(links), periodic=True)
    flow.check_served()
    return FeedingEnergy(feeding, flow)
