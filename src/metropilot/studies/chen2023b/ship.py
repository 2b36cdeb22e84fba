"""Shipping of the followers' policies, the median seeds: ``python -m metropilot.studies.chen2023b.ship DIR``.

``DIR`` is the output of ``metropilot reproduce chen2023b --budget paper --out DIR``.
"""

from __future__ import annotations

from pathlib import Path

from metropilot.policy import load_policy, save_policy, shipped_policy
from metropilot.studies.chen2023b.learning import NAMES, jobs
from metropilot.studies.chen2023b.study import median_of
from metropilot.studies.learning import print_shipped, read_seeds

COMMAND = "metropilot reproduce chen2023b --budget paper"
SEEDS, ETA, RUNS = 10, "soft", "runs"
LEARNED = ("algorithm", "config", "seed", "score", "kpis", "provenance")
"""What a learning run says of its policy; what the network observes and does stays as shipped."""


def ship(folder: Path) -> list[Path]:
    """Write the median seed's policy of each follower that learns.

    Args:
        folder: Output of the study.

    Raises:
        InputError: The folder lacks a learning run.
    """
    shipped = []
    for algorithm, follower in NAMES.items():
        runs = read_seeds(jobs(algorithm, "paper", ETA, range(SEEDS)), folder / RUNS)
        chosen = runs[median_of(runs)]
        path = shipped_policy(follower)
        _, about = load_policy(path)
        _, learned = load_policy(folder / RUNS / chosen.job.run_id / path.with_stem("policy").name)
        about |= {name: learned[name] for name in LEARNED}
        about["provenance"] = {**learned["provenance"], "command": COMMAND}
        save_policy(path, chosen.policy, about)
        shipped.append(path)
    return shipped


if __name__ == "__main__":
    print_shipped(ship)
