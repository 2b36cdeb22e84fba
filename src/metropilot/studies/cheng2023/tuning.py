"""Tuning of the gains, universes and rates of Cheng23's controllers by differential evolution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy import ndarray

from metropilot._typing import Array, Float
from metropilot.control import CHENG2023_UPPER, Gains
from metropilot.errors import InputError
from metropilot.studies.cheng2023 import drives
from metropilot.studies.cheng2023.fuzzy_pid import Universes
from metropilot.studies.cheng2023.neural_pid import LearningRates
from metropilot.studies.cheng2023.residual import PlacedGains
from metropilot.studies.cheng2023.tracking import (
    ReferenceCourse,
    compile_course,
    track_compiled,
    tracking_kpis,
    tracking_score,
)

POPULATION = 40
GENERATIONS = 29
NETWORK_SEEDS = (0, 1, 2)
"""A network is tuned for the mean over these."""


@dataclass(frozen=True)
class Tunable:
    """A controller that can be tuned.

    Attributes:
        names: Its parameters, in order; the gains come first.
        low: Least of each.
        high: Largest of each.
        logarithmic: Which of them are searched by their logarithm.
        controllers: From parameters to controllers with their memory at the start; the score is their mean.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    logarithmic: tuple[bool, ...]
    controllers: Callable[[Array], list[drives.Start]]

    def values(self, unit: Float[ndarray, "..."]) -> Float[ndarray, "..."]:
        """Parameters from numbers in [0, 1]; the last axis is the parameter's."""
        low, high = np.asarray(self.low), np.asarray(self.high)
        log = np.asarray(self.logarithmic)
        straight = low + unit * (high - low)
        floor = np.where(log, low, 1.0)
        return np.where(log, floor * np.where(log, high / floor, 1.0) ** unit, straight)


@dataclass(frozen=True)
class Tuned:
    """Result of a search.

    Attributes:
        values: The best parameters by name.
        score: Their score.
        evaluations: Runs it took.
    """

    values: Mapping[str, float]
    score: float
    evaluations: int


def _fuzzy(values: Array) -> list[drives.Start]:
    return [drives.fuzzy_control(Gains(*values[:3]), Universes(*values[3:8]))]


def _neural(values: Array) -> list[drives.Start]:
    rates = LearningRates(*values[3:6])
    return [drives.neural_control(Gains(*values[:3]), rates, seed) for seed in NETWORK_SEEDS]


_UPPER = tuple(float(value) for value in CHENG2023_UPPER)
_NAMES = ("kp", "ki", "kd")
TUNABLE: Mapping[str, Tunable] = MappingProxyType(
    {
        "pid": Tunable(
            _NAMES,
            (0.0, 0.0, 0.0),
            _UPPER,
            (False,) * 3,
            lambda values: [drives.pid_control(Gains(*values[:3]))],
        ),
        drives.POSITION_PID: Tunable(
            (*_NAMES, "position_per_s"),
            (0.0, 0.0, 0.0, 0.0),
            (*_UPPER, 10.0),
            (False,) * 4,
            lambda values: [drives.position_pid_control(Gains(*values[:3]), values[3])],
        ),
        drives.FED_PID: Tunable(
            (*_NAMES, "position_per_s"),
            (0.0, 0.0, 0.0, 0.0),
            (*_UPPER, 10.0),
            (False,) * 4,
            lambda values: [drives.fed_pid_control(PlacedGains(Gains(*values[:3]), values[3]))],
        ),
        "fuzzy_pid": Tunable(
            (*_NAMES, "error_mps", "change_mps", "kp_span", "ki_span", "kd_span"),
            (0.0, 0.0, 0.0, 0.01, 0.005, 0.0, 0.0, 0.0),
            (*_UPPER, 1.0, 0.5, *_UPPER),
            (False, False, False, True, True, False, False, False),
            _fuzzy,
        ),
        "neural_pid": Tunable(
            (*_NAMES, "learning_rate", "momentum", "error_mps"),
            (0.0, 0.0, 0.0, 0.01, 0.0, 0.01),
            (*_UPPER, 20.0, 0.9, 1.0),
            (False, False, False, True, False, True),
            _neural,
        ),
    }
)
"""Controllers that can be tuned, within the upper limits of the gains in the paper."""


def tune_driver(driver: str, course: ReferenceCourse, seed: int = 0, generations: int = GENERATIONS) -> Tuned:
    """Search a driver's parameters on a course.

    Args:
        driver: One of ``TUNABLE``.
        course: Reference, track and plant.
        seed: Seed of the search.
        generations: After the first; each drives 40 candidates.

    Raises:
        InputError: The driver has nothing to tune.
    """
    import jax
    import jax.numpy as jnp
    from scipy.optimize import differential_evolution

    if driver not in TUNABLE:
        raise InputError("cannot be tuned", field="driver", value=driver, allowed=", ".join(TUNABLE))
    tunable, single = TUNABLE[driver], compile_course(course)

    def score(values: Array) -> Array:
        found = []
        for control, memory in tunable.controllers(values):
            start = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), memory)
            found.append(tracking_score(tracking_kpis(single, track_compiled(single, control, start), jnp)))
        return jnp.mean(jnp.stack(found))

    batch = jax.jit(jax.vmap(score))

    def cost(unit: ndarray) -> ndarray:
        values = jnp.asarray(tunable.values(unit.T), jnp.float32)
        return np.nan_to_num(-np.asarray(batch(values), np.float64), nan=1e9)

    size = len(tunable.names)
    first: Any = np.random.default_rng(seed).random((POPULATION, size))
    answer = differential_evolution(
        cost,
        [(0.0, 1.0)] * size,
        maxiter=generations,
        init=first,
        rng=seed,
        tol=0.0,
        polish=False,
        updating="deferred",
        vectorized=True,
    )
    best = tunable.values(np.asarray(answer.x))
    values = {name: float(value) for name, value in zip(tunable.names, best, strict=True)}
    return Tuned(values, -float(answer.fun), POPULATION * (generations + 1))
