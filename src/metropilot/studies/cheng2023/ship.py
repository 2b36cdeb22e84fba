"""Shipping of a learned policy as that of the driver ``ddpg_pid``.

``python -m metropilot.studies.cheng2023.ship DIR``; ``DIR`` is the folder with the learning runs of
``metropilot reproduce cheng2023 --budget paper``. It selects the policy with the fewest interventions of
protection on real sections under plant mismatch, and among equals the one with the best score.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from metropilot._provenance import circumstances
from metropilot.control import Errors
from metropilot.policy import Policy, save_policy, shipped_policy
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Run, drive
from metropilot.studies.cheng2023.ddpg_pid import GAINS_OBSERVATION, DdpgPid, DdpgPidOptions, step_ddpg_pid
from metropilot.studies.cheng2023.learning import REWARDS, SEEDS, config, jobs
from metropilot.studies.cheng2023.setting import course
from metropilot.studies.cheng2023.tracking import track_course, tracking_kpis
from metropilot.studies.learning import SeedResult, learn_seeds

SECTIONS = (("JHL", "CQN"), ("XHM", "JG"), ("RJ", "WYJ"))
UNKNOWN = Disturbance(resistance_factor=1.5, delay_s=0.6, lag_s=0.4, speed_noise_mps=0.05)


def count_interventions(policy: Policy) -> int:
    """Count the interventions of protection with a policy as driver of the Yizhuang line."""
    with TemporaryDirectory() as folder:
        place = Path(folder, "policy.safetensors")
        save_policy(place, policy, {"observed": list(GAINS_OBSERVATION)})
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
    results = learn_seeds(jobs(range(SEEDS)), folder)
    chosen = min(results, key=lambda result: (count_interventions(result.policy), -result.score))
    what = course()
    record = track_course(what, lambda held, seen: step_ddpg_pid(chosen.policy, seen, held), Errors(0.0, 0.0))
    kpis = tracking_kpis(what, record)._asdict()
    from metropilot.learn import config_to_mapping

    about = {
        "observed": list(GAINS_OBSERVATION),
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
