"""The study: figures 3 to 9, and what the paper left open."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot.drivers.followers import FOLLOWERS, AbstractFollower
from metropilot.drivers.followers.learned import FollowPolicyOptions
from metropilot.evaluate.convoy_drive import ConvoyDrive, drive_convoy
from metropilot.studies.chen2023b import figures
from metropilot.studies.chen2023b.beyond import campaign_rows, capacity_rows, rough_rows, stability
from metropilot.studies.chen2023b.learning import ETAS, NAMES, jobs
from metropilot.studies.chen2023b.remarks import DEVIATIONS, remarks
from metropilot.studies.chen2023b.setting import PUBLISHED, SIMPLE, head_run, pair
from metropilot.studies.report import Figure, Report, Row
from metropilot.studies.study import Order, Study

if TYPE_CHECKING:
    from metropilot.studies.learning import SeedResult

WORDS = {
    "gap_min_m": ("smallest gap", "m"),
    "gap_max_m": ("largest gap", "m"),
    "speed_difference_max_mps": ("largest speed difference", "m/s"),
}
CASE = "2 trainsets, YZQ–WHY"


def reproduce(order: Order) -> Report:
    """Figures 3 to 9 and beyond; quick: figures 7 to 9 with the shipped policies, nothing learned."""
    from metropilot.studies.learning import learn_seeds

    seeds = order.choose_seeds(quick=1, paper=5)
    eta = order.options["eta"]
    runs: dict[str, list[SeedResult]] = {}
    if not _shipped(order):
        todo = [job for algorithm in NAMES for job in jobs(algorithm, order.budget, eta, seeds)]
        found = learn_seeds(todo, order.folder, order.processes, order.say)
        for k, algorithm in enumerate(NAMES):
            runs[algorithm] = list(found[k * len(seeds) : (k + 1) * len(seeds)])
    drivers = _drivers(order, runs)
    order.say("driving")
    drives = {name: [_driven(each) for each in each_seed] for name, each_seed in drivers.items()}
    rows = [row for name, each in drives.items() for row in _rows(name, each)]
    rows += _learning_rows(runs, order.budget)
    first = {name: each[0] for name, each in drivers.items()}
    shown = {name: each[0] for name, each in drives.items()}
    rows += rough_rows(first, (2, 4, 8) if order.budget == "paper" else (2,))
    gains = stability(first, 5)
    rows += _stability_rows(gains)
    order.say("attacking")
    rows += campaign_rows(order.budget) + capacity_rows()
    return Report(
        study="chen2023b",
        title=STUDY.title,
        budget=order.budget,
        seeds=len(seeds),
        seconds=0.0,
        rows=rows,
        figures=_figures(runs, shown, gains),
        deviations=DEVIATIONS,
        remarks=remarks(rows),
    )


def _shipped(order: Order) -> bool:
    """Whether the shipped policies drive: in the quick study with its own eta."""
    there = all(name in FOLLOWERS.ids() for name in NAMES.values())
    return order.budget == "quick" and order.options["eta"] == "soft" and there


def _drivers(order: Order, runs: dict[str, list[SeedResult]]) -> dict[str, list[AbstractFollower]]:
    """Every follower: learned ones as shipped, or one a seed; the others once."""
    from metropilot.drivers.followers.ddpg_pid_follow import DdpgPidFollow
    from metropilot.drivers.followers.sac_pid import SacPid

    kinds: dict[str, Any] = {"sac": SacPid, "ddpg": DdpgPidFollow}
    made: dict[str, list[AbstractFollower]] = {}
    for algorithm, name in NAMES.items():
        paths = [""] if _shipped(order) else [str(_folder(order.folder, run)) for run in runs[algorithm]]
        made[name] = [kinds[algorithm](FollowPolicyOptions(path)) for path in paths]
    return made | {name: [FOLLOWERS.make(name)] for name in SIMPLE}


def _folder(root: Path, run: SeedResult) -> Path:
    return root / f"{run.job.name}-{run.job.seed}"


def _driven(follower: AbstractFollower) -> ConvoyDrive:
    return drive_convoy(pair(), head_run(), follower)


def _rows(name: str, drives: Sequence[ConvoyDrive]) -> list[Row]:
    """Figures 8 and 9 in numbers."""
    values = {
        "gap_min_m": [drive.gap_m.min() for drive in drives],
        "gap_max_m": [drive.gap_m.max() for drive in drives],
        "speed_difference_max_mps": [np.abs(drive.speed_difference_mps).max() for drive in drives],
    }
    rows = []
    for key, measured in values.items():
        published = PUBLISHED[key] if name == "sac_pid" else None
        rows.append(Row("Figs. 7 to 9", CASE, name, *WORDS[key], published=published).measured(measured))
    overruled = [float(sum(drive.interventions)) for drive in drives]
    return [*rows, Row("Figs. 7 to 9", CASE, name, "interventions of protection", "").measured(overruled)]


def _learning_rows(runs: dict[str, list[SeedResult]], budget: str) -> list[Row]:
    """What learning took and came to."""
    rows = []
    for algorithm, each in runs.items():
        name, table = NAMES[algorithm], "Figs. 3 to 6"
        rows += [
            Row(table, budget, name, "mean largest gap error behind 24 heads", "m").measured(
                float(np.nanmin(run.history["evaluation.gap_error_m"])) for run in each
            ),
            Row(table, budget, name, "learning time, one core", "s").measured(run.seconds for run in each),
        ]
    return rows


def _stability_rows(gains: dict[str, tuple[np.ndarray, np.ndarray]]) -> list[Row]:
    return [
        Row(
            "Beyond the paper: string stability",
            "5 trainsets, no protection, swings of 4 to 40 s",
            name,
            "largest gain of speed from one trainset to the next",
            "",
        ).measured([float((values[:, 1:] / values[:, :-1]).max())])
        for name, (_, values) in gains.items()
    ]


def _figures(
    runs: dict[str, list[SeedResult]],
    drives: dict[str, ConvoyDrive],
    gains: dict[str, tuple[np.ndarray, np.ndarray]],
) -> list[Figure]:
    histories = {NAMES[algorithm]: [run.history for run in each] for algorithm, each in runs.items()}
    losses = {"sac_pid": "actor_loss", "ddpg_pid_follow": "loss"}
    curves = [
        Figure(
            "rewards",
            "Figs. 3 and 4: return of the episodes while learning, one line a seed.",
            lambda: figures.learning(histories, dict.fromkeys(histories, "return"), "return of an episode"),
        ),
        Figure(
            "losses",
            "Figs. 5 and 6: policy loss of SAC, critic loss of DDPG, one line a seed.",
            lambda: figures.learning(histories, losses, "loss"),
        ),
    ]
    return [
        *(curves if runs else ()),
        Figure(
            "profiles",
            "Fig. 7: speed of both trainsets under SAC-PID.",
            lambda: figures.profiles(drives["sac_pid"]),
        ),
        Figure(
            "gap",
            "Fig. 8: gap of every follower; the band is the published 5.88 to 5.98 m.",
            lambda: figures.gaps(drives),
        ),
        Figure(
            "speed_difference",
            "Fig. 9: speed difference of every follower; published: below 0.15 m/s.",
            lambda: figures.differences(drives),
        ),
        Figure(
            "string_stability",
            "Beyond the paper: amplitude of speed along a convoy of five over the head's.",
            lambda: figures.stability(gains),
        ),
    ]


STUDY = Study(
    id="chen2023b",
    title="Chen et al. 2023: train tracking in virtual coupling",
    citation=(
        "Chen, B.; Zhang, L.; Cheng, G.; Liu, Y.; Chen, J. *A Novel Approach for Train Tracking in Virtual "
        "Coupling Based on Soft Actor-Critic*. Actuators 2023, 12(12), 447, doi 10.3390/act12120447."
    ),
    reproduce=reproduce,
    options={"eta": tuple(ETAS)},
)
