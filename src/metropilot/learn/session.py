"""A run from Python, chunk by chunk: progress, checkpoints, interruption, going on.

The chunk is the one that :func:`metropilot.learn.loop.learn` scans over, compiled by itself with its state
donated. Stopped at any moment and continued, a run gives the same bits as one that was not; what is lost is
at most what was done since the last checkpoint.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from metropilot.env.interface import AbstractTask
from metropilot.errors import InputError
from metropilot.learn.checkpoint import load_checkpoint, save_checkpoint
from metropilot.learn.compile_cache import keep_compiled
from metropilot.learn.config_base import AbstractConfig
from metropilot.learn.config_reading import config_to_mapping
from metropilot.learn.loop import Evaluate, Loop, LoopState, make_loop
from metropilot.policy.policy import Policy

History = dict[str, np.ndarray]


@dataclass(frozen=True)
class TrainingProgress:
    """How far a run is.

    Attributes:
        chunk: Chunks done.
        chunks: Chunks in all.
        steps: Environment steps done.
        total_steps: Environment steps in all.
        seconds: Spent learning, compilation apart, over all sittings.
        rate: Environment steps a second in the last chunk.
        seconds_left: At that rate.
        row: The last row of the history.
    """

    chunk: int
    chunks: int
    steps: int
    total_steps: int
    seconds: float
    rate: float
    seconds_left: float
    row: Mapping[str, float]


@dataclass(frozen=True)
class TrainingResult:
    """What came of a run.

    Attributes:
        policy: The one kept, as NumPy arrays.
        score: Its evaluation score; minus infinity if it never had one.
        history: One array a column, one entry a chunk.
        seconds: Spent learning, compilation apart.
        compile_seconds: Spent compiling, in this sitting.
    """

    policy: Policy
    score: float
    history: History
    seconds: float
    compile_seconds: float


@dataclass(frozen=True)
class TrainingOptions:
    """How a run is to be done; none of it changes what is learned.

    Attributes:
        evaluate: Evaluates the policy; see :func:`metropilot.learn.loop.make_loop`.
        on_progress: Called after every chunk.
        checkpoint: Where the state is kept; None: nowhere.
        every: Chunks between checkpoints.
        resume: Go on from the checkpoint if there is one; else it is written over.
        about: Plain values that must be the same to go on (which task, which section).
    """

    evaluate: Evaluate | None = None
    on_progress: Callable[[TrainingProgress], object] | None = None
    checkpoint: Path | None = None
    every: int = 1
    resume: bool = False
    about: Mapping[str, Any] | None = None


def learn_in_chunks(
    config: AbstractConfig, task: AbstractTask, seed: int, sitting: TrainingOptions | None = None
) -> TrainingResult:
    """Learn a policy, with progress and checkpoints.

    Args:
        config: Which learner and what it is told.
        task: What it learns.
        seed: Of everything random.
        sitting: How.

    Raises:
        InputError: The checkpoint is damaged, or of another run.
    """
    sitting = sitting or TrainingOptions()
    keep_compiled()
    loop = make_loop(config, task, sitting.evaluate)
    identity = identity_of(config, seed, sitting)
    state, columns, seconds = _begin(loop, seed, sitting, identity)
    start = time.perf_counter()
    chunk = jax.jit(loop.chunk, donate_argnums=0).lower(state).compile()
    compile_seconds = time.perf_counter() - start
    first = len(next(iter(columns.values()), []))
    for number in range(first + 1, loop.chunks + 1):
        start = time.perf_counter()
        state, row = jax.block_until_ready(chunk(state))
        spent = time.perf_counter() - start
        seconds += spent
        numbers = {name: float(value) for name, value in row.items()}
        for name, value in numbers.items():
            columns.setdefault(name, []).append(value)
        if sitting.checkpoint and (number % sitting.every == 0 or number == loop.chunks):
            history = {name: np.asarray(column) for name, column in columns.items()}
            save_checkpoint(sitting.checkpoint, state, history, identity | {"seconds": seconds})
        if sitting.on_progress:
            sitting.on_progress(_progress(loop, number, seconds, spent, numbers))
    history = {name: np.asarray(column) for name, column in columns.items()}
    params = {name: np.asarray(value) for name, value in state.best.items()}
    policy = Policy(loop.learner.spec, params)
    return TrainingResult(policy, float(state.best_score), history, seconds, compile_seconds)


def identity_of(config: AbstractConfig, seed: int, sitting: TrainingOptions) -> dict[str, Any]:
    """What must be the same to go on."""
    plain = config_to_mapping(config)
    return {"algorithm": config.algorithm, "config": plain, "seed": seed, "task": dict(sitting.about or {})}


def _begin(
    loop: Loop, seed: int, sitting: TrainingOptions, identity: Mapping[str, Any]
) -> tuple[LoopState, dict[str, list[float]], float]:
    """State, history and seconds so far: from the checkpoint, or none."""
    key = jax.random.key(seed)
    path = sitting.checkpoint
    if not (sitting.resume and path and path.exists()):
        return jax.jit(loop.init)(key), {}, 0.0
    state, history, about = load_checkpoint(path, jax.eval_shape(loop.init, key))
    for name, old, new in differences(about, identity):
        words = "the checkpoint was made with another value"
        raise InputError(words, file=path, field=name, value=repr(new), allowed=repr(old))
    return (
        state,
        {name: column.tolist() for name, column in history.items()},
        float(about.get("seconds", 0.0)),
    )


def differences(old: Any, new: Any, name: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Where plain values differ from those remembered; lists and tuples of equal entries are equal."""
    if isinstance(new, Mapping):
        for key in new:
            below = old.get(key) if isinstance(old, Mapping) else None
            yield from differences(below, new[key], f"{name}.{key}".lstrip("."))
    elif (list(old) if isinstance(old, tuple) else old) != (list(new) if isinstance(new, tuple) else new):
        yield name, old, new


def _progress(
    loop: Loop, number: int, seconds: float, spent: float, row: Mapping[str, float]
) -> TrainingProgress:
    """How far the run is after a chunk."""
    a_chunk = loop.iterations * loop.learner.iteration_steps
    rate = a_chunk / max(spent, 1e-9)
    left = (loop.chunks - number) * spent
    return TrainingProgress(number, loop.chunks, number * a_chunk, loop.steps, seconds, rate, left, row)
