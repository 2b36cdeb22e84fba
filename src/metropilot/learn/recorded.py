"""Learning into a run folder: everything that is needed to show, resume and drive what was learned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from metropilot.drivers.policy.policy_file import save_policy
from metropilot.errors import InputError
from metropilot.learn.config_base import AbstractConfig
from metropilot.learn.history import write_history
from metropilot.learn.runs import RunRecord, RunStore
from metropilot.learn.session import Learned, Progress, Sitting, learn_in_chunks
from metropilot.learn.tensorboard import EventWriter
from metropilot.task.interface import AbstractTask


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
    """

    config: AbstractConfig
    task: AbstractTask
    name: str
    seed: int = 0
    about: Mapping[str, Any] | None = None
    tensorboard: bool = False


def learn_run(
    store: RunStore, request: RunRequest, sitting: Sitting | None = None, resume: str | None = None
) -> tuple[RunRecord, Learned]:
    """Learn into a run folder, or go on with one that was stopped.

    Args:
        store: Where the runs are.
        request: What is to be learned.
        sitting: Evaluation, progress and how often to save; its paths are replaced by the folder's.
        resume: Id of the run to go on with; None begins a new one.

    Raises:
        InputError: No such run, or it was of another configuration, task or seed.
    """
    about = dict(request.about or {}) | {"name": request.name}
    record = store.show(resume) if resume else store.create(request.config, request.name, request.seed, about)
    if resume and record.task != request.name:
        raise InputError(
            "the run learned another task", field="task", value=request.name, allowed=record.task
        )
    folder = store.folder(record.id)
    given = sitting or Sitting()
    events = EventWriter(folder) if request.tensorboard else None
    reached = {"steps": record.steps, "seconds": record.seconds}

    def progress(now: Progress) -> None:
        reached.update(steps=now.steps, seconds=now.seconds)
        if events:
            events.write(now.steps, now.row)
        if given.on_progress:
            given.on_progress(now)

    checkpoint = folder / "checkpoint.safetensors"
    whole = replace(given, on_progress=progress, checkpoint=checkpoint, resume=bool(resume), about=about)
    before, record = record, store.update(record, status="running")
    try:
        learned = learn_in_chunks(request.config, request.task, request.seed, whole)
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
    metadata = {"run": record.id, "algorithm": record.algorithm, "seed": record.seed, "task": about}
    metadata |= {"commit": record.commit_id, "versions": dict(record.versions), "config": dict(record.config)}
    finite = learned.score if abs(learned.score) < float("inf") else None
    save_policy(folder / "policy.safetensors", learned.policy, metadata | {"score": finite})
    steps = int(learned.history["steps"][-1])
    record = store.update(record, status="done", score=finite, seconds=learned.seconds, steps=steps)
    return record, learned
