"""Search for the timetable that takes least from a DC network, from one that is good for zones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.operation.feeding import train_loads
from metropilot.operation.headway import LongestDwells
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.network import TrainLoads, solve_network
from metropilot.operation.search import SearchState, draw_move, keeps_headway, timetable_of
from metropilot.railway import Feeding

SEARCH_ROUNDS, SEARCH_NEIGHBOURS = 60, 10
"""Rounds of the search, and timetables solved together in each."""
OFFSETS = 24
"""Offsets of the directions that are tried first."""


def refine_timetable(
    operation: LineOperation,
    timetable: Timetable,
    profiles: Profiles,
    plans: Sequence[Profiles],
    feeding: Feeding,
    *,
    seed: int = 0,
    rounds: int = SEARCH_ROUNDS,
) -> tuple[Timetable, Profiles]:
    """Search around a timetable for one that takes less from a network.

    Each round draws neighbours by the moves of :func:`find_timetable`, solves the network for all of them,
    and goes on from the best if it is better; the first one shifts the backward direction. What a network
    does not carry is not taken.

    Args:
        operation: Line in operation.
        timetable: Timetable to begin with.
        profiles: Its trips, each one of the plans.
        plans: Profiles to choose from.
        feeding: Network.
        seed: Seed of the moves.
        rounds: Rounds.
    """
    random, longest = np.random.default_rng(seed), LongestDwells(operation, plans)
    chosen = [[of[k] is each for of in plans].index(True) for k, each in enumerate(profiles)]
    state = SearchState(
        timetable.running_time_s.copy(),
        np.round(operation.dwells_s(timetable)).astype(int),
        np.array(chosen),
        round(float(timetable.departure_s[operation.count])),
    )
    shifts = np.linspace(0, operation.options.headway_s, OFFSETS, endpoint=False).astype(int)
    tried = [state.shift(int(shift), operation.options.headway_s) for shift in shifts]
    energy_j = np.inf
    for turn in range(rounds):
        found_j = _energies_j(operation, [_of(operation, each, plans) for each in tried], feeding)
        if found_j.min() < energy_j:
            state, energy_j = tried[int(np.argmin(found_j))], float(found_j.min())
        if turn < rounds - 1:
            moves = (draw_move(operation, plans, state, random) for _ in range(20 * SEARCH_NEIGHBOURS))
            kept = (each for each in moves if each is not None and keeps_headway(each, longest))
            tried = [each for each, _ in zip(kept, range(SEARCH_NEIGHBOURS), strict=False)]
            if not tried:
                break
    return _of(operation, state, plans)


def _of(
    operation: LineOperation, state: SearchState, plans: Sequence[Profiles]
) -> tuple[Timetable, Profiles]:
    return timetable_of(operation, state), [plans[int(p)][k] for k, p in enumerate(state.plan)]


def _energies_j(
    operation: LineOperation, tried: Sequence[tuple[Timetable, Profiles]], feeding: Feeding
) -> Float[ndarray, " timetables"]:
    """Energy that each timetable takes; infinite where the network does not carry it."""
    if feeding.storages or feeding.onboard is not None:
        # each has storages of its own, which end as they begin
        return np.concatenate([_together_j(operation, [each], feeding) for each in tried])
    return _together_j(operation, tried, feeding)


def _together_j(
    operation: LineOperation, tried: Sequence[tuple[Timetable, Profiles]], feeding: Feeding
) -> Float[ndarray, " timetables"]:
    """All seconds of all timetables solved as one run of seconds."""
    headway_s, parts = operation.options.headway_s, list[TrainLoads]()
    for k, (timetable, profiles) in enumerate(tried):
        loads, seconds = train_loads(operation, timetable, profiles)
        parts.append(loads._replace(second=loads.second + k * seconds))
    loads = TrainLoads(*(np.concatenate(each) for each in zip(*parts, strict=True)))
    flow = solve_network(feeding, loads, len(tried) * headway_s, periodic=True)
    net_w = (flow.rectifier_w - flow.inverter_w).sum(axis=1)
    energy_j = net_w.reshape(len(tried), headway_s).sum(axis=1)
    unserved = np.unique(loads.second[~flow.is_served] // headway_s)
    energy_j[unserved] = np.inf
    return energy_j
