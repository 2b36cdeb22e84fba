"""Search for a periodic timetable of little energy: dwells, running times, the offset of the directions.

Everything is in whole seconds, no train disturbs the next one, and dwells and running times of a direction
keep their sums, so that no passenger's journey from end to end gets longer and the floor holds. A trip may be
driven by one of several plans: where nobody receives what it returns, that of least energy drawn is the
better one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Int
from metropilot.operation.adapted_plans import adapt_plans
from metropilot.operation.headway import LongestDwells
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.path import SectionCost, find_least_path

CELLS_PER_S = 2
"""Cells of a second over which power is averaged while searching; the result is computed exactly."""
MOVES, RESTARTS, ADAPTED = 12_000, 8, 4
"""Moves from each start, starts, and how many of the timetables found are tried with adapted plans."""
WARMTH = 0.002, 1e-5
"""First and last temperature of the annealing, shares of the energy."""
SAME = 1e-9
"""Energies that differ by less than this share are one."""
COOL = 0.2
"""Share of the first temperature where the start is a good one already."""
SHIFTS, DWELLS, TIMES = 0.08, 0.45, 0.8
"""Up to these shares a move shifts the backward direction, exchanges dwell or running time; else a plan."""
NEAR_S, FAR = 5, 0.2
"""Most seconds of a shift, and the share of shifts by any part of the headway."""


@dataclass
class SearchState:
    """Running times, dwells (none after a direction's last trip), plans, offset of the backward direction."""

    running: Int[ndarray, " trips"]
    dwell: Int[ndarray, " trips"]
    plan: Int[ndarray, " trips"]
    offset: int

    def shift(self, by_s: int, headway_s: int) -> SearchState:
        """The same with the backward direction moved on."""
        return replace(self, offset=(self.offset + by_s) % headway_s)

    def departures(self, count: int) -> Int[ndarray, " trips"]:
        """Departure of each trip."""
        steps = self.running + self.dwell
        start = np.concatenate([[0], np.cumsum(steps)[:-1]])
        start[count:] += self.offset - start[count]
        return start


class _Score:
    """Energy of a line from cell means of power: a trip that departs later is its power moved on."""

    def __init__(self, operation: LineOperation, plans: Sequence[Profiles]) -> None:
        self.operation, self.plans = operation, plans
        self.cells = CELLS_PER_S * operation.options.headway_s
        self.zones = [trip.zone for trip in operation.trips]
        self._power: dict[tuple[int, int, int, int], ndarray] = {}

    def __call__(self, state: SearchState) -> float:
        n = self.cells
        total = np.zeros((self.operation.options.zones, n))
        starts = (CELLS_PER_S * state.departures(self.operation.count) % n).tolist()
        each = zip(state.running.tolist(), state.dwell.tolist(), state.plan.tolist(), strict=True)
        for k, how in enumerate(each):
            total[self.zones[k]] += self.power(k, *how)[n - starts[k] : 2 * n - starts[k]]
        return float(np.maximum(total, 0.0).sum()) / CELLS_PER_S

    def power(self, k: int, running: int, dwell: int, plan: int) -> Float[ndarray, " cells"]:
        """Mean power in the cells of two headways of a trip that departs with the first, and its dwell."""
        twice = self._power.get((k, running, dwell, plan))
        if twice is None:
            twice = np.tile(self._means(k, running, dwell, plan), 2)
            self._power[k, running, dwell, plan] = twice
        return twice

    def _means(self, k: int, running: int, dwell: int, plan: int) -> Float[ndarray, " cells"]:
        options, profile = self.operation.options, self.plans[plan][k][running]
        edges = np.arange(CELLS_PER_S * (running + dwell) + 1) / CELLS_PER_S
        energy = profile.net_until_j(options.transfer_loss, edges)
        means = CELLS_PER_S * np.diff(energy) + self.operation.trainset.auxiliary_w
        rounds = math.ceil(means.size / self.cells)
        return np.pad(means, (0, rounds * self.cells - means.size)).reshape(rounds, self.cells).sum(axis=0)


def best_offset(operation: LineOperation, profiles: Profiles) -> Timetable:
    """The plain timetable with the offset between the directions, in whole seconds, of least energy."""
    found, least_j = operation.plain_timetable(), math.inf
    for offset, means_j in _rank_offsets(_Score(operation, [profiles])):
        # none takes less than by cell means, which hide what is returned for a part of a cell alone
        if means_j >= (1.0 - SAME) * least_j:
            break
        timetable = operation.plain_timetable(float(offset))
        energy_j = operation.energy(timetable, profiles).supplied_j
        if energy_j < (1.0 - SAME) * least_j:
            found, least_j = timetable, energy_j
    return found


def _rank_offsets(score: _Score) -> list[tuple[int, float]]:
    """Offsets of the plain timetable with their energies by cell means, the least first.

    Of those that differ by rounding alone, as where all is received, the first offset comes first: on every
    machine the same.
    """
    plain, offsets = _plain(score.operation), range(score.operation.options.headway_s)
    means_j = np.array([score(replace(plain, offset=offset)) for offset in offsets])
    order = np.lexsort((offsets, np.round(means_j / (SAME * means_j.max()))))
    return [(k, float(means_j[k])) for k in order.tolist()]


def choose_plans(
    operation: LineOperation,
    timetable: Timetable,
    plans: Sequence[Profiles],
    longest: LongestDwells | None = None,
) -> tuple[Profiles, float]:
    """Choose for each trip of a timetable the plan with which the line takes least, one trip after the other.

    Args:
        operation: Line in operation.
        timetable: Timetable.
        plans: Profiles to choose from, those to begin with first.
        longest: Longest dwells with each of them, as far as they are there.

    Returns:
        The profiles chosen, and the energy.
    """
    longest = longest or LongestDwells(operation, plans)
    dwell, chosen = operation.dwells_s(timetable), list(plans[0])
    zones_j = [each.positive_j for each in operation.zone_power(timetable, chosen)]
    before_j = math.inf
    while sum(zones_j) < before_j:
        before_j = sum(zones_j)
        for k, (plan, other) in product(range(len(chosen)), enumerate(plans)):
            if other[k] is chosen[k] or (
                plan and dwell[k] > longest(k, int(timetable.running_time_s[k]), plan)
            ):
                continue
            tried, zone = [*chosen[:k], other[k], *chosen[k + 1 :]], operation.trips[k].zone
            # the plan of a trip acts on its own zone alone
            energies_j = [*zones_j]
            energies_j[zone] = operation.power_in(zone, timetable, tried).positive_j
            if sum(energies_j) < sum(zones_j):
                chosen, zones_j = tried, energies_j
    return chosen, sum(zones_j)


def find_timetable(
    operation: LineOperation,
    plans: Sequence[Profiles],
    *,
    seed: int = 0,
    moves: int = MOVES,
    restarts: int = RESTARTS,
    adapted: bool = False,
) -> tuple[Timetable, Profiles]:
    """Search for the timetable of least energy, and the plan of each trip, by annealing.

    A move takes seconds from one dwell, or one running time, and gives them to another of the same direction,
    shifts the whole backward direction, or drives a trip by another plan. The first start is the plain
    timetable with the offset that is best by cell means. Where each section has a zone of its own, energy
    adds up over sections and the second start is the shortest path at planned running times.

    Args:
        operation: Line in operation, whose windows bound dwells and running times.
        plans: Profiles to choose from: power of every trip at its planned running time or at those of its
            window.
        seed: Seed of the moves.
        moves: Moves tried from each start.
        restarts: Starts.
        adapted: Adapt the plans of the best timetables found to the other trains of each zone, see
            :func:`adapt_plans`.
    """
    random = np.random.default_rng(seed)
    score, plain = _Score(operation, plans), best_offset(operation, plans[0])
    longest = LongestDwells(operation, plans)
    starts = [replace(_plain(operation), offset=_rank_offsets(score)[0][0])]
    warmths = [WARMTH[0]] * restarts
    if operation.options.zones == operation.count and restarts > 1:
        shortest = _find_shortest(score)
        if keeps_headway(shortest, longest):
            starts.append(shortest)
            warmths[1] *= COOL
    while len(starts) < restarts:
        starts.append(replace(_plain(operation), offset=int(random.integers(operation.options.headway_s))))
    timetables = [plain]
    for start, warmth in zip(starts, warmths, strict=False):
        found = _anneal(score, longest, start, random, (moves, warmth))
        timetables.append(timetable_of(operation, found))
    tried = [(each, choose_plans(operation, each, plans, longest)[0]) for each in timetables]
    tried.sort(key=lambda each: operation.energy(*each).supplied_j)
    if adapted:
        tried = [(each, adapt_plans(operation, each, profiles)) for each, profiles in tried[:ADAPTED]]
    return min(tried, key=lambda each: operation.energy(*each).supplied_j)


def _plain(operation: LineOperation) -> SearchState:
    dwell = np.full(len(operation.trips), operation.options.dwell_s)
    dwell[[operation.count - 1, -1]] = 0
    return SearchState(operation.planned_s, dwell, np.zeros_like(dwell), 0)


def timetable_of(operation: LineOperation, state: SearchState) -> Timetable:
    """The timetable of a state."""
    return Timetable(state.departures(operation.count).astype(float), state.running.copy())


def _find_shortest(score: _Score) -> SearchState:
    """Offset, dwells and plans of least energy at planned running times, if each section has its own zone."""
    operation, state = score.operation, _plain(score.operation)
    count, headway_s = operation.count, operation.options.headway_s
    shift = np.arange(headway_s)
    running, dwell = state.running.tolist(), state.dwell.tolist()
    costs, best = [], []
    for k, other in ((k, len(running) - 1 - k) for k in range(count)):
        pairs, energies = list(product(range(len(score.plans)), repeat=2)), []
        for plan, other_plan in pairs:
            there = score.power(k, running[k], dwell[k], plan)[: score.cells]
            back = score.power(other, running[other], dwell[other], other_plan)
            # the backward train departs so much later
            rows = score.cells - CELLS_PER_S * shift[:, None] + np.arange(score.cells)
            energies.append(np.maximum(there + back[rows], 0.0).sum(axis=1) / CELLS_PER_S)
        by_departure = np.stack(energies)
        by_arrival = np.roll(by_departure, running[other], axis=1)
        both_s = running[k] + running[other]
        costs.append(SectionCost(by_arrival.min(axis=0)[:, None], both_s, both_s))
        best.append([pairs[i] for i in by_arrival.argmin(axis=0)])
    options = operation.options
    path = find_least_path(costs, 2 * options.dwell_s, 2 * options.dwell_window_s)
    # each direction gets half of a change, and the odd seconds in turn, so that its own sum is none too
    odd = path.dwell_change_s % 2
    there = (path.dwell_change_s + odd * (-1) ** np.cumsum(odd)) // 2
    state.dwell[: count - 1] += there
    state.dwell[count : 2 * count - 1] += (path.dwell_change_s - there)[::-1]
    for k, arrives_s in enumerate(path.arrives_s):
        state.plan[[k, -1 - k]] = best[k][arrives_s]
    # the first section is the last one of the backward direction
    departs_s = int(path.arrives_s[0]) - running[-1] - int(np.sum((state.running + state.dwell)[count:-1]))
    state.offset = departs_s % headway_s
    return state


def keeps_headway(state: SearchState, longest: LongestDwells) -> bool:
    """True if no train disturbs the next one."""
    each = zip(state.running.tolist(), state.dwell.tolist(), state.plan.tolist(), strict=True)
    return all(dwell <= longest(k, running, plan) for k, (running, dwell, plan) in enumerate(each))


def _anneal(
    score: _Score,
    longest: LongestDwells,
    state: SearchState,
    random: np.random.Generator,
    schedule: tuple[int, float],
) -> SearchState:
    """Anneal from a start with so many moves, from so warm on."""
    moves, warmth = schedule
    energy = score(state)
    best, best_energy = state, energy
    warmths = energy * np.geomspace(warmth, WARMTH[1], moves)
    for k in range(moves):
        tried = draw_move(score.operation, score.plans, state, random)
        if tried is None or not keeps_headway(tried, longest):
            continue
        cost = score(tried)
        if cost <= energy or random.random() < math.exp((energy - cost) / warmths[k]):
            state, energy = tried, cost
            if energy < best_energy:
                best, best_energy = state, energy
    return best


def draw_move(
    operation: LineOperation, plans: Sequence[Profiles], state: SearchState, random: np.random.Generator
) -> SearchState | None:
    """A neighbour of a timetable; None if the move drawn leaves a window."""
    count, options = operation.count, operation.options
    kind = random.random()
    if kind < SHIFTS or count < 2:
        far = options.headway_s if random.random() < FAR else NEAR_S
        return replace(state, offset=int(state.offset + random.integers(-far, far + 1)) % options.headway_s)
    first = count * int(random.integers(2))
    if kind < DWELLS and count > 2:
        a, b = first + random.choice(count - 1, 2, replace=False)
        dwell = state.dwell.copy()
        seconds = int(random.integers(1, options.dwell_window_s + 2))
        dwell[[a, b]] += seconds, -seconds
        inside = abs(dwell[[a, b]] - options.dwell_s).max() <= options.dwell_window_s
        return replace(state, dwell=dwell) if inside else None
    if kind > TIMES and len(plans) > 1:
        plan = state.plan.copy()
        plan[random.integers(plan.size)] = random.integers(len(plans))
        return replace(state, plan=plan)
    a, b = first + random.choice(count, 2, replace=False)
    running = state.running.copy()
    seconds = int(random.integers(1, NEAR_S))
    running[[a, b]] += seconds, -seconds
    inside = all(int(running[k]) in plans[0][k] for k in (a, b))
    return replace(state, running=running) if inside else None
