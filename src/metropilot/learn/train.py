"""Learning into a run folder: everything that is needed to show, resume and drive what was learned."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from metropilot._io import hold_lock
from metropilot.env import DrivingTask, PolicyInterface
from metropilot.env.interface import AbstractTask
from metropilot.errors import InputError
from metropilot.learn.config import TeacherConfig
from metropilot.learn.config_base import AbstractConfig
from metropilot.learn.evaluation import kpis_kept, kpis_of_row
from metropilot.learn.history import write_history
from metropilot.learn.runs import RunRecord, RunStore
from metropilot.learn.session import TrainingOptions, TrainingProgress, TrainingResult, learn_in_chunks
from metropilot.learn.tensorboard import EventWriter
from metropilot.policy.file import save_policy
from metropilot.policy.loaded import FILE as POLICY_FILE


@dataclass(frozen=True)
class RunRequest:
    """What is to be learned.

    Attributes:
        config: Which learner and what it is told.
        task: What it learns.
        name: The task in a word.
        seed: Of everything random.
        about: What identifies the task: line, section, trainset.
        tensorboard: Also write event files.
        driver: Id of the driver that is learned; empty where it has none.
        perception: What a driver must know to use the policy; None: it cannot be driven.
        command: The command line that asks for it.
    """

    config: AbstractConfig
    task: AbstractTask
    name: str
    seed: int = 0
    about: Mapping[str, Any] | None = None
    tensorboard: bool = False
    driver: str = ""
    perception: PolicyInterface | None = None
    command: str = ""


def learn_run(
    store: RunStore, request: RunRequest, sitting: TrainingOptions | None = None, resume: str | None = None
) -> tuple[RunRecord, TrainingResult]:
    """Learn into a run folder, or go on with one that was stopped.

    Args:
        store: Where the runs are.
        request: What is to be learned.
        sitting: Evaluation, progress and how often to save; its paths are replaced by the folder's.
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
        return _learn(store, request, sitting or TrainingOptions(), record, resume=bool(resume))


def begin_run(store: RunStore, request: RunRequest, run_id: str | None = None) -> RunRecord:
    """A new run's folder and record; :func:`learn_run` then goes on with it.

    Raises:
        InputError: The folder cannot be written.
    """
    more = {"driver": request.driver, "command": request.command} | ({"id": run_id} if run_id else {})
    return store.create(request.config, request.name, request.seed, _about(request), **more)


def _about(request: RunRequest) -> dict[str, Any]:
    """What identifies the task."""
    return dict(request.about or {}) | {"name": request.name}


def _learn(
    store: RunStore, request: RunRequest, given: TrainingOptions, record: RunRecord, *, resume: bool
) -> tuple[RunRecord, TrainingResult]:
    """The learning itself, with the folder's lock held."""
    folder, about = store.folder(record.id), _about(request)
    events = EventWriter(folder) if request.tensorboard else None
    before, record = record, store.update(record, status="running")
    reached: dict[str, Any] = {}

    def progress(now: TrainingProgress) -> None:
        reached.update(steps=now.steps, seconds=now.seconds, kpis=kpis_of_row(now.row))
        store.update(record, **reached)
        if events:
            events.write(now.steps, now.row)
        if given.on_progress:
            given.on_progress(now)

    checkpoint = folder / "checkpoint.safetensors"
    whole = replace(given, on_progress=progress, checkpoint=checkpoint, resume=resume, about=about)
    try:
        learned = _learned(request, whole)
    except InputError:
        store.save(before)
        raise
    except BaseException as error:
        status = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
        store.update(record, status=status, **reached)
        raise
    finally:
        if events:
            events.close()
    write_history(folder / "history.parquet", learned.history)
    finite = learned.score if math.isfinite(learned.score) else None
    steps = int(learned.history["steps"][-1])
    kpis = kpis_kept(learned.history, request.config.keep)
    done: dict[str, Any] = {"status": "done", "score": finite, "seconds": learned.seconds}
    record = replace(record, **done, steps=steps, kpis=kpis)
    save_policy(folder / POLICY_FILE, learned.policy, policy_about(record, request.perception))
    store.save(record)
    return record, learned


def _learned(request: RunRequest, sitting: TrainingOptions) -> TrainingResult:
    """By the learner, or by the teacher."""
    if isinstance(request.config, TeacherConfig) and isinstance(request.task, DrivingTask):
        from metropilot.learn.imitation.course import teach_in_parts

        return teach_in_parts(request.config, request.task, request.seed, sitting)
    return learn_in_chunks(request.config, request.task, request.seed, sitting)


def policy_about(record: RunRecord, perception: PolicyInterface | None) -> dict[str, Any]:
    """What a policy file says of itself: all that a driver needs, and where it comes from."""
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
    return about | ({"perception": perception.as_dict()} if perception else {})
