"""Learning jobs: runs of the run store that report progress, stop at a checkpoint and can be resumed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from metropilot.web.store import JobStore

PROGRESS = "progress.jsonl"


def recipe_fields(asked: dict[str, Any]) -> dict[str, Any]:
    """The fields of a configuration that a learning job sets."""
    return {name: asked[name] for name in ("steps", "evaluations") if asked[name] is not None}


def learn_job(root: str, job: str, asked: dict[str, Any], run: str | None) -> dict[str, Any]:
    """Start a learning run, or resume one.

    Args:
        root: Folder of the server's data.
        job: Id of the job.
        asked: Fields of :class:`metropilot.web.schemas.requests.LearnIn`.
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
        resumed_request,
    )

    runs = RunStore(Path(root) / "runs")
    if run is not None:
        record = runs.show(run)
        request = resumed_request(record)
    else:
        what = {"budget": asked["budget"], "task": asked["task"], "seed": asked["seed"]}
        request = new_request(asked["driver"], **what, **recipe_fields(asked))
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
