"""SAC-PID and DDPG-PID for as many episodes as in the paper, behind one head, without protection."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, final

import numpy as np

from metropilot.convoy import (
    FOLLOWERS,
    GAP_M,
    AbstractFollower,
    ConvoyDrive,
    ConvoyTask,
    ConvoyTaskConfig,
    FollowerObservation,
    FollowPidOptions,
)
from metropilot.physics import Vehicle
from metropilot.studies.chen2023b import learning
from metropilot.studies.chen2023b.drivers import AbstractGainFollower, FollowPolicyOptions
from metropilot.studies.chen2023b.figures import draw_gains, draw_returns
from metropilot.studies.chen2023b.setting import FIGURES, HEAD_CASE, drive_pair, drive_rows, pair
from metropilot.studies.learning import LearnJob, SeedResult
from metropilot.studies.report import Figure, PrintedSetting, ReportRow, make_row
from metropilot.studies.study import AsPrinted, LiteralRun, Order

if TYPE_CHECKING:
    from metropilot.learn import AbstractConfig

EPISODES = {"quick": 16, "paper": 10_000}
PERIODS = 1_000
"""Control periods of an episode."""
SEEDS = {"quick": 1, "paper": 5}
ENVIRONMENTS = {"quick": 32, "paper": 128}
MEMORY = {"quick": 32_000, "paper": 320_000}
"""Control periods in the replay buffer."""
REWARDED = {"paper": 0.0, "soft": GAP_M}
"""Gap that eq. 18 rewards most, for each choice of eta."""
UPPER = FollowPidOptions(5.0, 1.5, 1.5)
"""The printed upper bounds of the gains."""
UPPER_CASE = f"{HEAD_CASE}, the printed upper gains"
CONTACTS = "drives with a contact"


def literal_task(eta: str = "paper") -> ConvoyTask:
    """The paper's task: eqs. 18 and 19, one head, from standstill, undisturbed."""
    speed, gap = learning.ETAS[eta]
    return ConvoyTask(
        ConvoyTaskConfig(heads=1, eta_speed=speed, eta_gap=gap, rewarded_gap_m=REWARDED[eta], on_the_way=0.0)
    )


def literal_config(algorithm: str, budget: str) -> AbstractConfig:
    """The study's learner over the episodes of the budget."""
    return replace(
        learning.config(algorithm, "quick"),
        steps=EPISODES[budget] * PERIODS,
        evaluations=4 if budget == "quick" else 16,
        environments=ENVIRONMENTS[budget],
        buffer_size=MEMORY[budget],
    )


def jobs(seeds: Iterable[int], budget: str) -> list[LearnJob]:
    """Learning runs of the printed settings, and with softer eta; algorithms vary slowest, then eta."""
    seeds = list(seeds)
    return [
        LearnJob(
            f"as-printed-{budget}-{name}-{eta}",
            literal_config(algorithm, budget),
            partial(literal_task, eta),
            seed,
            partial(learning.make_evaluation, algorithm, "quick"),
            {"eta": eta, "rewarded_gap_m": REWARDED[eta]},
        )
        for algorithm, name in learning.NAMES.items()
        for eta in REWARDED
        for seed in seeds
    ]


@final
class RecordedGains(AbstractFollower):
    """A learned follower that keeps the gains that it sets, period by period.

    Attributes:
        inner: The follower.
        gains: Proportional, integral and derivative gain of every period so far.
    """

    id = "recorded_gains"

    def __init__(self, inner: AbstractGainFollower) -> None:
        self.inner = inner
        self.gains: list[tuple[float, float, float]] = []

    def init(self, vehicle: Vehicle, period_s: float) -> Any:  # noqa: ANN401 (the follower's memory)
        """Start anew."""
        self.gains.clear()
        return self.inner.init(vehicle, period_s)

    def act(self, memory: Any, observation: FollowerObservation) -> tuple[Any, Any]:  # noqa: ANN401
        """Act as the follower, and keep its gains."""
        proportional, integral, derivative = self.inner.choose_gains(observation)
        self.gains.append((float(proportional), float(integral), float(derivative)))
        return self.inner.act(memory, observation)


def measure(order: Order) -> LiteralRun:
    """Learn with the printed settings, and follow the head of the figures without protection."""
    seeds = order.choose_seeds(quick=SEEDS["quick"], paper=SEEDS["paper"])[: SEEDS[order.budget]]
    groups: dict[tuple[str, str], list[SeedResult]] = {}
    for result in order.learn(jobs(seeds, order.budget)):
        key = learning.NAMES[result.job.config.algorithm], str(result.job.about["eta"])
        groups.setdefault(key, []).append(result)
    rows: list[ReportRow] = []
    gains: dict[tuple[str, str], list[np.ndarray]] = {}
    for (name, eta), results in groups.items():
        recorded = [_record_gains(name, order, result) for result in results]
        rows += _rows(name, _case(eta), [drive_pair(each, guard="none") for each in recorded])
        said = partial(make_row, FIGURES, _case(eta), name)
        ends = [
            learning.first_and_last(result)
            for result in results
            if np.isfinite(result.history["return"]).any()
        ]
        if ends:
            first, last = zip(*ends, strict=True)
            rows += [said(learning.FIRST_RETURN, "", first), said(learning.LAST_RETURN, "", last)]
        gains[name, eta] = [np.array(each.gains) for each in recorded]
    constant = drive_pair(FOLLOWERS.make("follow_pid", options=UPPER), guard="none")
    rows += _rows("follow_pid", UPPER_CASE, [constant])
    return LiteralRun(rows, _remarks(rows, len(seeds), order.budget), _figures(groups, gains))


def _case(eta: str) -> str:
    return HEAD_CASE if eta == "paper" else f"{HEAD_CASE}, soft eta"


def _record_gains(name: str, order: Order, result: SeedResult) -> RecordedGains:
    """Make a learned follower that records its gains."""
    made = FOLLOWERS.make(name, options=FollowPolicyOptions(str(order.folder / result.job.run_id)))
    if not isinstance(made, AbstractGainFollower):
        raise TypeError(f"{name} sets no gains")
    return RecordedGains(made)


def _rows(name: str, case: str, drives: Sequence[ConvoyDrive]) -> list[ReportRow]:
    contacts = [100.0 * bool(np.any(one.gap_m < 0.0)) for one in drives]
    return [*drive_rows(name, drives, case), make_row(FIGURES, case, name, CONTACTS, "%", contacts)]


def _remarks(rows: Sequence[ReportRow], seeds: int, budget: str) -> list[str]:
    """Findings; every number in them is that of a row."""
    value = {(row.case, row.driver, row.kpi): row for row in rows}
    length = f"{seeds} seed{'s' * (seeds > 1)} of about {EPISODES[budget]:,} episodes each"
    if EPISODES[budget] < EPISODES["paper"]:
        length += f"; the paper has {EPISODES['paper']:,}"
    found = [
        f"{length}.",
        (
            f"Eq. 18 with the gap itself gives at most {1.0 / (1.0 + 1000.0 * GAP_M):.4f} of 1 for a gap of "
            f"{GAP_M:g} m, and hardly more for a little less: only the speed difference is rewarded."
        ),
    ]
    for eta in REWARDED:
        said = []
        for name in learning.NAMES.values():
            crashed = [one > 0.0 for one in value[_case(eta), name, CONTACTS].values]
            largest = value[_case(eta), name, "largest gap"].values
            smallest = value[_case(eta), name, "smallest gap"].values
            errors = [
                max(GAP_M - low, high - GAP_M)
                for low, high, crash in zip(smallest, largest, crashed, strict=True)
                if not crash
            ]
            kept = f", gap errors without one {min(errors):.3f} to {max(errors):.3f} m" if errors else ""
            said.append(f"`{name}`: contact in {sum(crashed)} of {seeds}{kept}")
        speed, gap = learning.ETAS[eta]
        found.append(f"With eta of {speed:g} and {gap:g}, policies without protection: {'; '.join(said)}.")
    upper = f"{HEAD_CASE}, the printed upper gains"
    low, high = (
        float(value[upper, "follow_pid", kpi].ours or 0.0) for kpi in ("smallest gap", "largest gap")
    )
    found.append(
        f"The same PID held at the printed upper gains, without learning: gap error "
        f"{max(GAP_M - low, high - GAP_M):.3f} m."
    )
    return found


def _figures(
    groups: Mapping[tuple[str, str], Sequence[SeedResult]],
    gains: Mapping[tuple[str, str], Sequence[np.ndarray]],
) -> list[Figure]:
    histories = {key: [result.history for result in results] for key, results in groups.items()}
    return [
        Figure(
            "returns_as_printed",
            "Figs. 3 and 4 over as many episodes as in the paper, one line a seed; eta 1000 is printed.",
            lambda: draw_returns(histories, PERIODS),
        ),
        Figure(
            "gains_as_printed",
            "Gains that the learned policies set over the run, one line a seed; eta 1000 and the grey bounds "
            "are printed.",
            lambda: draw_gains(gains, pair().dt),
        ),
    ]


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
        ", ".join(f"{eta:g}" for eta in learning.ETAS["soft"]),
        f"as printed; *soft eta* is learned with this study's, which reward {GAP_M:g} m most.",
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
        f"{EPISODES['paper']:,}",
        f"{learning.STEPS['paper']:,} control periods, about {learning.STEPS['paper'] // PERIODS}",
        f"{EPISODES['paper']:,} (quick: {EPISODES['quick']}), {ENVIRONMENTS['paper']} side by side.",
    ),
    PrintedSetting(
        "train, time step, network, rates",
        "not printed",
        "see the deviations above",
        "those of this study.",
    ),
)

AS_PRINTED = AsPrinted(SETTINGS, measure)
