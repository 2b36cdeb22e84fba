"""From learning runs to the policies that are kept: the best seed, with all that a driver must know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot.studies.lu2023.optima import notch_front
from metropilot.studies.lu2023.published import PlanCase

if TYPE_CHECKING:
    from metropilot.studies.learning import SeedResult

MISSED = 10.0


def best_of(results: Sequence[SeedResult], plans: Sequence[PlanCase]) -> SeedResult:
    """The seed whose policy comes nearest the optimum over the plans, demands met first."""
    return min(results, key=lambda result: _shortfall(result, plans))


def _shortfall(result: SeedResult, plans: Sequence[PlanCase]) -> float:
    """Mean share above the optimum at the evaluation the policy is from; much where a demand is missed."""
    kept = int(np.argmax(result.history["evaluation.score"]))
    total = 0.0
    for plan in plans:
        late, kwh, stop = (
            float(result.history[f"evaluation.{plan.id}.{name}"][kept])
            for name in ("late_s", "kwh", "stop_m")
        )
        total += kwh * 3.6e6 / float(notch_front(plan).at(plan.scheduled_s + late)) - 1.0
        total += MISSED * (abs(late) > 2.9 or abs(stop) > 0.29)
    return total / len(plans)


COMMAND = "metropilot reproduce lu2023 --budget paper"


def keep_policy(path: Path, result: SeedResult, plans: Sequence[PlanCase], command: str = COMMAND) -> None:
    """Write a policy with its perception, so that any driver of policies drives it."""
    from metropilot.policy.file import save_policy
    from metropilot.studies.circumstances import circumstances

    job = result.job
    kept = int(np.argmax(result.history["evaluation.score"]))
    kpis = {
        name.removeprefix("evaluation."): round(float(column[kept]), 4)
        for name, column in result.history.items()
        if name.startswith("evaluation.")
    }
    config: Any = job.config
    about = {
        "perception": job.task().config.perception.as_dict(),  # pyright: ignore[reportAttributeAccessIssue]
        "task": "lu2023",
        "plans": [plan.id for plan in plans],
        "algorithm": config.algorithm,
        "config": asdict(config),
        "seed": job.seed,
        "kpis": kpis,
        "provenance": {"command": command} | circumstances(),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    save_policy(path, result.policy, about)
