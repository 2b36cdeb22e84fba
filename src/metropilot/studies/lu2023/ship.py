"""Shipping of the median seeds' policies: ``python -m metropilot.studies.lu2023.ship FOLDER``.

``FOLDER`` is the output of ``metropilot reproduce lu2023 --budget paper --out FOLDER``. The networks for all
plans become the drivers ``improved_dqn`` and ``dqn``; those of one plan belong to the study.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from metropilot.errors import InputError
from metropilot.policy import shipped_policy
from metropilot.studies.learning import print_shipped
from metropilot.studies.lu2023.drives import notch_front, policy_file
from metropilot.studies.lu2023.setting import PLANS, PlanCase
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot.studies.learning import SeedResult

MISSED = 10.0


def median_of(results: Sequence[SeedResult], plans: Sequence[PlanCase]) -> SeedResult:
    """Select the median seed by the distance from the optimum over the plans, demands first."""
    return sorted(results, key=lambda result: _shortfall(result, plans))[(len(results) - 1) // 2]


def _shortfall(result: SeedResult, plans: Sequence[PlanCase]) -> float:
    """Mean share above the optimum of the policy kept, plus ``MISSED`` for every demand not met."""
    total = 0.0
    for plan in plans:
        late, kwh, stop = (
            float(result.history[f"evaluation.{plan.id}.{name}"][result.kept])
            for name in ("late_s", "kwh", "stop_m")
        )
        total += kwh * J_PER_KWH / float(notch_front(plan).at(plan.scheduled_s + late)) - 1.0
        total += MISSED * (abs(late) > 2.9 or abs(stop) > 0.29)
    return total / len(plans)


def ship(folder: Path) -> list[Path]:
    """Copy the stored policies to the files of the drivers and of the study.

    Args:
        folder: The ``--out`` of the paper budget.

    Raises:
        InputError: The folder holds no policy of the study.
    """
    names = {f"improved_dqn-{plan.id}": policy_file(f"improved_dqn-{plan.id}") for plan in PLANS}
    names |= {f"{driver}-all": shipped_policy(driver) for driver in ("improved_dqn", "dqn")}
    found = {place: next(folder.rglob(f"{name}.safetensors"), None) for name, place in names.items()}
    shipped = []
    for place, source in found.items():
        if source is not None:
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, place)
            shipped.append(place)
    if not shipped:
        raise InputError("holds no policies of this study", file=folder, field="folder")
    return shipped


if __name__ == "__main__":
    print_shipped(ship)
