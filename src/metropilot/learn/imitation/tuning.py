"""Learning in closed loop: many drives a step, the gradient of what they cost above the optimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray
from numpy.random import Generator

from metropilot._typing import Array, Float, Int
from metropilot.learn.config import TeacherConfig
from metropilot.learn.imitation.closed_loop import Begin, ClosedLoop
from metropilot.learn.imitation.demonstrations import Demonstrations
from metropilot.learn.imitation.train_state import TrainState, apply_gradient, imitation_loss, labels
from metropilot.policy import Params, PolicySpec, network_output

DECISIONS = (200, 400, 600)
"""Drives are put together by length, each length compiled by itself."""
SPARE_S, SPARE_SHARE = 15.0, 0.05
"""Time beyond the optimal plan's that a drive may take before it is cut off."""
LEAST_J = 60.0
"""Least energy a drive's cost is a share of, per kilogram."""
SECOND_W = (0.2, 25.0)
ON_TIME_S = 0.3
"""Below this the price of being off time is square, beyond straight."""
DISTURBED = 0.5
MASS, RESISTANCE = 0.1, 0.2
"""Half the drives are of a trainset that is heavier or lighter, and runs harder or easier, than believed."""


@dataclass(frozen=True)
class TuningRuns:
    """Starts of drives, by length.

    Attributes:
        case: Row of the section in the tables. Shape (K,).
        begins: See :class:`~metropilot.learn.imitation.demonstrations.Demonstrations`. Shape (K, 7).
        lengths: Entries of each length in ``DECISIONS``.
    """

    case: Int[ndarray, " k"]
    begins: Float[ndarray, "k 7"]
    lengths: tuple[Int[ndarray, " drives"], ...]


def drives_of(case: Int[ndarray, " k"], begins: Float[ndarray, "k 7"], period_s: float) -> TuningRuns:
    """The drives short enough to be driven whole, sorted by length; those that cost nothing teach nothing."""
    taken = (begins[:, 4] - begins[:, 2]) * (1.0 + SPARE_SHARE) + SPARE_S
    needed = np.ceil(taken / period_s)
    costs = begins[:, 5] > 1.0
    edges = (0, *DECISIONS)
    lengths = tuple(
        np.flatnonzero(costs & (needed > low) & (needed <= high)) for low, high in pairwise(edges)
    )
    return TuningRuns(case, begins, lengths)


def batch_of(drives: TuningRuns, random: Generator, decisions: int) -> tuple[int, Begin]:
    """A length, as likely as there is to drive of it, and so many drives of it as make up the decisions."""
    work = np.array([rows.size * n for rows, n in zip(drives.lengths, DECISIONS, strict=True)], float)
    k = int(random.choice(len(DECISIONS), p=work / work.sum()))
    count = max(decisions // DECISIONS[k], 16)
    rows = random.choice(drives.lengths[k], count)
    position, speed, time, scheduled, arrival, optimum, second = drives.begins[rows].T
    off = random.random(count) < DISTURBED
    begin = Begin(
        case=drives.case[rows].astype(np.int32),
        position_m=position,
        speed_mps=speed,
        time_s=time,
        scheduled_s=scheduled,
        arrival_s=arrival,
        optimum_j=optimum,
        second_w=np.clip(second, *SECOND_W),
        mass_factor=1.0 + off * random.uniform(-MASS, MASS, count),
        resistance_factor=1.0 + off * random.uniform(-RESISTANCE, RESISTANCE, count),
    )
    return DECISIONS[k], Begin(begin.case, *(np.asarray(v, np.float32) for v in begin[1:]))


def excess_cost(
    loop: ClosedLoop, spec: PolicySpec, params: Params, begin: Begin, decisions: int, late: float
) -> Array:
    """Cost of one drive above the optimum, as a share of it; lateness at its price and more.

    Args:
        loop: Closed loop over the sections.
        spec: Layout of the policy's parameters.
        params: Of the policy.
        begin: The drive.
        decisions: Largest number of decisions.
        late: Price of a second off time besides, as a share.
    """

    def decide(params: Params, observation: Array) -> Array:
        return network_output(spec, params, observation, jnp)

    joule = 1.0 / jnp.maximum(begin.optimum_j, LEAST_J)
    drive = loop.drive(decide, params, begin, decisions, joule)
    spent = joule * (drive.energy_j - begin.optimum_j + begin.second_w * drive.late_s)
    off = jnp.sqrt(drive.late_s * drive.late_s + ON_TIME_S * ON_TIME_S) - ON_TIME_S
    return jnp.where(drive.done, spent + late * off, 0.0)


Step = Callable[[TrainState, Array, Begin, Array, Array], tuple[TrainState, Array]]


class Tuning:
    """Gradient steps in closed loop.

    Args:
        config: Configuration.
        spec: Layout of the policy's parameters.
        loop: Closed loop over the sections.
        drives: Starts of drives.
        demonstrations: Demonstrations still imitated beside.
    """

    def __init__(
        self,
        config: TeacherConfig,
        spec: PolicySpec,
        loop: ClosedLoop,
        drives: TuningRuns,
        demonstrations: Demonstrations,
    ) -> None:
        self.config = config
        self.spec = spec
        self.loop = loop
        self.drives = drives
        self.observations = demonstrations.observations
        self.wanted = labels(loop.action, demonstrations.commands)
        self._steps: dict[int, Step] = {}

    def step(self, train_state: TrainState, random: Generator, rate: float) -> tuple[TrainState, float]:
        """One step; the policy after it, and what its drives cost above the optimum, as a share."""
        decisions, begin = batch_of(self.drives, random, self.config.decisions)
        rows = random.integers(0, self.wanted.size, self.config.batch_size)
        step = self._steps.setdefault(decisions, jax.jit(partial(self._step, decisions)))
        train_state, cost = step(
            train_state, jnp.float32(rate), begin, self.observations[rows], self.wanted[rows]
        )
        return train_state, float(cost)

    def _step(
        self, decisions: int, train_state: TrainState, rate: Array, begin: Begin, seen: Array, wanted: Array
    ) -> tuple[TrainState, Array]:
        config, spec = self.config, self.spec

        def loss(params: Params) -> tuple[Array, Array]:
            one = partial(excess_cost, self.loop, spec, params, decisions=decisions, late=config.late_per_s)
            cost = jnp.mean(jax.vmap(lambda b: one(begin=b))(begin))
            return cost + config.imitation_weight * imitation_loss(spec, params, seen, wanted), cost

        (_, cost), gradient = jax.value_and_grad(loss, has_aux=True)(train_state.params)
        return apply_gradient(train_state, gradient, rate, config.max_gradient_norm), cost
