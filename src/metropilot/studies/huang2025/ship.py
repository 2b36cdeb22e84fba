"""Shipping of the median seeds' policies: ``python -m metropilot.studies.huang2025.ship DIR``.

``DIR`` is the output of ``metropilot reproduce huang2025 --budget paper --out DIR``.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from metropilot.policy import shipped_policy
from metropilot.studies.huang2025.learning import jobs, write_result
from metropilot.studies.huang2025.setting import LEARNED
from metropilot.studies.learning import print_shipped, read_seeds

SEEDS, RUNS = 10, Path("runs", "huang2025")


def ship(folder: Path) -> list[Path]:
    """Write the policy of each learned driver with the median score.

    Args:
        folder: Output of the study.

    Raises:
        InputError: The folder lacks a learning run.
    """
    shipped = []
    results = read_seeds(jobs(range(SEEDS), "paper"), folder / RUNS)
    for driver in LEARNED:
        mine = [result for result in results if result.job.about["driver"] == driver]
        chosen = sorted(mine, key=lambda result: result.score)[(len(mine) - 1) // 2]
        path = shipped_policy(driver)
        shutil.copyfile(write_result(folder / RUNS, chosen), path)
        shipped.append(path)
    return shipped


if __name__ == "__main__":
    print_shipped(ship)
