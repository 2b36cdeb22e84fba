"""Put a learned policy where the driver ``ddpg_pid`` finds it.

``python -m metropilot.studies.cheng2023.ship DIR``, where ``DIR`` is the folder in which ``metropilot
reproduce cheng2023 --budget paper`` kept its learning runs; of their policies the one with the median score
is taken.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from metropilot.drivers.ddpg_pid import OBSERVED, ddpg_pid
from metropilot.drivers.policy import save_policy
from metropilot.drivers.shipped import shipped_policy
from metropilot.evaluate.tracking import track, tracking_kpis
from metropilot.studies.cheng2023.courses import course
from metropilot.studies.cheng2023.learning import REWARDS, config
from metropilot.studies.cheng2023.reproduce import SEEDS, jobs
from metropilot.studies.circumstances import circumstances
from metropilot.studies.learning import SeedResult, learn_seeds
from metropilot.task.incremental_pid import Errors


def ship(folder: Path, target: Path) -> SeedResult:
    """Write the policy with the median score of the study's seeds.

    Args:
        folder: The learning runs; those that are missing are done now.
        target: The policy's file.
    """
    results = learn_seeds(jobs(range(SEEDS)), folder)
    chosen = sorted(results, key=lambda result: result.score)[len(results) // 2]
    what = course()
    record = track(what, lambda held, seen: ddpg_pid(chosen.policy, seen, held), Errors(0.0, 0.0))
    kpis = tracking_kpis(what, record)._asdict()
    from metropilot.learn import config_to_mapping

    about = {
        "observed": list(OBSERVED),
        "task": {"name": "cheng2023", "reference": "s_curve", "rewards": repr(REWARDS)},
        "algorithm": config().algorithm,
        "config": config_to_mapping(config()),
        "seed": chosen.job.seed,
        "score": chosen.score,
        "kpis": {name: round(float(np.asarray(value)), 6) for name, value in kpis.items()},
        "provenance": {"command": "metropilot reproduce cheng2023 --budget paper", **circumstances()},
    }
    save_policy(target, chosen.policy, about)
    return chosen


if __name__ == "__main__":
    ship(Path(sys.argv[1]), shipped_policy("ddpg_pid"))
