"""Ships what the paper budget has learned: ``python -m metropilot.studies.lu2023.ship FOLDER``.

``FOLDER`` is what ``metropilot reproduce lu2023 --budget paper --out FOLDER`` wrote. The networks for all
plans become the drivers ``improved_dqn`` and ``dqn``; those of one plan go with the study.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from metropilot.drivers.shipped import shipped_policy
from metropilot.errors import InputError
from metropilot.studies.lu2023.drives import policy_file
from metropilot.studies.lu2023.published import PLANS


def ship(folder: Path) -> list[Path]:
    """Copy the kept policies to where drivers and study read them.

    Args:
        folder: The ``--out`` of the paper budget.

    Raises:
        InputError: It holds none.
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
    for path in ship(Path(sys.argv[1])):
        sys.stdout.write(f"{path}\n")
