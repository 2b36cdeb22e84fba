"""Learning: from Python chunk by chunk, and into a run folder that can be shown, resumed and driven."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from metropilot._io import hold_lock
from metropilot.env import AbstractTask, DrivingTask, PolicyInterface, TaskSite
from metropilot.errors import InputError
from metropilot.learn.checkpoint import load_checkpoint, save_checkpoint
from metropilot.learn.compile_cache import keep_compiled
from metropilot.learn.config import AbstractConfig, TeacherConfig, config_to_mapping
from metropilot.learn.loop import PolicyEvaluation, make_loop
from metropilot.learn.run_store import CHECKPOINT_FILE, HISTORY_FILE, RunRecord, RunStore, write_history
from metropilot.learn.tensorboard import EventWriter
from metropilot.policy import POLICY_FILE, Policy, save_policy

History = dict[str, np.ndarray]


@dataclass(frozen=True)
class TrainingProgress:
    """Progress of a run.

    Attributes:
        chunk: Chunks done.
        chunks: Chunks in all.
        steps: Environment steps done.
        total_steps: Environment steps in all.
        seconds: Spent learning, compilation apart, over all sessions.
        rate: Environment steps a second in the last chunk.
        seconds_left: At that rate.
        row: The last row of the history.
        kept: The row of the policy kept so far; empty before there is one.
    """

    chunk: int
    chunks: int
    steps: int
    total_steps: int
    seconds: float
    rate: float
    seconds_left: float
    row: Mapping[str, float]
    kept: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class TrainingResult:
    """Result of a run.

    Attributes:
        policy: The one kept, as NumPy arrays.
        score: Its evaluation score; minus infinity if it never had one.
        history: One array a column, one entry a chunk.
        seconds: Spent learning, compilation apart.
        compile_seconds: Spent compiling, in this session.
    """

    policy: Policy
    score: float
    history: History
    seconds: float
    compile_seconds: float


@dataclass(frozen=True)
class TrainingOptions:
    """Options of a session; none of them changes what is learned.

    Attributes:
        evaluate: Evaluates the policy; see :func:`metropilot.learn.loop.make_loop`.
        on_progress: Called after every chunk.
        checkpoint: File of the kept state; None: not kept.
        resume: Go on from the checkpoint if there is one; else it is written over.
        about: Plain values that must be the same to go on (which task, which section).
    """

    evaluate: PolicyEvaluation | None = None
    on_progress: Callable[[TrainingProgress], object] | None = None
    checkpoint: Path | None = None
    resume: bool = False
    about: Mapping[str, Any] | None = None


@dataclass
class TrainingLog:
    """History of one run, with the checkpoint that holds it and the learner's state.

    Attributes:
        options: Options of the run.
        identity: Plain values that must be the same to go on.
        chunks: Chunks of the run.
        total_steps: Environment steps of the run.
        columns: Rows so far, one list a column.
        steps: Environment steps done.
        seconds: Spent learning, over all sessions.
    """

    options: TrainingOptions
    identity: Mapping[str, Any]
    chunks: int
    total_steps: int
    columns: dict[str, list[float]] = field(default_factory=dict)
    steps: int = 0
    seconds: float = 0.0

    @property
    def chunks_done(self) -> int:
        """Chunks done."""
        return len(next(iter(self.columns.values()), []))

    @property
    def kept(self) -> dict[str, float]:
        """Row of the policy kept so far; empty before there is one."""
        row = kept_row(self.history, self.identity["config"]["keep"])
        return {} if row is None else {name: column[row] for name, column in self.columns.items()}

    @property
    def history(self) -> History:
        """Rows so far, one array a column."""
        return {name: np.asarray(column) for name, column in self.columns.items()}

    def resume(self, template: Any) -> Any:
        """State in the checkpoint; None where there is none to go on from.

        Args:
            template: Shapes and dtypes of the state, from ``jax.eval_shape``.

        Raises:
            InputError: The checkpoint is damaged, or of another run.
        """
        path = self.options.checkpoint
        if not (self.options.resume and path and path.exists()):
            return None
        state, history, about = load_checkpoint(path, template)
        for name, old, new in _differences(about, self.identity):
            words = "the checkpoint was made with another value"
            raise InputError(words, file=path, field=name, value=repr(new), allowed=repr(old))
        self.columns = {name: column.tolist() for name, column in history.items()}
        self.steps = int(self.columns["steps"][-1])
        self.seconds = float(about.get("seconds", 0.0))
        return state

    def add(self, state: Any, row: Mapping[str, float], steps: int, spent_s: float) -> None:
        """Append a chunk's row; save the checkpoint, then report the progress.

        Args:
            state: Of the learner, after the chunk.
            row: Of the history.
            steps: Environment steps done, this chunk included.
            spent_s: Duration of the chunk.

        Raises:
            InputError: The checkpoint cannot be written.
        """
        self.seconds += spent_s
        before = self.chunks_done
        # A checkpoint of an earlier version may lack a column, or have one more.
        for name in {**self.columns, **row}:
            self.columns.setdefault(name, [math.nan] * before).append(row.get(name, math.nan))
        number, options = self.chunks_done, self.options
        if options.checkpoint:
            about = {**self.identity, "seconds": self.seconds}
            save_checkpoint(options.checkpoint, state, self.history, about)
        rate = (steps - self.steps) / max(spent_s, 1e-9)
        self.steps = steps
        if options.on_progress:
            left_s = (self.chunks - number) * spent_s
            options.on_progress(
                TrainingProgress(
                    number, self.chunks, steps, self.total_steps, self.seconds, rate, left_s, row, self.kept
                )
            )


def learn_in_chunks(
    config: AbstractConfig, task: AbstractTask, seed: int, options: TrainingOptions | None = None
) -> TrainingResult:
    """Learn a policy, with progress and checkpoints.

    The chunk is the one that :func:`metropilot.learn.loop.learn` scans over, compiled by itself with its
    state donated. Stopped at any moment and continued, a run gives the same bits as one that was not; what
    is lost is at most what was done since the last checkpoint.

    Args:
        config: Configuration; its type chooses the learner.
        task: Task to learn.
        seed: Of everything random.
        options: Options of the run.

    Raises:
        InputError: The checkpoint is damaged, or of another run.
    """
    options = options or TrainingOptions()
    keep_compiled()
    loop = make_loop(config, task, options.evaluate)
    log = TrainingLog(options, identity_of(config, seed, options), loop.chunks, loop.steps)
    key = jax.random.key(seed)
    state = log.resume(jax.eval_shape(loop.init, key))
    state = jax.jit(loop.init)(key) if state is None else state
    start = time.perf_counter()
    chunk = jax.jit(loop.chunk, donate_argnums=0).lower(state).compile()
    compile_seconds = time.perf_counter() - start
    while log.chunks_done < loop.chunks:
        start = time.perf_counter()
        state, row = jax.block_until_ready(chunk(state))
        spent_s = time.perf_counter() - start
        steps = (log.chunks_done + 1) * loop.iterations * loop.learner.iteration_steps
        log.add(state, {name: float(value) for name, value in row.items()}, steps, spent_s)
    params = {name: np.asarray(value) for name, value in state.best.items()}
    policy = Policy(loop.learner.spec, params)
    return TrainingResult(policy, float(state.best_score), log.history, log.seconds, compile_seconds)


def identity_of(config: AbstractConfig, seed: int, options: TrainingOptions) -> dict[str, Any]:
    """Plain values that must be the same to go on with a run."""
    plain = config_to_mapping(config)
    return {"algorithm": config.algorithm, "config": plain, "seed": seed, "task": dict(options.about or {})}


def _differences(old: Any, new: Any, name: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Plain values that differ from those in a checkpoint; lists and tuples of equal entries are equal."""
    if isinstance(new, Mapping):
        for key in new:
            below = old.get(key) if isinstance(old, Mapping) else None
            yield from _differences(below, new[key], f"{name}.{key}".lstrip("."))
    elif (list(old) if isinstance(old, tuple) else old) != (list(new) if isinstance(new, tuple) else new):
        yield name, old, new


@dataclass(frozen=True)
class RunRequest:
    """Learning run to be done.

    Attributes:
        config: Configuration; its type chooses the learner.
        task: Task to learn.
        name: The task in a word.
        seed: Of everything random.
        about: Further identification of the task.
        site: Line and trainset of the task, if not its own.
        tensorboard: Also write event files.
        driver: Id of the driver that is learned; empty where it has none.
        interface: Knowledge a driver needs to use the policy; None: it cannot be driven.
        command: The command line that asks for it.
    """

    config: AbstractConfig
    task: AbstractTask
    name: str
    seed: int = 0
    about: Mapping[str, Any] | None = None
    site: TaskSite = field(default_factory=TaskSite)
    tensorboard: bool = False
    driver: str = ""
    interface: PolicyInterface | None = None
    command: str = ""


def learn_run(
    store: RunStore, request: RunRequest, options: TrainingOptions | None = None, resume: str | None = None
) -> tuple[RunRecord, TrainingResult]:
    """Learn into a run folder, or go on with one that was stopped.

    Args:
        store: Store of the runs.
        request: Run to begin or to go on with.
        options: Evaluation, progress and how often to save; its paths are replaced by the folder's.
        resume: Id of the run to go on with; None begins a new one.

    Raises:
        InputError: No such run, it was of another configuration, task or seed, or it is being learned now.
    """
    record = store.show(resume) if resume else begin_run(store, request)
    if resume and record.task != request.name:
        raise InputError(
            "the run learned another task", field="task", value=request.name, allowed=record.task
        )
    with hold_lock(store.folder(record.id)):
        return _learn(store, request, options or TrainingOptions(), record, resume=bool(resume))


def begin_run(store: RunStore, request: RunRequest, run_id: str | None = None) -> RunRecord:
    """A new run's folder and record; :func:`learn_run` then goes on with it.

    Raises:
        InputError: The folder cannot be written.
    """
    more = {"driver": request.driver, "command": request.command} | ({"id": run_id} if run_id else {})
    record = store.create(request.config, request.name, request.seed, _about(request), **more)
    request.site.copy_files(store.folder(record.id))
    return record


def _about(request: RunRequest) -> dict[str, Any]:
    return dict(request.about or {}) | request.site.as_copied().values() | {"name": request.name}


def _learn(
    store: RunStore, request: RunRequest, given: TrainingOptions, record: RunRecord, *, resume: bool
) -> tuple[RunRecord, TrainingResult]:
    """The learning itself, with the folder's lock held."""
    folder, about = store.folder(record.id), _about(request)
    before, record = record, store.update(record, status="running")
    reached: dict[str, Any] = {}

    def progress(now: TrainingProgress) -> None:
        score = now.kept.get(f"{EVALUATION}score", math.nan)
        reached.update(steps=now.steps, seconds=now.seconds, kpis=kpis_of_row(now.kept))
        reached["score"] = score if math.isfinite(score) else None
        store.update(record, **reached)
        if events:
            events.write(now.steps, now.row)
        if given.on_progress:
            given.on_progress(now)

    checkpoint = folder / CHECKPOINT_FILE
    whole = replace(given, on_progress=progress, checkpoint=checkpoint, resume=resume, about=about)
    learner: Callable[..., TrainingResult] = learn_in_chunks
    if isinstance(request.config, TeacherConfig) and isinstance(request.task, DrivingTask):
        from metropilot.learn.imitation.training import train_in_parts as learner
    try:
        with EventWriter(folder) if request.tensorboard else nullcontext() as events:
            learned = learner(request.config, request.task, request.seed, whole)
    except InputError:
        store.save(before)
        raise
    except BaseException as error:
        status = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
        store.update(record, status=status, **reached)
        raise
    write_history(folder / HISTORY_FILE, learned.history)
    finite = learned.score if math.isfinite(learned.score) else None
    steps = int(learned.history["steps"][-1])
    kpis = select_kpis(learned.history, request.config.keep)
    record = replace(
        record,
        status="done",
        score=finite,
        seconds=learned.seconds,
        compile_seconds=learned.compile_seconds,
        steps=steps,
        kpis=kpis,
    )
    save_policy(folder / POLICY_FILE, learned.policy, policy_about(record, request.interface))
    store.save(record)
    return record, learned


def policy_about(record: RunRecord, interface: PolicyInterface | None) -> dict[str, Any]:
    """Metadata of a policy file: all that a driver needs, and its origin."""
    about: dict[str, Any] = {
        "driver": record.driver,
        "algorithm": record.algorithm,
        "task": dict(record.about),
        "config": dict(record.config),
        "seed": record.seed,
        "score": record.score,
        "kpis": dict(record.kpis),
        "provenance": {
            "run": record.id,
            "steps": record.steps,
            "seconds": round(record.seconds, 1),
            "command": record.command,
            "commit": record.commit_id,
            "date": record.created[:10],
            "machine": record.machine,
            "versions": dict(record.versions),
        },
    }
    return about | ({"perception": interface.as_dict()} if interface else {})


EVALUATION = "evaluation."
"""Prefix of an evaluation's columns."""


def kept_row(history: Mapping[str, np.ndarray], keep: str) -> int | None:
    """Row of the history whose policy is kept; None where none is.

    As the loop keeps it: the earliest of the highest scores, and a score that is not a number is none.

    Args:
        history: One array a column, as :func:`learn_in_chunks` gives it.
        keep: ``best`` or ``last``.
    """
    score = history.get(f"{EVALUATION}score", np.empty(0))
    if keep == "last":
        return score.size - 1 if score.size else None
    known = np.where(np.isnan(score), -np.inf, score)
    return int(np.argmax(known)) if np.any(known > -np.inf) else None


def select_kpis(history: Mapping[str, np.ndarray], keep: str) -> dict[str, float]:
    """KPIs of the policy kept, from the history of its learning; those that are not finite left out.

    Args:
        history: One array a column, as :func:`learn_in_chunks` gives it.
        keep: ``best`` or ``last``.
    """
    row = kept_row(history, keep)
    return {} if row is None else kpis_of_row({name: float(column[row]) for name, column in history.items()})


def kpis_of_row(row: Mapping[str, float]) -> dict[str, float]:
    """The evaluation's KPIs in a row of the history."""
    found = {name.removeprefix(EVALUATION): row[name] for name in row if name.startswith(EVALUATION)}
    return {name: value for name, value in found.items() if np.isfinite(value) and name != "score"}
