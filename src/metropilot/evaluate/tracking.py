"""Tracking of a speed reference by a controller, and its KPIs in the tables of Cheng23."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot._typing import Array
from metropilot.control import CHENG2023_UPPER, Errors, Gains, incremental_pid
from metropilot.drivers import LearningRates, Universes, fresh_network, step_fuzzy_pid, step_neural_pid
from metropilot.env import (
    ReferenceCourse,
    TrackingView,
    TrackState,
    advance_tracking,
    compile_course,
    start_tracking,
    tracking_view,
)
from metropilot.errors import InputError
from metropilot.units import J_PER_KWH

Memory = Any
Namespace = Any
TrackingController = Callable[[Any, TrackingView], tuple[Any, Any]]
"""A controller: its memory and what it is given, to a command and its next memory."""
JERK_WINDOW_S = 2.0


class TrackRecord(NamedTuple):
    """Record of the tracking of a reference, one row per control period. Shape (N,) each.

    Attributes:
        time_s: Start of the period.
        reference_mps: Speed of the reference.
        speed_mps: Speed.
        position_m: Position.
        error_mps: Speed of the reference less speed.
        distance_m: Position of the reference less position.
        command: Command given.
        acceleration_mps2: Acceleration held over the period.
        traction_j: Traction work up to the end of the period.
        counted: True for periods before the end of the reference or in motion; only these count.
    """

    time_s: Array
    reference_mps: Array
    speed_mps: Array
    position_m: Array
    error_mps: Array
    distance_m: Array
    command: Array
    acceleration_mps2: Array
    traction_j: Array
    counted: Array


class TrackingKpis(NamedTuple):
    """The columns of Cheng23's tables 1, 3 and 4.

    Attributes:
        speed_total_mps: Sum of the size of the speed error over the control periods (0.2 s in the paper).
        speed_max_mps: Largest speed error.
        position_total_m: Sum of the size of the position error over the control periods.
        position_max_m: Largest position error.
        parking_m: Distance from the stop at the end.
        energy_kwh: Traction work at the wheel.
        jerk_mps3: Largest change of acceleration within 2 s, over 2 s.
        periods: Control periods counted.
        end_mps: Speed left at the end, 0 for a stand.
    """

    speed_total_mps: Array
    speed_max_mps: Array
    position_total_m: Array
    position_max_m: Array
    parking_m: Array
    energy_kwh: Array
    jerk_mps3: Array
    periods: Array
    end_mps: Array


def track_course(course: ReferenceCourse, control: TrackingController, memory: Memory) -> TrackRecord:
    """Let a controller track a course, in NumPy float64.

    Args:
        course: Reference, track and plant.
        control: The controller.
        memory: Its memory at the start.
    """
    state, rows = start_tracking(), []
    for _ in range(course.periods):
        state, memory, row = _period(course, control, state, memory)
        rows.append(row)
    return TrackRecord(*(np.asarray(column, np.float64) for column in zip(*rows, strict=True)))


def track_compiled(course: ReferenceCourse, control: TrackingController, memory: Memory) -> TrackRecord:
    """The same as one compiled scan; the course is of :func:`metropilot.env.tracking.compiled`."""
    import jax
    import jax.numpy as jnp

    start: TrackState = jax.tree.map(
        lambda x: jnp.asarray(x, jnp.int32 if np.asarray(x).dtype.kind == "i" else jnp.float32),
        start_tracking(),
    )

    def one(carry: tuple[TrackState, Any], _: None) -> tuple[tuple[TrackState, Any], TrackRecord]:
        state, held, row = _period(course, control, *carry)
        return (state, held), row

    return jax.lax.scan(one, (start, memory), None, length=course.periods)[1]


def _period(
    course: ReferenceCourse, control: TrackingController, state: TrackState, memory: Memory
) -> tuple[TrackState, Memory, TrackRecord]:
    given = tracking_view(course, state)
    command, memory = control(memory, given)
    after = advance_tracking(course, state, command, state.errors)
    row = TrackRecord(
        time_s=state.period.astype(course.dt.dtype) * course.dt,
        reference_mps=given.reference_mps,
        speed_mps=given.speed_mps,
        position_m=state.plant.position_m,
        error_mps=given.error_mps,
        distance_m=given.distance_m,
        command=command,
        acceleration_mps2=after.plant.acceleration_mps2,
        traction_j=after.plant.traction_j,
        counted=(state.period <= course.end) | (given.speed_mps > 0),
    )
    return after, memory, row


def tracking_kpis(course: ReferenceCourse, record: TrackRecord, xp: Namespace = np) -> TrackingKpis:
    """The columns of a table, in NumPy or (``xp=jax.numpy``) compiled.

    The jerk is the largest change of acceleration between two moments at most 2 s apart, divided by 2 s:
    "the maximum acceleration rate over the time span of 2s" in m/s^3 (Cheng23, text on Table 1).
    """
    counted = xp.asarray(record.counted, bool)
    error, distance = (xp.where(counted, xp.abs(x), 0.0) for x in (record.error_mps, record.distance_m))
    window = round(JERK_WINDOW_S / 0.2)
    accel = record.acceleration_mps2
    changes = [xp.max(xp.abs(accel[k:] - accel[:-k])) for k in range(1, window + 1)]
    return TrackingKpis(
        speed_total_mps=xp.sum(error),
        speed_max_mps=xp.max(error),
        position_total_m=xp.sum(distance),
        position_max_m=xp.max(distance),
        parking_m=xp.abs(course.track.length_m - record.position_m[-1]),
        energy_kwh=record.traction_j[-1] / J_PER_KWH,
        jerk_mps3=xp.max(xp.stack(changes)) / JERK_WINDOW_S,
        periods=xp.sum(counted),
        end_mps=record.speed_mps[-1],
    )


def tracking_score(kpis: TrackingKpis) -> Array:
    """One number for tuning and for keeping the best policy; higher is better, 0 is perfect.

    Total errors in speed and (by a fifth) position, the largest speed error, parking, jerk; a speed left at
    the end is penalised. The weights are our choice.
    """
    return -(
        kpis.speed_total_mps
        + kpis.position_total_m / 5.0
        + 5.0 * kpis.speed_max_mps
        + 20.0 * kpis.parking_m
        + 2.0 * kpis.jerk_mps3
        + 20.0 * kpis.end_mps
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
    controllers: Callable[[Array], list[tuple[TrackingController, Any]]]

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


def _gains(values: Array) -> Gains:
    return Gains(values[0], values[1], values[2])


def _pid(values: Array) -> list[tuple[TrackingController, Any]]:
    def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
        return incremental_pid(seen.command, _gains(values), seen.error_mps, memory)

    return [(control, Errors(0.0, 0.0))]


def _fuzzy(values: Array) -> list[tuple[TrackingController, Any]]:
    universes = Universes(*(values[k] for k in range(3, 8)))

    def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
        return step_fuzzy_pid(seen.command, seen.error_mps, memory, universes, _gains(values))

    return [(control, Errors(0.0, 0.0))]


def _neural(values: Array) -> list[tuple[TrackingController, Any]]:
    rates = LearningRates(values[3], values[4], values[5])

    def control(memory: Any, seen: Any) -> tuple[Any, Any]:  # noqa: ANN401 (arrays)
        return step_neural_pid(memory, seen, rates)

    return [(control, fresh_network(seed, _gains(values))) for seed in NETWORK_SEEDS]


_UPPER = tuple(float(value) for value in CHENG2023_UPPER)
_NAMES = ("kp", "ki", "kd")
TUNABLE: Mapping[str, Tunable] = MappingProxyType(
    {
        "pid": Tunable(_NAMES, (0.0, 0.0, 0.0), _UPPER, (False,) * 3, _pid),
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
        driver: ``pid``, ``fuzzy_pid`` or ``neural_pid``.
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
