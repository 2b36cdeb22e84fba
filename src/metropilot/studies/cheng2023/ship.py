"""Shipping of learned policies: that of the driver ``ddpg_pid``, and that of the residual in the study.

``python -m metropilot.studies.cheng2023.ship DIR``; ``DIR`` is the folder with the learning runs of
``metropilot reproduce cheng2023 --budget paper``. Of the gains it selects the policy with the fewest
interventions of protection on real sections under plant mismatch, and among equals the one with the best
score; of the corrections the median seed.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from metropilot._provenance import circumstances
from metropilot.policy import Policy, save_policy, shipped_policy
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Run, drive
from metropilot.studies.cheng2023 import learning
from metropilot.studies.cheng2023.ddpg_pid import DdpgPid, DdpgPidOptions
from metropilot.studies.cheng2023.drives import TUNED_FED_PID, policy_control
from metropilot.studies.cheng2023.law import PAPER_LAW, TrackingLaw
from metropilot.studies.cheng2023.residual import CORRECTIONS
from metropilot.studies.cheng2023.setting import course
from metropilot.studies.cheng2023.tracking import track_course, tracking_kpis
from metropilot.studies.learning import SeedResult, learn_seeds

SECTIONS = (("JHL", "CQN"), ("XHM", "JG"), ("RJ", "WYJ"))
UNKNOWN = Disturbance(resistance_factor=1.5, delay_s=0.6, lag_s=0.4, speed_noise_mps=0.05)


def count_interventions(policy: Policy) -> int:
    """Count the interventions of protection with a policy as driver of the Yizhuang line."""
    with TemporaryDirectory() as folder:
        place = Path(folder, "policy.safetensors")
        save_policy(place, policy, {"observed": list(PAPER_LAW.observed)})
        driver, line, trainset = (
            DdpgPid(DdpgPidOptions(policy=str(place))),
            load_line("yizhuang"),
            load_trainset("dkz32"),
        )
        found = 0
        for ends in SECTIONS:
            section = line.section(*ends)
            if section.planned_time_s is None:
                continue
            run = Run(section, trainset, section.planned_time_s, UNKNOWN, seed=1)
            found += drive(run, driver).interventions
        return found


def ship(folder: Path, target: Path) -> SeedResult:
    """Write the policy with the fewest interventions on sections outside its training.

    Args:
        folder: Folder of the learning runs; missing ones are done now.
        target: File of the policy.
    """
    results = learn_seeds(learning.jobs(range(learning.SEEDS)), folder)
    chosen = min(results, key=lambda result: (count_interventions(result.policy), -result.score))
    _write(target, chosen, PAPER_LAW, {"reference": "s_curve", "rewards": repr(learning.REWARDS)})
    return chosen


def ship_corrections(folder: Path, target: Path) -> SeedResult:
    """Write the policy of the residual with the median score.

    Args:
        folder: Folder of the learning runs; missing ones are done now.
        target: File of the policy.
    """
    results = learn_seeds(learning.residual_jobs(range(learning.SEEDS)), folder)
    chosen = sorted(results, key=lambda result: result.score)[len(results) // 2]
    said = {"reference": "drawn", "rewards": repr(learning.RESIDUAL_REWARDS), "corrects": dict(TUNED_FED_PID)}
    _write(target, chosen, learning.corrections_law(), said)
    return chosen


def _write(target: Path, chosen: SeedResult, law: TrackingLaw, said: Mapping[str, Any]) -> None:
    """Write a policy with what it came of and its KPIs in the base scenario."""
    from metropilot.learn import config_to_mapping

    what = course()
    kpis = tracking_kpis(what, track_course(what, *policy_control(law, chosen.policy)))._asdict()
    about = {
        "observed": list(law.observed),
        "task": {"name": "cheng2023", **said},
        "algorithm": chosen.job.config.algorithm,
        "config": config_to_mapping(chosen.job.config),
        "seed": chosen.job.seed,
        "score": chosen.score,
        "kpis": {name: round(float(np.asarray(value)), 6) for name, value in kpis.items()},
        "provenance": {"command": "metropilot reproduce cheng2023 --budget paper", **circumstances()},
    }
    save_policy(target, chosen.policy, about)


if __name__ == "__main__":
    ship(Path(sys.argv[1]), shipped_policy("ddpg_pid"))
    ship_corrections(Path(sys.argv[1]), CORRECTIONS)
