"""Learning runs of a study: seed by seed, side by side, in a run store, resumed by the same call."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing import current_process
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot._processes import ONE_THREAD, environment, own_core
from metropilot.errors import InputError

if TYPE_CHECKING:
    from metropilot._typing import Array
    from metropilot.env import AbstractTask
    from metropilot.learn import AbstractConfig, RunRecord
    from metropilot.policy import Policy


@dataclass(frozen=True)
class LearnJob:
    """One learning run. It is pickled for another process, so its functions are defined at module level.

    Attributes:
        name: Short name, unique in the study; with the seed it is the name of the run's folder.
        config: Learner and its hyperparameters.
        task: Factory of the task.
        seed: Seed of all random numbers.
        evaluation: Maps the task to the function that evaluates a policy; None: the learner's own episodes.
        about: Further plain values that identify the run; the run is repeated when they change.
    """

    name: str
    config: AbstractConfig
    task: Callable[[], AbstractTask]
    seed: int
    evaluation: Callable[[AbstractTask], Any] | None = None
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def run_id(self) -> str:
        """Name of the run's folder."""
        return f"{self.name}-{self.seed}"


@dataclass(frozen=True, eq=False)
class SeedResult:
    """Result of one learning run.

    Attributes:
        job: The run.
        policy: Policy kept.
        score: Its evaluation score.
        history: One array per column of the history.
        record: The run's record: commit, date, machine, steps, seconds.
    """

    job: LearnJob
    policy: Policy
    score: float
    history: Mapping[str, np.ndarray]
    record: RunRecord

    @property
    def kept(self) -> int:
        """Row of the history whose policy is kept.

        Raises:
            InputError: No evaluation has a score.
        """
        from metropilot.learn import kept_row

        row = kept_row(self.history, self.job.config.keep)
        if row is None:
            raise InputError("no evaluation has a score", field="run", value=self.job.run_id)
        return row

    @property
    def seconds(self) -> float:
        """Learning time without compilation."""
        return self.record.seconds

    @property
    def compile_seconds(self) -> float:
        """Compilation time of the call that finished the run."""
        return self.record.compile_seconds


def learn_seeds(
    jobs: Sequence[LearnJob],
    folder: Path,
    processes: int = 2,
    say: Callable[[str], object] = lambda line: None,  # noqa: ARG005 (silent)
) -> list[SeedResult]:
    """Do every learning run that is not yet finished in the folder.

    Args:
        jobs: The runs.
        folder: Parent of the runs' folders, each with checkpoint, history and policy.
        processes: Number of runs side by side, each in a single-threaded process.
        say: Called with a line of text whenever a run is done.

    Returns:
        One result per job, in the same order.

    Raises:
        InputError: A folder cannot be written or read, or two jobs share name and seed.
    """
    from joblib import Parallel, delayed

    names = [job.run_id for job in jobs]
    if len(set(names)) < len(names):
        raise InputError("two learning runs share name and seed", field="jobs")
    todo = [job for job in jobs if not is_done(job, folder)]
    if todo:
        say(f"{len(jobs) - len(todo)} of {len(jobs)} learning runs are there, {len(todo)} to do")
        with environment(ONE_THREAD):
            # of a single job joblib makes no process, and XLA does not survive Ctrl-C in this one
            pool: Any = Parallel(
                n_jobs=max(min(processes, len(todo)), 2),
                backend="loky",
                return_as="generator_unordered",
                batch_size=1,  # pyright: ignore[reportArgumentType]
                pre_dispatch=str(processes),
            )
            for number, line in enumerate(pool(delayed(_learn)(job, folder) for job in todo), 1):
                say(f"{number} of {len(todo)}: {line}")
    return [_read(job, folder) for job in jobs]


def read_seeds(jobs: Sequence[LearnJob], folder: Path) -> list[SeedResult]:
    """Read finished learning runs, in the order of the jobs, and learn nothing.

    Args:
        jobs: The runs.
        folder: Parent of the runs' folders.

    Raises:
        InputError: A run is not there, not finished, or of another seed, configuration or task.
    """
    for job in jobs:
        if not is_done(job, folder):
            raise InputError("no learning run is there", file=folder, field="run", value=job.run_id)
    return [_read(job, folder) for job in jobs]


def print_shipped(ship: Callable[[Path], Sequence[Path]]) -> None:
    """Ship policies from the folder on the command line and print their files; exit code 2 if refused."""
    if len(sys.argv) != 2:
        sys.exit("usage: python -m metropilot.studies.STUDY.ship FOLDER")
    try:
        sys.stdout.writelines(f"{path}\n" for path in ship(Path(sys.argv[1])))
    except InputError as error:
        sys.stderr.write(f"metropilot: {error}\n")
        sys.exit(2)


def is_done(job: LearnJob, folder: Path) -> bool:
    """True if the folder holds the finished learning run of the job."""
    record = _record(job, folder)
    return record is not None and record.status == "done"


def _record(job: LearnJob, folder: Path) -> RunRecord | None:
    """Record of a job's run; None if there is none, or if its seed, configuration or task differ."""
    from metropilot.learn import RECORD_FILE, config_to_mapping, read_record

    record = read_record(folder / job.run_id / RECORD_FILE)
    if record is None:
        return None
    plain = config_to_mapping(job.config)
    wanted = [job.config.algorithm, job.name, job.seed, plain, {**job.about, "name": job.name}]
    found = [record.algorithm, record.task, record.seed, record.config, record.about]
    wanted, found = (json.dumps(values, sort_keys=True) for values in (wanted, found))  # tuples are lists
    return record if wanted == found else None


def _learn(job: LearnJob, folder: Path) -> str:
    """Do one run in a worker process; return a line about it."""
    from metropilot.env import DrivingTask
    from metropilot.learn import CHECKPOINT_FILE, RunRequest, RunStore, TrainingOptions, begin_run, learn_run

    if current_process().name != "MainProcess":
        own_core()
    task, store = job.task(), RunStore(folder, indexed=False)
    interface = task.config.interface if isinstance(task, DrivingTask) else None
    request = RunRequest(job.config, task, job.name, job.seed, job.about, interface=interface)
    checkpoint = store.folder(job.run_id) / CHECKPOINT_FILE
    if _record(job, folder) is None:
        checkpoint.unlink(missing_ok=True)
        begin_run(store, request, job.run_id)
    evaluate = job.evaluation(task) if job.evaluation else None
    record, learned = learn_run(store, request, TrainingOptions(evaluate), resume=job.run_id)
    checkpoint.unlink(missing_ok=True)
    return f"{job.name} seed {job.seed}, score {learned.score:.4g}, {record.seconds:.0f} s"


def _read(job: LearnJob, folder: Path) -> SeedResult:
    from metropilot.learn import HISTORY_FILE, read_history, record_of
    from metropilot.policy import load_policy

    place = folder / job.run_id
    record, (policy, _) = record_of(place), load_policy(place / "policy.safetensors")
    score = float("-inf") if record.score is None else record.score
    history = read_history(place / HISTORY_FILE)
    return SeedResult(job, policy, score, history, record)


def write_policy(path: Path, result: SeedResult, command: str, **about: Any) -> Path:  # noqa: ANN401 (plain values)
    """Write the policy of a learning run on a driving task, so that every policy driver can load it.

    Args:
        path: File of the policy.
        result: The run; the KPIs written are those of the policy kept.
        command: Command that repeats the run.
        about: Further plain values of the file.
    """
    from metropilot._provenance import circumstances
    from metropilot.env import DrivingTask
    from metropilot.learn import config_to_mapping
    from metropilot.policy import save_policy

    job, task = result.job, result.job.task()
    if not isinstance(task, DrivingTask):
        raise TypeError("only a driving task has an interface for drivers")
    kept = result.kept
    kpis = {
        name.removeprefix("evaluation."): round(float(column[kept]), 4)
        for name, column in result.history.items()
        if name.startswith("evaluation.") and np.isfinite(column[kept])
    }
    told = {
        "perception": task.config.interface.as_dict(),
        "algorithm": job.config.algorithm,
        "config": config_to_mapping(job.config),
        "seed": job.seed,
        "kpis": kpis,
        "provenance": {"command": command} | circumstances(),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    save_policy(path, result.policy, told | about)
    return path


def drive_to_end(
    task: Any,  # noqa: ANN401 (a driving task)
    act: Callable[[Array, Array | None], Array],
    begin: tuple[Any, Array],
    key: Array,
    decisions: int,
    gain: Callable[[Any, Any, Any], Array] = lambda before, after, found: found.reward,  # noqa: ARG005
) -> tuple[Any, Array]:
    """Drive one episode to its end, compiled with the learner; the state stays as it was at the end.

    Args:
        task: The task.
        act: The policy: from an observation and a mask of choices to an action.
        begin: First state and observation.
        key: Key of the task's steps.
        decisions: Number of decisions, enough for any episode.
        gain: What a decision adds, from the states before and after it and its transition.

    Returns:
        The last state, and the sum of the gains.
    """
    import jax
    import jax.numpy as jnp

    def decide(carry: tuple[Any, Array, Array, Array], _: None) -> tuple[Any, None]:
        state, seen, going, total = carry
        after, found = task.step(key, state, act(seen, task.action_mask(state)))
        total = total + jnp.where(going, gain(state, after, found), 0.0)
        after = jax.tree.map(lambda new, old: jnp.where(going, new, old), after, state)
        return (after, found.observation, going & ~found.terminated & ~found.truncated, total), None

    first = (*begin, jnp.ones((), bool), jnp.zeros((), jnp.float32))
    (state, _, _, total), _ = jax.lax.scan(decide, first, None, length=decisions)
    return state, total
