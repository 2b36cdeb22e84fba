"""The course of the generalist: gather lessons, imitate, drive in closed loop; stopped anywhere, it goes on.

The same session, progress and result as of the other learners (:mod:`metropilot.learn.train`). Every part
of the course draws from its own random numbers, and a checkpoint holds the policy with its optimiser: a run
that was stopped ends with the same bits as one that was not.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from metropilot.env import DomainRandomization, DrivingTask, RegimeAction, SectionRows, domain_sample
from metropilot.errors import InputError
from metropilot.learn.compile_cache import keep_compiled
from metropilot.learn.config import TeacherConfig
from metropilot.learn.imitation.closed_loop import ClosedLoop
from metropilot.learn.imitation.gather import Gathering, gather, gathered
from metropilot.learn.imitation.lessons import SPACING_M, Demonstrations
from metropilot.learn.imitation.pupil import (
    TrainState,
    imitation_loss,
    labels,
    learned,
    new_pupil,
    pupil_spec,
    rested,
)
from metropilot.learn.imitation.tuning import Tuning, drives_of
from metropilot.learn.schedules import value_at
from metropilot.learn.train import (
    TrainingLog,
    TrainingOptions,
    TrainingProgress,
    TrainingResult,
    identity_of,
)
from metropilot.policy import Params, Policy

Array = Any

IMITATIONS = 4
"""Parts that the imitation is cut into."""
IMITATE, DRIVE = 1, 2
"""Tags of the random numbers of each part."""
AT_A_TIME = 100
"""Gradient steps of the imitation in one call."""
TOLD = 10
"""Number of progress reports while demonstrations are collected."""
WARM_UP = 500
DRIVE_WARM_UP = 20


class Standing(NamedTuple):
    """Content of a checkpoint.

    Attributes:
        pupil: The policy as it stands.
        best: Parameters of the best policy so far.
        best_score: Its score. Shape ().
    """

    pupil: TrainState
    best: Params
    best_score: Array


Part = Callable[[int, TrainState], tuple[TrainState, dict[str, float]]]
"""From the number of a part and the policy before it to the policy after it and its row."""


def _untaught(pupil: TrainState) -> Standing:
    return Standing(pupil, dict(pupil.params), jnp.full((), -jnp.inf, jnp.float32))


def only_worlds(task: DrivingTask) -> None:
    """Refuse a task that the teacher has no lessons for.

    Raises:
        InputError: Its cases are no worlds, or its policy's action is no share of effort.
    """
    if not (isinstance(task.config, DomainRandomization) and isinstance(task.config.action, RegimeAction)):
        raise InputError("demonstrations exist only for random sections", field="task", allowed="worlds")


def teach_in_parts(
    config: TeacherConfig, task: DrivingTask, seed: int, options: TrainingOptions
) -> TrainingResult:
    """Take the course, with progress and checkpoints.

    Args:
        config: Configuration.
        task: The worlds that judge.
        seed: Of everything random.
        options: Options of the run; its evaluation decides which policy is kept.

    Raises:
        InputError: The checkpoint or a file of lessons is damaged or of another run, or the task's policy
            is no share of effort.
    """
    only_worlds(task)
    if options.evaluate is None:
        raise InputError("the course is judged by drives", field="evaluate")
    keep_compiled()
    if options.checkpoint is not None:
        return _Course(config, task, seed, options, options.checkpoint.parent).take()
    with TemporaryDirectory(prefix="metropilot-") as folder:
        return _Course(config, task, seed, options, Path(folder)).take()


@dataclass
class _Course:
    """One session of a course."""

    config: TeacherConfig
    task: DrivingTask
    seed: int
    options: TrainingOptions
    folder: Path

    def take(self) -> TrainingResult:
        """Do all parts that are not done yet."""
        config = self.config
        spec = pupil_spec(config, self.task.observation_size)
        log = TrainingLog(
            self.options, identity_of(config, self.seed, self.options), self._count, config.steps
        )
        blank = new_pupil(config, self.seed, np.zeros((2, spec.observation_size), np.float32))
        fresh = _untaught(blank)
        standing = log.resume(jax.eval_shape(lambda: fresh)) or fresh
        gathering = Gathering(self.seed, config.worlds, config.plans, config.states, self.folder / "lessons")
        if log.done < self._count:
            self._gather(gathering)
            lessons, numbers = gathered(gathering)
            if not log.done:
                standing = _untaught(new_pupil(config, self.seed, lessons.observations))
            part = self._parts(lessons, numbers)
            while log.done < self._count:
                start = time.perf_counter()
                pupil, row = part(log.done + 1, standing.pupil)
                standing, row = self._judged(standing, pupil, row)
                log.add(standing, row, int(row["steps"]), time.perf_counter() - start)
        self._put_away(gathering)
        params = {name: np.asarray(value) for name, value in standing.best.items()}
        return TrainingResult(Policy(spec, params), float(standing.best_score), log.history, log.seconds, 0.0)

    def _gather(self, gathering: Gathering) -> None:
        """Lessons that are not there yet; nothing is gathered once the learning has begun."""
        start = time.perf_counter()

        def tell(count: int) -> None:
            left = (time.perf_counter() - start) * (gathering.shards - count) / max(count, 1)
            if (
                self.options.on_progress
                and TOLD * count // gathering.shards > TOLD * (count - 1) // gathering.shards
            ):
                total = self.config.steps
                row = {"lessons": count / gathering.shards}
                self.options.on_progress(TrainingProgress(0, self._count, 0, total, 0.0, 0.0, left, row))

        gather(gathering, tell)

    @property
    def _count(self) -> int:
        return IMITATIONS + self.config.evaluations

    def _parts(self, lessons: Demonstrations, numbers: np.ndarray) -> Part:
        """Build the functions of each part."""
        config, spec = self.config, pupil_spec(self.config, lessons.observations.shape[1])
        action = self.task.config.action
        assert isinstance(action, RegimeAction)
        wanted = labels(action, lessons.commands)
        tuning: list[Tuning] = []

        def part(number: int, pupil: TrainState) -> tuple[TrainState, dict[str, float]]:
            if number <= IMITATIONS:
                random = np.random.default_rng([self.seed, IMITATE, number])
                return self._imitate(number, pupil, random, lessons.observations, wanted)
            if not tuning:
                loop, case = self._loop(numbers)
                drives = drives_of(case, lessons.begins, loop.period_s)
                tuning.append(Tuning(config, spec, loop, drives, lessons))
            random = np.random.default_rng([self.seed, DRIVE, number])
            if number == IMITATIONS + 1:
                pupil = rested(pupil)
            return self._drive(number - IMITATIONS, pupil, random, tuning[0])

        return part

    def _imitate(
        self,
        number: int,
        pupil: TrainState,
        random: np.random.Generator,
        seen: np.ndarray,
        wanted: np.ndarray,
    ) -> tuple[TrainState, dict[str, float]]:
        """One part of the imitation."""
        config, spec = self.config, pupil_spec(self.config, seen.shape[1])
        rounds = max(config.batches // IMITATIONS // AT_A_TIME, 1)

        @jax.jit
        def many(pupil: TrainState, first: Array, seen: Array, wanted: Array) -> tuple[TrainState, Array]:
            def one(carry: tuple[TrainState, Array], batch: tuple[Array, Array]) -> Any:
                pupil, k = carry
                loss, slope = jax.value_and_grad(
                    lambda params: imitation_loss(spec, params, batch[0], batch[1])
                )(pupil.params)
                share = k / (rounds * AT_A_TIME * IMITATIONS)
                rate = config.imitation_rate * 0.5 * (1.0 + jnp.cos(jnp.pi * share))
                rate = rate * jnp.minimum(1.0, (k + 1.0) / WARM_UP)
                return (learned(pupil, slope, rate, None), k + 1.0), loss

            (pupil, _), losses = jax.lax.scan(one, (pupil, first), (seen, wanted))
            return pupil, jnp.mean(losses)

        loss = np.nan
        for k in range(rounds):
            rows = random.integers(0, wanted.size, (AT_A_TIME, config.batch_size))
            first = jnp.float32(((number - 1) * rounds + k) * AT_A_TIME)
            pupil, loss = many(pupil, first, seen[rows], wanted[rows])
        return pupil, {"steps": 0.0, "return": np.nan, "imitation": float(loss), "cost": np.nan}

    def _drive(
        self, number: int, pupil: TrainState, random: np.random.Generator, tuning: Tuning
    ) -> tuple[TrainState, dict[str, float]]:
        """One part of the closed loop."""
        config, costs = self.config, []
        rounds = self._rounds
        for k in range(rounds):
            share = ((number - 1) * rounds + k) / (rounds * config.evaluations)
            rate = float(value_at(config.learning_rate, share))
            rate *= min(1.0, ((number - 1) * rounds + k + 1) / DRIVE_WARM_UP)
            pupil, cost = tuning.step(pupil, random, rate)
            costs.append(cost)
        cost = float(np.mean(costs))
        steps = float(number * rounds * config.decisions)
        return pupil, {"steps": steps, "return": -cost, "imitation": np.nan, "cost": cost}

    @property
    def _rounds(self) -> int:
        """Gradient steps of one part of the closed loop."""
        config = self.config
        return max(config.steps // config.decisions // config.evaluations, 1)

    def _loop(self, numbers: np.ndarray) -> tuple[ClosedLoop, np.ndarray]:
        """The worlds' tables, and the row of each place to begin at."""
        known, case = np.unique(numbers, return_inverse=True)
        worlds = [domain_sample(self.seed, int(number)) for number in known]
        config = replace(
            self.task.config,
            sections=tuple(world.section for world in worlds),
            trainsets=tuple(world.trainset for world in worlds),
            spacing_m=SPACING_M,
        )
        action = config.action
        assert isinstance(action, RegimeAction)
        rows = SectionRows(config.tables(jobs=0), jax=True)
        period_s = config.dt * config.periods
        return ClosedLoop(rows, config.features, action, config.assists, period_s), case.astype(np.int32)

    def _judged(
        self, standing: Standing, pupil: TrainState, row: dict[str, float]
    ) -> tuple[Standing, dict[str, float]]:
        """The policy's drives, and whether it is the best so far."""
        evaluate = self.options.evaluate
        assert evaluate is not None
        found = jax.jit(evaluate)(pupil.params, jax.random.key(self.seed))
        score = found["score"]
        better = (score > standing.best_score) | (self.config.keep == "last")
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), pupil.params, standing.best)
        standing = Standing(pupil, best, jnp.where(better, score, standing.best_score))
        return standing, row | {f"evaluation.{name}": float(value) for name, value in found.items()}

    def _put_away(self, gathering: Gathering) -> None:
        """Remove the lessons: they are large, and made again from the seed."""
        for shard in range(gathering.shards):
            gathering.path(shard).unlink(missing_ok=True)
        if gathering.folder.is_dir() and not any(gathering.folder.iterdir()):
            gathering.folder.rmdir()
