"""Learning and study jobs: they report progress and can be resumed; learning stops at a checkpoint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from metropilot.web.store import JobStore

PROGRESS = "progress.jsonl"


def recipe_fields(body: dict[str, Any]) -> dict[str, Any]:
    """The fields of a configuration that a learning job sets."""
    return {name: body[name] for name in ("steps", "evaluations") if body[name] is not None}


def learn_job(root: str, job: str, body: dict[str, Any], run: str | None) -> dict[str, Any]:
    """Start a learning run, or resume one.

    Args:
        root: Folder of the server's data.
        job: Id of the job.
        body: Fields of :class:`metropilot.web.schemas.requests.LearnIn`.
        run: Id of the learning run to resume.
    """
    store = JobStore(Path(root))
    store.update(job, status="running", words="compiling")
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
        request = resume_request(record)
    else:
        what = {"budget": body["budget"], "task": body["task"], "seed": body["seed"]}
        request = new_request(body["driver"], **what, **recipe_fields(body))
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


def study_job(root: str, job: str, body: dict[str, Any]) -> dict[str, Any]:
    """Reproduce a study in a folder that a later job can resume; return its report as plain values."""
    store = JobStore(Path(root))
    store.update(job, status="running", words="beginning")
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
