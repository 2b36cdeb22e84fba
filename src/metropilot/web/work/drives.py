"""Drives and comparisons."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

from metropilot import evaluate
from metropilot._io import atomic_write
from metropilot.sim import COLUMNS, Drive, drive
from metropilot.web.store import JobStore
from metropilot.web.work.plans import numbers, plan_out


def drive_out(
    driven: Drive, kpis: evaluate.Kpis, optimum: evaluate.Optimum | None, explanation: evaluate.Explanation
) -> dict[str, Any]:
    """Convert a drive to plain values."""
    return {
        "driver": driven.driver,
        "success": kpis.success,
        "kpis": kpis.as_dict(),
        "checks": [check._asdict() for check in evaluate.checks(kpis)],
        "columns": {name: numbers(getattr(driven.trajectory, name), 4) for name in COLUMNS},
        "explanation": explanation.as_dict(),
        "plan": None if optimum is None else plan_out(optimum.plan, optimum.minimum_time_s),
    }


def drive_job(root: str, job: str, request: evaluate.RunSpec) -> dict[str, Any]:
    """Drive one run and write its files into the job's folder."""
    store = JobStore(Path(root))
    store.begin(job, "driving")
    driven = drive(request.run(), request.make_driver())
    store.update(job, progress=0.6, words="comparing with the optimum")
    optimum = evaluate.optimum_of(driven, request.objective)
    kpis = evaluate.kpis_of(driven, optimum, request.objective)
    store.update(job, progress=0.7, words="explaining")
    explanation = explain(request, driven, optimum)
    store.update(job, progress=0.8, words="drawing")
    evaluate.write_run(folder_of(root, job), request, driven, kpis, optimum, explanation)
    return drive_out(driven, kpis, optimum, explanation)


def explain(
    request: evaluate.RunSpec, driven: Drive, optimum: evaluate.Optimum | None
) -> evaluate.Explanation:
    """Explain a drive with the prices of time and the features of a learned driver.

    Args:
        request: Its request, with the updates that were sent during the run.
        driven: The drive.
        optimum: The plan it is compared with.
    """
    again = replace(driven, run=request.run())
    return evaluate.explain_drive(again, optimum, driver=request.make_driver(), objective=request.objective)


def compare_job(
    root: str, job: str, request: evaluate.RunSpec, drivers: dict[str, str], seeds: int
) -> dict[str, Any]:
    """Drive the same run with several drivers and seeds.

    Args:
        root: Folder of the server's data.
        job: Id of the job.
        request: The run.
        drivers: Drivers for :func:`metropilot.evaluate.compare`, by display name.
        seeds: Drives of each driver.
    """
    store = JobStore(Path(root))
    store.begin(job, "driving")
    todo = evaluate.jobs(list(drivers.values()), request.seed, seeds)
    shown = {taken: name for name, taken in drivers.items()}

    def with_progress() -> Any:  # noqa: ANN401 (a generator of jobs)
        for k, item in enumerate(todo):
            words = shown[item.driver] + (f", seed {item.seed}" if seeds > 1 else "")
            store.update(job, progress=k / (len(todo) + 1), words=words)
            yield item

    driven = evaluate.compare(replace(request, options={}), with_progress())
    entries = [replace(entry, driver=shown[entry.driver]) for entry in driven]
    store.update(job, progress=0.95, words="drawing")
    evaluate.write_comparison(folder_of(root, job), request, entries)
    spread = {row["driver"]: row["kpis"] for row in evaluate.comparison_json(request, entries)["drivers"]}
    found = [
        {
            "driver": e.driver,
            "successes": e.successes,
            "seeds": len(e.drives),
            "outcomes": [k.outcome for k in e.kpis],
            "ended": [evaluate.outcome_words(k) for k in e.kpis],
            "kpis": spread[e.driver],
            "drive": drive_out(
                e.drives[0], e.kpis[0], e.optimum, evaluate.explain_drive(e.drives[0], e.optimum, moments=0)
            ),
        }
        for e in entries
    ]
    return {"entries": found}


def archive(folder: Path) -> Path:
    """Make `trajectories.zip` in a convoy's folder, with every trainset's trajectory, if it is missing."""
    path, found = folder / "trajectories.zip", sorted(folder.glob("trajectory-*.csv"))
    if found and not path.exists():

        def write(partial: Path) -> None:
            with ZipFile(partial, "w", ZIP_DEFLATED) as made:
                for each in found:
                    made.write(each, each.name)

        atomic_write(path, write)
    return path


def folder_of(root: str, job: str) -> Path:
    """Folder of a job's files."""
    return Path(root) / "jobs" / job
