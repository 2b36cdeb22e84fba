"""Plans under an efficiency map: prices follow the plan until neither moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from metropilot.planning.cone_program import Answer, Programme, solve
from metropilot.planning.prices import cost_per_metre, prices_at

PASSES = 12
SETTLED = 2e-5
CLOSE = 1e-3
Forces = tuple[ndarray, ndarray]


def follow_map(base: Programme, energy: ndarray) -> tuple[Answer, int]:
    """Solve with the prices at the last iterate, keep the best answer, halve the step after a worse one.

    Where part load is dear, no convex cost can say so. The bound then comes from the convex hull, and further
    passes at the average price of the last forces look for a plan that avoids part load.

    Args:
        base: The programme, at any prices.
        energy: Kinetic energy per kg to begin with.

    Returns:
        The cheapest answer by the plant's own map, its ``dual`` the bound, and the number of passes.
    """
    best, lowest, count = _passes(base, energy, None, averaged=False)
    bound = best.dual
    if lowest > bound * (1 + CLOSE):
        forces = best.traction, best.recovered
        other, cost, more = _passes(base, best.energy, forces, averaged=True)
        count += more
        best = other if cost < lowest else best
    return replace(best, dual=bound), count


def _passes(
    base: Programme, energy: ndarray, forces: Forces | None, *, averaged: bool
) -> tuple[Answer, float, int]:
    best: Answer | None = None
    lowest, last, count = np.inf, np.inf, 0
    for _ in range(PASSES):
        count += 1
        prices = prices_at(base.loads, "line", energy, forces, averaged=averaged)
        answer = solve(replace(base, prices=prices), energy)
        cost = _cost(base, answer)
        worse = cost > lowest
        if not worse:
            best, lowest = answer, cost
        share = 0.5 if worse else 1.0
        energy = energy + share * (answer.energy - energy)
        after = answer.traction, answer.recovered
        if forces is not None:
            after = tuple(old + share * (new - old) for old, new in zip(forces, after, strict=True))
        forces = after[0], after[1]
        if abs(cost - last) <= SETTLED * abs(cost):
            break
        last = cost
    assert best is not None
    return best, lowest, count


def _cost(base: Programme, answer: Answer) -> float:
    """Cost of an answer by the plants' own maps, J/kg."""
    loads = base.loads
    middle = 0.5 * (answer.energy[1:] + answer.energy[:-1])[loads.segment]
    cost = base.prices.second_w * float(answer.time.sum()) + (base.late_w or 0.0) * answer.late
    for kind, (vehicle, table) in enumerate(zip(loads.vehicles, loads.tables, strict=True)):
        own = loads.of_kind(kind)
        forces = answer.traction[own], answer.recovered[own]
        work = cost_per_metre(vehicle, table, "line", middle[own], *forces)
        cost += float(np.sum(loads.weight[own] * work * base.mesh.length_m[loads.segment[own]]))
    return cost
