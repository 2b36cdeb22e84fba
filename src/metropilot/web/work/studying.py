"""Study jobs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from metropilot.web.store import JobStore


def study_job(root: str, job: str, asked: dict[str, Any]) -> dict[str, Any]:
    """Reproduce a study in a folder that a later job can resume; return its report as plain values."""
    store = JobStore(Path(root))
    store.update(job, status="running", words="beginning")
    from metropilot import studies

    study = studies.STUDIES.get(asked["study"])
    folder = Path(root) / "studies" / f"{asked['study']}-{asked['budget']}"
    said = 0

    def say(line: str) -> None:
        nonlocal said
        said += 1
        store.update(job, words=str(line)[:200], progress=1.0 - 1.0 / (1.0 + 0.2 * said))

    budget = studies.check_budget(asked["budget"])
    order = studies.Order(folder=folder / "runs", budget=budget, processes=1, say=say)
    report = studies.reproduce(asked["study"], order)
    studies.write_report(folder, study, report)
    return report.as_dict()
