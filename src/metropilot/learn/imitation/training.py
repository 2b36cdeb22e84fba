"""Training of the generalist: collect demonstrations, imitate, drive in closed loop; resumable at any part.

The same session, progress and result as of the other learners (:mod:`metropilot.learn.train`). Every part
of the training draws from its own random numbers, and a checkpoint holds the policy with its optimiser: a run
that was stopped ends with the same bits as one that was not.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from metropilot import env
from metropilot._typing import Array
from metropilot.errors import InputError
from metropilot.learn.compile_cache import keep_compiled
from metropilot.learn.config import TeacherConfig
from metropilot.learn.imitation.closed_loop import ClosedLoop, Tuning, drives_of
from metropilot.learn.imitation.demonstrations import (
    FEATURE_NAMES,
    SPACING_M,
    DemonstrationGenerator,
    Demonstrations,
    DemonstrationSet,
    collect_missing,
    load_demonstrations,
)
from metropilot.learn.imitation.train_state import (
    TrainState,
    apply_gradient,
    hide_features,
    imitation_loss,
    imitation_spec,
    labels,
    new_train_state,
    reset_optimiser,
    round_weights,
)
from metropilot.learn.schedules import value_at
from metropilot.learn.train import (
    TrainingLog,
    TrainingOptions,
    TrainingProgress,
    TrainingResult,
    identity_of,
)
from metropilot.policy import Params, Policy

IMITATIONS = 4
"""Parts that the imitation is cut into."""
IMITATE, DRIVE = 1, 2
"""Tags of the random numbers of each part."""
AT_A_TIME = 100
"""Gradient steps of the imitation in one call."""
REPORTS = 10
"""Number of progress reports while demonstrations are collected."""
LONGEST_M = 8_000.0
"""Longer sections are imitated only: few drives on them are short enough, and their tables are large."""
WARM_UP = 500
DRIVE_WARM_UP = 20


class Standing(NamedTuple):
    """Content of a checkpoint.

    Attributes:
        pupil: Current policy and optimiser; the name is part of the checkpoint format.
        best: Parameters of the best policy so far.
        best_score: Its score. Shape ().
    """

    pupil: TrainState
    best: Params
    best_score: Array


Part = Callable[[int, TrainState], tuple[TrainState, dict[str, float]]]
"""From the number of a part and the policy before it to the policy after it and its row."""


def _begin(train_state: TrainState) -> Standing:
    return Standing(train_state, dict(train_state.params), jnp.full((), -jnp.inf, jnp.float32))


def require_random_sections(task: env.DrivingTask) -> None:
    """Refuse a task for which there are no demonstrations.

    Raises:
        InputError: Its sections are not random, or its policy's action is no share of effort.
    """
    if not (
        isinstance(task.config, env.DomainRandomization) and isinstance(task.config.action, env.RegimeAction)
    ):
        raise InputError("demonstrations exist only for random sections", field="task", allowed="worlds")


def train_in_parts(
    config: TeacherConfig, task: env.DrivingTask, seed: int, options: TrainingOptions
) -> TrainingResult:
    """Train the generalist, with progress and checkpoints.

    Args:
        config: Configuration.
        task: Task whose drives evaluate the policy.
        seed: Of everything random.
        options: Options of the run; its evaluation decides which policy is kept.

    Raises:
        InputError: The checkpoint or a file of demonstrations is damaged or of another run, or the task's
            policy is no share of effort.
    """
    require_random_sections(task)
    env.check_features(config.unseen, FEATURE_NAMES, "unseen")
    if options.evaluate is None:
        raise InputError("the course is judged by drives", field="evaluate")
    keep_compiled()
    if options.checkpoint is not None:
        return _Training(config, task, seed, options, options.checkpoint.parent).run()
    with TemporaryDirectory(prefix="metropilot-") as folder:
        return _Training(config, task, seed, options, Path(folder)).run()


@dataclass
class _Training:
    """One session of the training."""

    config: TeacherConfig
    task: env.DrivingTask
    seed: int
    options: TrainingOptions
    folder: Path

    def run(self) -> TrainingResult:
        """Do all parts that are not done yet."""
        config = self.config
        spec = imitation_spec(config, self.task.observation_size)
        log = TrainingLog(
            self.options, identity_of(config, self.seed, self.options), self._count, config.steps
        )
        blank = new_train_state(config, self.seed, np.zeros((2, spec.observation_size), np.float32))
        fresh = _begin(blank)
        standing = log.resume(jax.eval_shape(lambda: fresh)) or fresh
        dataset = DemonstrationSet(
            self.seed,
            config.worlds,
            config.plans,
            config.states,
            self.folder / "lessons",
            config.wide_share,
        )
        if log.chunks_done < self._count:
            self._collect(dataset)
            demonstrations, numbers = load_demonstrations(dataset)
            if not log.chunks_done:
                standing = _begin(self._new_train_state(demonstrations.observations))
            part = self._parts(demonstrations, numbers)
            while log.chunks_done < self._count:
                start = time.perf_counter()
                train_state, row = part(log.chunks_done + 1, standing.pupil)
                standing, row = self._evaluate(standing, train_state, row)
                log.add(standing, row, int(row["steps"]), time.perf_counter() - start)
        self._remove_demonstrations(dataset)
        policy = Policy(spec, round_weights(standing.best))
        return TrainingResult(policy, float(standing.best_score), log.history, log.seconds, 0.0)

    def _new_train_state(self, observations: np.ndarray) -> TrainState:
        state = new_train_state(self.config, self.seed, observations)
        if not self.config.unseen:
            return state
        names = DemonstrationGenerator(env.domain_sample(self.seed, 0), 1.0).column_names()
        return hide_features(state, [name in self.config.unseen for name in names])

    def _collect(self, dataset: DemonstrationSet) -> None:
        """Collect demonstrations that are not there yet; none once the learning has begun."""
        start = time.perf_counter()

        def tell(count: int) -> None:
            left = (time.perf_counter() - start) * (dataset.shards - count) / max(count, 1)
            if (
                self.options.on_progress
                and REPORTS * count // dataset.shards > REPORTS * (count - 1) // dataset.shards
            ):
                total = self.config.steps
                row = {"lessons": count / dataset.shards}
                self.options.on_progress(TrainingProgress(0, self._count, 0, total, 0.0, 0.0, left, row))

        collect_missing(dataset, tell)

    @property
    def _count(self) -> int:
        return IMITATIONS + self.config.evaluations

    def _parts(self, demonstrations: Demonstrations, numbers: np.ndarray) -> Part:
        config, spec = self.config, imitation_spec(self.config, demonstrations.observations.shape[1])
        action = self.task.config.action
        assert isinstance(action, env.RegimeAction)
        wanted = labels(action, demonstrations.commands)
        tuning: list[Tuning] = []

        def part(number: int, train_state: TrainState) -> tuple[TrainState, dict[str, float]]:
            if number <= IMITATIONS:
                random = np.random.default_rng([self.seed, IMITATE, number])
                return self._imitate(number, train_state, random, demonstrations.observations, wanted)
            if not tuning:
                samples = {
                    int(k): env.domain_sample(self.seed, int(k), config.wide_share)
                    for k in np.unique(numbers)
                }
                short = np.array([samples[int(k)].section.length_m <= LONGEST_M for k in numbers])
                loop, case = self._loop(samples, numbers[short])
                drives = drives_of(case, demonstrations.begins[short], loop.period_s)
                tuning.append(Tuning(config, spec, loop, drives, demonstrations))
            random = np.random.default_rng([self.seed, DRIVE, number])
            if number == IMITATIONS + 1:
                train_state = reset_optimiser(train_state)
            return self._drive(number - IMITATIONS, train_state, random, tuning[0])

        return part

    def _imitate(
        self,
        number: int,
        train_state: TrainState,
        random: np.random.Generator,
        seen: np.ndarray,
        wanted: np.ndarray,
    ) -> tuple[TrainState, dict[str, float]]:
        config, spec = self.config, imitation_spec(self.config, seen.shape[1])
        rounds = max(config.batches // IMITATIONS // AT_A_TIME, 1)

        @jax.jit
        def many(
            train_state: TrainState, first: Array, seen: Array, wanted: Array
        ) -> tuple[TrainState, Array]:
            def one(carry: tuple[TrainState, Array], batch: tuple[Array, Array]) -> Any:
                train_state, k = carry
                loss, slope = jax.value_and_grad(
                    lambda params: imitation_loss(spec, params, batch[0], batch[1])
                )(train_state.params)
                share = k / (rounds * AT_A_TIME * IMITATIONS)
                rate = config.imitation_rate * 0.5 * (1.0 + jnp.cos(jnp.pi * share))
                rate = rate * jnp.minimum(1.0, (k + 1.0) / WARM_UP)
                return (apply_gradient(train_state, slope, rate, None), k + 1.0), loss

            (train_state, _), losses = jax.lax.scan(one, (train_state, first), (seen, wanted))
            return train_state, jnp.mean(losses)

        loss = np.nan
        for k in range(rounds):
            rows = random.integers(0, wanted.size, (AT_A_TIME, config.batch_size))
            first = jnp.float32(((number - 1) * rounds + k) * AT_A_TIME)
            train_state, loss = many(train_state, first, seen[rows], wanted[rows])
        return train_state, {"steps": 0.0, "return": np.nan, "imitation": float(loss), "cost": np.nan}

    def _drive(
        self, number: int, train_state: TrainState, random: np.random.Generator, tuning: Tuning
    ) -> tuple[TrainState, dict[str, float]]:
        config, costs = self.config, []
        rounds = self._rounds
        for k in range(rounds):
            share = ((number - 1) * rounds + k) / (rounds * config.evaluations)
            rate = float(value_at(config.learning_rate, share))
            rate *= min(1.0, ((number - 1) * rounds + k + 1) / DRIVE_WARM_UP)
            train_state, cost = tuning.step(train_state, random, rate)
            costs.append(cost)
        cost = float(np.mean(costs))
        steps = float(number * rounds * config.decisions)
        return train_state, {"steps": steps, "return": -cost, "imitation": np.nan, "cost": cost}

    @property
    def _rounds(self) -> int:
        """Gradient steps of one part of the closed loop."""
        config = self.config
        return max(config.steps // config.decisions // config.evaluations, 1)

    def _loop(
        self, samples: Mapping[int, env.DomainSample], numbers: np.ndarray
    ) -> tuple[ClosedLoop, np.ndarray]:
        """Closed loop over the sections' tables, and the row in them at which each drive begins.

        Its plant answers at once: a driver sees the state in which its command begins to act, so that dead
        time and lag reach the policy through the permitted speed alone.
        """
        known, case = np.unique(numbers, return_inverse=True)
        config = replace(
            self.task.config,
            sections=tuple(samples[int(number)].section for number in known),
            trainsets=tuple(samples[int(number)].trainset for number in known),
            spacing_m=SPACING_M,
        )
        action = config.action
        assert isinstance(action, env.RegimeAction)
        tables = config.tables(jobs=0)
        at_once = np.zeros_like(tables.vehicle.delay_s)
        tables = tables._replace(vehicle=tables.vehicle._replace(delay_s=at_once, lag_s=at_once))
        rows = env.SectionRows(tables, jax=True)
        period_s = config.dt * config.periods
        return ClosedLoop(rows, config.features, action, config.assists, period_s), case.astype(np.int32)

    def _evaluate(
        self, standing: Standing, train_state: TrainState, row: dict[str, float]
    ) -> tuple[Standing, dict[str, float]]:
        """The policy's drives, and whether it is the best so far."""
        evaluate = self.options.evaluate
        assert evaluate is not None
        found = jax.jit(evaluate)(train_state.params, jax.random.key(self.seed))
        score = found["score"]
        better = (score > standing.best_score) | (self.config.keep == "last")
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), train_state.params, standing.best)
        standing = Standing(train_state, best, jnp.where(better, score, standing.best_score))
        return standing, row | {f"evaluation.{name}": float(value) for name, value in found.items()}

    def _remove_demonstrations(self, dataset: DemonstrationSet) -> None:
        """Remove the demonstrations: they are large, and made again from the seed."""
        for shard in range(dataset.shards):
            dataset.path(shard).unlink(missing_ok=True)
        if dataset.folder.is_dir() and not any(dataset.folder.iterdir()):
            dataset.folder.rmdir()
