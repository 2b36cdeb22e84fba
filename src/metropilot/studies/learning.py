"""Learning runs of a study: seed by seed, side by side, kept in folders, resumed by asking again."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from multiprocessing import current_process
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot._processes import ONE_THREAD, environment, own_core
from metropilot.errors import InputError

if TYPE_CHECKING:
    from metropilot.env.interface import AbstractTask
    from metropilot.learn import AbstractConfig
    from metropilot.policy import Policy


@dataclass(frozen=True)
class LearnJob:
    """One learning run. Everything in it travels to another process, so functions stand at module level.

    Attributes:
        name: What is learned, in a word that is unique in the study; folder name with the seed.
        config: Which learner and what it is told.
        task: Makes the task.
        seed: Of everything random.
        evaluation: From the task to what evaluates a policy; None: the learner's own episodes.
        about: Plain values that identify the run further; a change learns anew.
    """

    name: str
    config: AbstractConfig
    task: Callable[[], AbstractTask]
    seed: int
    evaluation: Callable[[AbstractTask], Any] | None = None
    about: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SeedResult:
    """What came of one.

    Attributes:
        job: Which.
        policy: The one kept.
        score: Its evaluation score.
        history: One array a column.
        seconds: Spent learning, compilation apart.
        compile_seconds: Spent compiling, in the sitting that ended it.
    """

    job: LearnJob
    policy: Policy
    score: float
    history: Mapping[str, np.ndarray]
    seconds: float
    compile_seconds: float


def learn_seeds(
    jobs: Sequence[LearnJob],
    folder: Path,
    processes: int = 2,
    say: Callable[[str], object] = lambda line: None,  # noqa: ARG005 (silent)
) -> list[SeedResult]:
    """Do every learning run that is not already done in the folder.

    Args:
        jobs: The runs.
        folder: Each run has a folder of its own in here, with checkpoint, history and policy.
        processes: Runs side by side, each in one single-threaded process.
        say: Called with a line whenever a run is done.

    Returns:
        One result a job, in their order.

    Raises:
        InputError: A folder cannot be written or read, or two jobs share name and seed.
    """
    from joblib import Parallel, delayed

    places = [folder / f"{job.name}-{job.seed}" for job in jobs]
    if len(set(places)) < len(places):
        raise InputError("two learning runs share name and seed", field="jobs")
    todo = [(job, place) for job, place in zip(jobs, places, strict=True) if not _done(job, place)]
    if todo:
        say(f"{len(jobs) - len(todo)} of {len(jobs)} learning runs are there, {len(todo)} to do")
        with environment(ONE_THREAD):
            pool = Parallel(n_jobs=min(processes, len(todo)), backend="loky", return_as="generator_unordered")
            for number, line in enumerate(pool(delayed(_learn)(job, place) for job, place in todo), 1):
                say(f"{number} of {len(todo)}: {line}")
    return [_read(job, place) for job, place in zip(jobs, places, strict=True)]


def finished(jobs: Sequence[LearnJob], folder: Path) -> list[LearnJob]:
    """Those of the jobs whose learning runs lie in the folder, done."""
    return [job for job in jobs if _done(job, folder / f"{job.name}-{job.seed}")]


def _identity(job: LearnJob) -> str:
    """What must be the same for a run to count as done: everything but the code."""
    from metropilot.learn import config_to_mapping

    parts = [job.name, job.seed, job.config.algorithm, config_to_mapping(job.config), dict(job.about)]
    return sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]


def _done(job: LearnJob, place: Path) -> bool:
    """Whether the folder holds this very run, finished."""
    path = place / "done.json"
    try:
        return json.loads(path.read_text())["identity"] == _identity(job)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _learn(job: LearnJob, place: Path) -> str:
    """One run, in a process of its own; a line about it."""
    from metropilot._io import atomic_write
    from metropilot.env import DrivingTask
    from metropilot.learn import TrainingOptions, learn_in_chunks, write_history
    from metropilot.policy import save_policy

    if current_process().name != "MainProcess":
        own_core()
    place.mkdir(parents=True, exist_ok=True)
    identity, checkpoint = _identity(job), place / f"checkpoint-{_identity(job)}.safetensors"
    task = job.task()
    evaluate = job.evaluation(task) if job.evaluation else None
    sitting = TrainingOptions(
        evaluate=evaluate, checkpoint=checkpoint, resume=True, about={"identity": identity}
    )
    learned = learn_in_chunks(job.config, task, job.seed, sitting)
    write_history(place / "history.parquet", learned.history)
    about: dict[str, Any] = {"identity": identity, "seed": job.seed}
    if isinstance(task, DrivingTask):
        about["perception"] = task.config.perception.as_dict()
    save_policy(place / "policy.safetensors", learned.policy, about)
    done = {
        "identity": identity,
        "score": learned.score if np.isfinite(learned.score) else None,
        "seconds": learned.seconds,
        "compile_seconds": learned.compile_seconds,
    }
    atomic_write(place / "done.json", lambda partial: partial.write_text(json.dumps(done)))
    checkpoint.unlink(missing_ok=True)
    return f"{job.name} seed {job.seed}, score {learned.score:.4g}, {learned.seconds:.0f} s"


def _read(job: LearnJob, place: Path) -> SeedResult:
    """A finished run from its folder."""
    from metropilot.learn import read_history
    from metropilot.policy import load_policy

    done = json.loads((place / "done.json").read_text())
    policy, _ = load_policy(place / "policy.safetensors")
    score = float("-inf") if done["score"] is None else float(done["score"])
    history = read_history(place / "history.parquet")
    return SeedResult(job, policy, score, history, float(done["seconds"]), float(done["compile_seconds"]))
