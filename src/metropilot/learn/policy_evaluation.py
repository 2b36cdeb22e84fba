"""Early evaluation of a policy: it drives the real task from standstill, compiled with the learning.

The rule by which the best policy is kept: the one of whose drives more arrive safely and on time; among
equals, the one whose drives cost less, which is energy above the optimum at the running time achieved, plus
one per cent for every second off time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from metropilot._typing import Array
from metropilot.env import DrivingTask, episode_of, starts
from metropilot.planning import COUNTS_J, cached_optima
from metropilot.policy import Params, PolicySpec, act
from metropilot.sim import CODES, PUNCTUALITY_S, Episode, Outcome
from metropilot.units import J_PER_KWH

MOST_CASES = 24
"""A task with more cases is evaluated on so many of them, evenly picked."""
MOST_TIMES = 12
MOST_DRIVES = 96
PER_SECOND = 0.01
OVERSPEED_MPS = 0.01
POINTS = 65


@dataclass(frozen=True)
class Grid:
    """From where an evaluation drives.

    Attributes:
        case: Row of each drive in the task's cases. Shape (N,).
        scheduled_s: Scheduled time of each. Shape (N,).
    """

    case: np.ndarray
    scheduled_s: np.ndarray


class EvaluationRuns(NamedTuple):
    """Results of an evaluation's drives; each of shape (N,).

    Attributes:
        episode: Their KPIs.
        safe: True if it arrived in place and on time, without overspeed or intervention.
        gap: Traction energy over the optimum at the running time achieved, minus one.
        late_s: Running time minus the scheduled time.
    """

    episode: Episode
    safe: Array
    gap: Array
    late_s: Array


def grid_of(task: DrivingTask) -> Grid:
    """Every case (or so many of them) with up to twelve scheduled times over the task's range."""
    count = task.times_s.shape[1]
    cases = np.unique(np.linspace(0, count - 1, min(count, MOST_CASES)).round().astype(np.int32))
    low, high = task.times_s[:, cases].astype(np.float64)
    times = min(MOST_TIMES, MOST_DRIVES // cases.size) if np.any(high > low) else 1
    shares = np.linspace(0.0, 1.0, times) if times > 1 else np.zeros(1)
    scheduled = low[:, None] + (high - low)[:, None] * shares
    return Grid(np.repeat(cases, shares.size), scheduled.ravel())


class DrivingEvaluation:
    """Evaluates a learner's policies on a driving task; :func:`metropilot.learn.loop.make_loop` takes it.

    Args:
        task: The task.
        spec: Layout of the policies' parameters.
    """

    def __init__(self, task: DrivingTask, spec: PolicySpec) -> None:
        self.task = task
        self.spec = spec
        self.grid = grid_of(task)
        cases = np.unique(self.grid.case)
        self.row = np.searchsorted(cases, self.grid.case)
        reach = np.max(task.times_s[1, cases] / task.minimum_s[cases])
        optima = cached_optima([task.config.cases[k] for k in cases], float(reach))
        # optimal energy over running time at many points, to be read by straight lines; each (C, POINTS)
        times = np.linspace(optima.time_s[:, 0], optima.time_s[:, -1], POINTS, axis=1)
        self.curves = times, np.stack([optima.at(np.full(POINTS, k), row) for k, row in enumerate(times)])

    def __call__(self, params: Params, key: Array) -> dict[str, Array]:
        """The KPIs of a policy's drives; see :func:`score_drives`."""
        return score_drives(self.drive(params, key))

    def drive(self, params: Params, key: Array) -> EvaluationRuns:
        """Drive every start of the grid to its end."""
        task, grid = self.task, self.grid
        state, seen = jax.vmap(task.begin)(self._starts(key))
        alive = jnp.ones(grid.case.shape, bool)

        def one(carry: Any) -> Any:
            state, seen, alive, k = carry
            mask = jax.vmap(task.action_mask)(state)
            action = jax.vmap(lambda x, m: act(self.spec, params, x, m))(seen, mask)
            keys = jax.random.split(jax.random.fold_in(key, k), alive.size)
            after, found = jax.vmap(task.step)(keys, state, action)
            hold = jax.vmap(lambda on, new, old: jax.tree.map(partial(jnp.where, on), new, old))
            state = hold(alive, after, state)
            return (
                state,
                found.observation.astype(jnp.float32),
                alive & ~jnp.logical_or(found.terminated, found.truncated),
                k + 1,
            )

        first = (state, seen.astype(jnp.float32), alive, jnp.zeros((), jnp.uint32))
        state = jax.lax.while_loop(lambda carry: jnp.any(carry[2]), one, first)[0]
        episode = jax.vmap(lambda one: episode_of(task, one))(state)
        late = episode.running_time_s - episode.scheduled_s
        time_s, energy_j = (jnp.asarray(curve, jnp.float32)[self.row] for curve in self.curves)
        optimum = jax.vmap(jnp.interp)(episode.running_time_s, time_s, energy_j)
        safe = (
            (episode.outcome == CODES.index(Outcome.ARRIVED))
            & (jnp.abs(late) <= PUNCTUALITY_S)
            & (episode.interventions == 0)
            & (episode.max_overspeed_mps <= OVERSPEED_MPS)
        )
        # on a long fall the optimum is zero
        return EvaluationRuns(episode, safe, episode.wheel_j / jnp.maximum(optimum, COUNTS_J) - 1.0, late)

    def _starts(self, key: Array) -> Any:
        """From standstill, disturbed as the task disturbs."""
        grid = self.grid
        drawn = jax.vmap(self.task.draw)(jax.random.split(key, grid.case.size))
        at_rest = starts(grid.case.tolist(), grid.scheduled_s.tolist())
        names = ("case", "scheduled_s", "position_m", "speed_mps", "time_s")
        news = at_rest.scheduled_s + drawn.news_s - drawn.scheduled_s
        return drawn._replace(news_s=news, **{name: getattr(at_rest, name) for name in names})


def score_drives(drives: EvaluationRuns) -> dict[str, Array]:
    """KPIs of drives, each of shape (); ``score`` is what the rule compares, the higher the better.

    The score is the number of safe drives minus the mean cost of all, which is at most one: no saving ever
    outweighs an arrival.
    """
    safe, episode = drives.safe, drives.episode
    number = jnp.sum(safe.astype(jnp.float32))
    cost = jnp.maximum(drives.gap, 0.0) + PER_SECOND * jnp.abs(drives.late_s)
    arrived = episode.outcome == CODES.index(Outcome.ARRIVED)
    return {
        "score": number - jnp.mean(jnp.where(safe, jnp.minimum(cost, 1.0), 1.0)),
        "safe_share": number / jnp.float32(safe.shape[0]),
        "gap_percent": 100.0 * _mean(drives.gap, safe),
        "gap_worst_percent": 100.0 * _most(drives.gap, safe),
        "late_worst_s": _most(jnp.abs(drives.late_s), arrived),
        "stop_error_worst_m": _most(jnp.abs(episode.stop_error_m), arrived),
        "energy_wheel_kwh": _mean(episode.wheel_j, safe) / J_PER_KWH,
        "running_time_s": _mean(episode.running_time_s, arrived),
        "interventions": jnp.sum(episode.interventions).astype(jnp.float32),
    }


def _mean(values: Array, where: Array) -> Array:
    """Mean over some of the drives, NaN where there are none. Shape ()."""
    count = jnp.sum(where.astype(jnp.float32))
    return jnp.sum(jnp.where(where, values, 0.0)) / jnp.where(count > 0, count, jnp.nan)


def _most(values: Array, where: Array) -> Array:
    """Largest over some of the drives, NaN where there are none. Shape ()."""
    return jnp.where(jnp.any(where), jnp.max(jnp.where(where, values, -jnp.inf)), jnp.nan)
