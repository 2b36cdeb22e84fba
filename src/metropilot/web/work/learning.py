"""Learning and study jobs: they report progress and can be resumed; learning stops at a checkpoint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from metropilot._schema import field_specs
from metropilot.env import TaskSite
from metropilot.errors import InputError
from metropilot.policy import POLICY_FILE
from metropilot.web.store import JobStore

PROGRESS = "progress.jsonl"
LARGEST_CHECKPOINT = 24_000_000
"""Size of a checkpoint, bytes, above which an archive has no files of the run: imported, it begins again."""


def recipe_fields(body: dict[str, Any]) -> dict[str, Any]:
    """The fields of a configuration that a learning job sets."""
    return {name: body[name] for name in ("steps", "evaluations") if body[name] is not None}


def _told(body: dict[str, Any]) -> dict[str, Any]:
    """Request of a learning job without its driver."""
    return {name: body[name] for name in ("budget", "task", "seed")} | recipe_fields(body)


def site_of(body: dict[str, Any]) -> TaskSite:
    """Line and trainset that a learning job names; one of before these fields names none."""
    return TaskSite(**{name: body.get(name) for name in field_specs(TaskSite)})


def learn_job(root: str, job: str, body: dict[str, Any], run: str | None) -> dict[str, Any]:
    """Start a learning run, or resume one.

    Args:
        root: Folder of the server's data.
        job: Id of the job.
        body: Fields of :class:`metropilot.web.schemas.requests.LearnIn`, files by their paths.
        run: Id of the learning run to resume.
    """
    store = JobStore(Path(root))
    store.begin(job, "compiling")
    from metropilot.learn import (
        RunStore,
        TrainingOptions,
        TrainingProgress,
        begin_run,
        evaluation_of,
        learn_run,
        new_request,
        resume_request,
    )

    runs = RunStore(Path(root) / "runs")
    if run is not None:
        record = runs.show(run)
        request = resume_request(record, runs.folder(record.id))
    else:
        request = new_request(body["driver"], site=site_of(body), **_told(body))
        record = begin_run(runs, request)
    store.update(job, run=record.id)
    told = runs.folder(record.id) / PROGRESS

    def progress(now: TrainingProgress) -> None:
        with told.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"steps": now.steps, **now.row}) + "\n")
        words = f"{now.steps:,} of {now.total_steps:,} steps, {now.rate:,.0f} steps/s".replace(",", " ")
        if "lessons" in now.row:
            words = f"{now.row['lessons']:.0%} of the demonstrations collected"
        store.update(job, progress=now.steps / now.total_steps, words=words)
        if store.stop_requested(job):
            raise KeyboardInterrupt

    sitting = TrainingOptions(evaluate=evaluation_of(request), on_progress=progress)
    try:
        record, learned = learn_run(runs, request, sitting, resume=record.id)
    except KeyboardInterrupt:
        return {"run": record.id, "stopped": True}
    return {"run": record.id, "stopped": False, "score": record.score, "seconds": learned.seconds}


def run_file_names(*, resumable: bool) -> tuple[str, ...]:
    """Names of the files of a learning run that an archive of a project holds.

    Args:
        resumable: True if the run may go on: with its checkpoint.
    """
    from metropilot.learn import CHECKPOINT_FILE, HISTORY_FILE, RECORD_FILE

    again = (CHECKPOINT_FILE, *TaskSite.copy_names()) if resumable else ()
    return (RECORD_FILE, PROGRESS, HISTORY_FILE, POLICY_FILE, *again)


def run_files(root: Path, run: str, *, resumable: bool) -> dict[str, bytes]:
    """Files of a learning run, by name; none of one whose checkpoint is too large to take along.

    Args:
        root: Folder of the server's data.
        run: Id of the run.
        resumable: True if the run may go on.
    """
    paths = [root / "runs" / run / name for name in run_file_names(resumable=resumable)]
    found = [path for path in paths if path.is_file()]
    if resumable and any(path.stat().st_size > LARGEST_CHECKPOINT for path in found):
        return {}
    return {path.name: path.read_bytes() for path in found}


def check_run(folder: str, body: dict[str, Any], resumable: bool) -> bool:
    """Check the files of a learning run that come from elsewhere.

    Args:
        folder: Folder of the run.
        body: Fields of its :class:`metropilot.web.schemas.requests.LearnIn`.
        resumable: True if it may go on.

    Returns:
        False if it may go on, but its request stands for another configuration here: it has to begin again.

    Raises:
        InputError: One of them cannot be used.
    """
    from metropilot.learn import HISTORY_FILE, read_history, recipe, record_of, resume_request
    from metropilot.policy import load_driving_policy

    path = Path(folder)
    record = record_of(path)
    if (path / PROGRESS).exists():
        try:
            rows = [json.loads(line) for line in (path / PROGRESS).read_text("utf-8").splitlines()]
            if not all(isinstance(row, dict) and isinstance(row["steps"], int | float) for row in rows):
                raise ValueError("not a row of numbers")
        except (ValueError, KeyError, RecursionError) as error:
            raise InputError("not a history", file=PROGRESS, value=str(error)[:80]) from None
    if (path / HISTORY_FILE).exists():
        read_history(path / HISTORY_FILE)
    if (path / POLICY_FILE).exists():
        load_driving_policy(path / POLICY_FILE)
    if not resumable:
        return True
    row = recipe(body["driver"])
    known, site = resume_request(record, path), site_of(body)
    # its files are copies under other names: that it has some is all that can be compared
    told = (row.configuration(body["budget"], **recipe_fields(body)), body["task"] or row.task, body["seed"])
    asked = (*told, body["driver"], list(site.values()), site.sections, site.load)
    there = (known.config, known.name, known.seed, known.driver)
    return asked == (*there, list(known.site.values()), known.site.sections, known.site.load)


def keep_run(root: Path, run: str) -> None:
    """Put a learning run whose folder was written into the index."""
    from metropilot.learn import RunStore, record_of

    store = RunStore(root / "runs")
    record = record_of(store.folder(run))
    store.update(record, status="interrupted" if record.status == "running" else record.status)


def study_job(root: str, job: str, body: dict[str, Any]) -> dict[str, Any]:
    """Reproduce a study in a folder that a later job can resume; return its report as plain values."""
    store = JobStore(Path(root))
    store.begin(job, "beginning")
    from metropilot import studies

    study = studies.STUDIES.get(body["study"])
    folder = Path(root) / "studies" / f"{body['study']}-{body['budget']}"
    said = 0

    def say(line: str) -> None:
        nonlocal said
        said += 1
        store.update(job, words=str(line)[:200], progress=1.0 - 1.0 / (1.0 + 0.2 * said))

    budget = studies.check_budget(body["budget"])
    order = studies.Order(folder=folder / "runs", budget=budget, processes=1, say=say)
    report = studies.reproduce(body["study"], order)
    studies.write_report(folder, study, report)
    return report.as_dict()
