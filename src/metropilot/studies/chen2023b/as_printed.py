"""SAC-PID and DDPG-PID with the paper's own reward, behind one head, without protection."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from metropilot.convoy import FOLLOWERS, GAP_M, ConvoyTask, ConvoyTaskConfig
from metropilot.studies.chen2023b.drivers import FollowPolicyOptions
from metropilot.studies.chen2023b.learning import ETAS, NAMES, STEPS, config, make_evaluation
from metropilot.studies.chen2023b.setting import FIGURES, HEAD_CASE, drive_pair, drive_rows
from metropilot.studies.learning import LearnJob
from metropilot.studies.report import PrintedSetting, ReportRow, make_row
from metropilot.studies.study import AsPrinted, LiteralRun, Order

if TYPE_CHECKING:
    from metropilot.learn import AbstractConfig

EPISODES = 10_000
CUT = {"quick": 16, "paper": 400}
"""Episodes; the paper's number takes hours, at some 2,000 control periods a second."""
PERIODS = 1_000
"""Control periods of an episode."""
SEEDS = 1


def literal_task() -> ConvoyTask:
    """The paper's task: eqs. 18 and 19 with the gap itself, one head, from standstill, undisturbed."""
    speed, gap = ETAS["paper"]
    return ConvoyTask(
        ConvoyTaskConfig(heads=1, eta_speed=speed, eta_gap=gap, rewarded_gap_m=0.0, on_the_way=0.0)
    )


def literal_config(algorithm: str, budget: str) -> AbstractConfig:
    """The study's learner over the episodes of the budget."""
    steps = CUT[budget] * PERIODS
    return replace(config(algorithm, "quick"), steps=steps, evaluations=4 if budget == "quick" else 16)


def jobs(seeds: Iterable[int], budget: str) -> list[LearnJob]:
    """Learning runs of the printed settings, algorithms varying slowest."""
    seeds = list(seeds)
    return [
        LearnJob(
            f"as-printed-{budget}-{name}",
            literal_config(algorithm, budget),
            literal_task,
            seed,
            partial(make_evaluation, algorithm, "quick"),
            {"eta": "paper", "gap": "itself"},
        )
        for algorithm, name in NAMES.items()
        for seed in seeds
    ]


def measure(order: Order) -> LiteralRun:
    """Learn with the printed settings, and follow the head of the figures without protection."""
    seeds = order.choose_seeds(quick=SEEDS, paper=SEEDS)[:SEEDS]
    results = order.learn(jobs(seeds, order.budget))
    rows: list[ReportRow] = []
    for k, name in enumerate(NAMES.values()):
        mine = results[k * len(seeds) : (k + 1) * len(seeds)]
        paths = [str(order.folder / result.job.run_id) for result in mine]
        followers = [FOLLOWERS.make(name, options=FollowPolicyOptions(path)) for path in paths]
        drives = [drive_pair(follower, guard="none") for follower in followers]
        rows += drive_rows(name, drives)
        contacts = [100.0 * bool(np.any(one.gap_m < 0.0)) for one in drives]
        rows.append(make_row(FIGURES, HEAD_CASE, name, "drives with a contact", "%", contacts))
    length = f"{len(seeds)} seed of about {CUT[order.budget]:,} episodes each; the paper has {EPISODES:,}."
    inert = (
        f"Eq. 18 with the gap itself gives at most {1.0 / (1.0 + 1000.0 * GAP_M):.4f} of 1 for a gap of "
        f"{GAP_M:g} m, and hardly more for a little less: only the speed difference is rewarded."
    )
    return LiteralRun(rows, [length, inert])


SETTINGS = (
    PrintedSetting(
        "reward of the gap (eq. 18)",
        "largest for a gap of 0",
        f"largest for {GAP_M:g} m",
        "the gap itself, as printed.",
    ),
    PrintedSetting(
        "eta 1 and 2 (Table 1)",
        "1000, 1000",
        ", ".join(f"{eta:g}" for eta in ETAS["soft"]),
    ),
    PrintedSetting(
        "sign of the speed difference (eq. 10)",
        "own less ahead",
        "ahead less own",
        "ahead less own: with the printed sign eq. 12 is unstable, so the paper cannot have run it.",
    ),
    PrintedSetting(
        "command (eq. 17)",
        "0 to 1",
        "-1 to 1",
        "-1 to 1: a trainset that cannot brake cannot follow one that stops.",
    ),
    PrintedSetting(
        "state (eq. 16)",
        "command, acceleration, speed, position, differences",
        "the same, scaled",
        "scaled as in this study; no scale is printed.",
    ),
    PrintedSetting("protection", "none", "none while learning, coupled in the drives"),
    PrintedSetting(
        "episodes behind",
        "one head, from standstill",
        "24 heads, 70 % of them on the way, a fifth disturbed",
        "one recorded S-curve; its profile is not printed.",
    ),
    PrintedSetting(
        "episodes",
        f"{EPISODES:,}",
        f"{STEPS['paper']:,} control periods, about {STEPS['paper'] // PERIODS}",
        f"{CUT['paper']:,} (quick: {CUT['quick']}); the printed number takes about two hours a run.",
    ),
    PrintedSetting(
        "train, time step, network, rates",
        "not printed",
        "see the deviations above",
        "those of this study.",
    ),
)

AS_PRINTED = AsPrinted(SETTINGS, measure)
