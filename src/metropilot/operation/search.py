"""Search for a periodic timetable of little energy: dwells, running times and the offset of the directions.

Everything is in whole seconds, and dwells and running times of a direction keep their sums, so that no
passenger's journey from end to end gets longer and the floor holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Int
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.power import PowerProfile

CELLS_PER_S = 2
"""Cells of a second over which power is averaged while searching; the result is computed exactly."""
MOVES, RESTARTS = 12_000, 3
WARMTH = 0.002, 1e-5
"""First and last temperature of the annealing, shares of the energy."""
SHIFTS, DWELLS = 0.1, 0.55
"""Up to these shares a move shifts the backward direction, or exchanges dwell; else running time."""
NEAR_S, FAR = 5, 0.2
"""Most seconds of a shift, and the share of shifts by any part of the headway."""


@dataclass
class _State:
    """Running times, dwells (none after a direction's last trip) and offset of the backward direction."""

    running: Int[ndarray, " trips"]
    dwell: Int[ndarray, " trips"]
    offset: int

    def departures(self, count: int) -> Int[ndarray, " trips"]:
        """Departure of each trip."""
        steps = self.running + self.dwell
        start = np.concatenate([[0], np.cumsum(steps)[:-1]])
        start[count:] += self.offset - start[count]
        return start


class _Score:
    """Energy of a line from cell means of power: a trip that departs later is its power moved on."""

    def __init__(self, operation: LineOperation, profiles: Profiles) -> None:
        self.operation, self.profiles = operation, profiles
        self.cells = CELLS_PER_S * operation.options.headway_s
        self.zones = [trip.zone for trip in operation.trips]
        self._power: dict[tuple[int, int, int], ndarray] = {}

    def __call__(self, state: _State) -> float:
        n = self.cells
        total = np.zeros((self.operation.options.zones, n))
        starts = (CELLS_PER_S * state.departures(self.operation.count) % n).tolist()
        for k, (running, dwell) in enumerate(zip(state.running.tolist(), state.dwell.tolist(), strict=True)):
            twice = self._power.get((k, running, dwell))
            if twice is None:
                twice = self._power[k, running, dwell] = np.tile(self._means(k, running, dwell), 2)
            total[self.zones[k]] += twice[n - starts[k] : 2 * n - starts[k]]
        return float(np.maximum(total, 0.0).sum()) / CELLS_PER_S

    def _means(self, k: int, running: int, dwell: int) -> Float[ndarray, " cells"]:
        options, profile = self.operation.options, self.profiles[k][running]
        edges = np.arange(CELLS_PER_S * (running + dwell) + 1) / CELLS_PER_S
        energy = _energy_until(profile, options.transfer_loss, edges)
        means = CELLS_PER_S * np.diff(energy) + self.operation.trainset.auxiliary_w
        rounds = math.ceil(means.size / self.cells)
        return np.pad(means, (0, rounds * self.cells - means.size)).reshape(rounds, self.cells).sum(axis=0)


def _energy_until(
    profile: PowerProfile, loss: float, at: Float[ndarray, " edges"]
) -> Float[ndarray, " edges"]:
    """Net energy of a trip from its departure."""
    net, lasts = profile.net_w(loss), np.diff(profile.time_s)
    before = np.concatenate([[0.0], np.cumsum(lasts * net.mean(axis=1))])
    at = np.minimum(at, profile.time_s[-1])
    j = np.clip(np.searchsorted(profile.time_s, at, side="right") - 1, 0, lasts.size - 1)
    since = at - profile.time_s[j]
    slope = np.divide(net[:, 1] - net[:, 0], lasts, out=np.zeros_like(lasts), where=lasts > 0)
    return before[j] + since * (net[j, 0] + 0.5 * since * slope[j])


def best_offset(operation: LineOperation, profiles: Profiles) -> Timetable:
    """The plain timetable with the offset between the directions, in whole seconds, of least energy."""
    score, plain = _Score(operation, profiles), _plain(operation)
    energies = [score(replace(plain, offset=offset)) for offset in range(operation.options.headway_s)]
    return operation.plain_timetable(float(np.argmin(energies)))


def find_timetable(
    operation: LineOperation,
    profiles: Profiles,
    *,
    seed: int = 0,
    moves: int = MOVES,
    restarts: int = RESTARTS,
) -> Timetable:
    """Search for the timetable of least energy by annealing.

    A move takes seconds from one dwell, or one running time, and gives them to another of the same direction,
    or it shifts the whole backward direction. The first start is the best offset of the plain timetable.

    Args:
        operation: Line in operation, whose windows bound dwells and running times.
        profiles: Power of every trip at its planned running time or at those of its window.
        seed: Seed of the moves.
        moves: Moves tried from each start.
        restarts: Starts.
    """
    random = np.random.default_rng(seed)
    score, plain = _Score(operation, profiles), best_offset(operation, profiles)
    headway_s, best, best_j = operation.options.headway_s, plain, math.inf
    for k in range(restarts):
        offset = plain.departure_s[operation.count] if k == 0 else random.integers(headway_s)
        found = _anneal(score, replace(_plain(operation), offset=int(offset)), random, moves)
        for timetable in (plain, _timetable(operation, found)) if k == 0 else (_timetable(operation, found),):
            energy_j = operation.energy(timetable, profiles).supplied_j
            if energy_j < best_j:
                best, best_j = timetable, energy_j
    return best


def _plain(operation: LineOperation) -> _State:
    dwell = np.full(len(operation.trips), operation.options.dwell_s)
    dwell[[operation.count - 1, -1]] = 0
    return _State(operation.planned_s, dwell, 0)


def _timetable(operation: LineOperation, state: _State) -> Timetable:
    return Timetable(state.departures(operation.count).astype(float), state.running.copy())


def _anneal(score: _Score, state: _State, random: np.random.Generator, moves: int) -> _State:
    energy = score(state)
    best, best_energy = state, energy
    warmth = energy * np.geomspace(*WARMTH, moves)
    for k in range(moves):
        tried = _move(score, state, random)
        if tried is None:
            continue
        cost = score(tried)
        if cost <= energy or random.random() < math.exp((energy - cost) / warmth[k]):
            state, energy = tried, cost
            if energy < best_energy:
                best, best_energy = state, energy
    return best


def _move(score: _Score, state: _State, random: np.random.Generator) -> _State | None:
    """A neighbour of a timetable; None if the move drawn leaves a window."""
    count, options = score.operation.count, score.operation.options
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
    a, b = first + random.choice(count, 2, replace=False)
    running = state.running.copy()
    seconds = int(random.integers(1, NEAR_S))
    running[[a, b]] += seconds, -seconds
    inside = int(running[a]) in score.profiles[a] and int(running[b]) in score.profiles[b]
    return replace(state, running=running) if inside else None
