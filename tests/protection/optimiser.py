"""Optimisers that look for the worst case in many places at once: CMA-ES, and random search beside it.

An attack is a vector of numbers, each anywhere on the real line; :func:`share` folds it into 0 to 1 and gives
both ends, where most worst cases are, room of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from cmaes import CMA

ROOM = 0.25
"""What is beyond each end of a quantity's range still means the end."""
WIDTH = 0.35
"""First step of CMA-ES, of a range of 1."""


class Worst(NamedTuple):
    """Best of a search in each place (P), after each generation (G).

    Attributes:
        value: The worst value. Shape (P,).
        attack: The vector it came from. Shape (P, D).
        history: Worst value of each generation. Shape (G, P).
        evaluations: Attacks flown in all.
    """

    value: np.ndarray
    attack: np.ndarray
    history: np.ndarray
    evaluations: int


def share(number: Any) -> Any:
    """A number on the line as a share from 0 to 1: folded back at 0 and 1, the ends widened."""
    folded = abs((number % 2.0) - 1.0)
    return ((1.0 + 2.0 * ROOM) * (1.0 - folded) - ROOM).clip(0.0, 1.0)


def hunt(
    fly: Callable[[np.ndarray], Any], start: np.ndarray, population: int, generations: int, seed: int
) -> Worst:
    """CMA-ES in every place by itself, all their attacks flown as one batch.

    Source: N. Hansen, The CMA evolution strategy: a tutorial, arXiv:1604.00772; the library ``cmaes``.

    Args:
        fly: Value of each attack, to be made as large as can be: (P, population, D) to (P, population).
        start: Where each search begins. Shape (P, D).
        population: Attacks of a generation in each place.
        generations: How many.
        seed: Of everything random.
    """
    searches = [
        CMA(mean=mean, sigma=WIDTH, seed=seed + 7919 * k, population_size=population)
        for k, mean in enumerate(start)
    ]

    def ask() -> np.ndarray:
        return np.array([[search.ask() for _ in range(population)] for search in searches])

    def tell(attacks: np.ndarray, values: np.ndarray) -> None:
        for search, vectors, found in zip(searches, attacks, values, strict=True):
            search.tell([(vector, -float(value)) for vector, value in zip(vectors, found, strict=True)])

    return _repeat(fly, ask, tell, generations)


def scatter(
    fly: Callable[[np.ndarray], Any], places: int, size: int, population: int, generations: int, seed: int
) -> Worst:
    """Random search with as many attacks: every number even over its range."""
    random = np.random.default_rng(seed)
    return _repeat(
        fly, lambda: random.uniform(0.0, 2.0, (places, population, size)), lambda *_: None, generations
    )


def _repeat(
    fly: Callable[[np.ndarray], Any],
    ask: Callable[[], np.ndarray],
    tell: Callable[[np.ndarray, np.ndarray], None],
    generations: int,
) -> Worst:
    history, best, attack, flown = [], None, None, 0
    for _ in range(generations):
        attacks = ask()
        values = np.asarray(fly(attacks))
        tell(attacks, values)
        flown += values.size
        here = values.argmax(axis=1)
        value = np.take_along_axis(values, here[:, None], axis=1)[:, 0]
        vector = np.take_along_axis(attacks, here[:, None, None], axis=1)[:, 0]
        history.append(value)
        better = value > best if best is not None else np.ones(value.size, bool)
        best = np.where(better, value, value if best is None else best)
        attack = np.where(better[:, None], vector, vector if attack is None else attack)
    assert best is not None
    assert attack is not None
    return Worst(best, attack, np.array(history), flown)
