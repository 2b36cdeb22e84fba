"""Recipes and learning runs, evaluation of policies, and the convergence rule."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

from metropilot.env import episode_of, starts
from metropilot.learn import AbstractConfig, DQNConfig, Recipe, Schedule
from metropilot.sim import PUNCTUALITY_S, STOP_TOLERANCE_M
from metropilot.studies.learning import LearnJob, drive_to_end
from metropilot.studies.lu2023.setting import (
    MARGIN,
    MOST_MPS2,
    PERIOD_S,
    PLANS,
    PlanCase,
    plan_task,
    without_filter,
)
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot.studies.lu2023.drives import NotchFront

EVALUATIONS = 120
LEARNING = DQNConfig(
    steps=200_000,
    environments=8,
    evaluations=EVALUATIONS,
    evaluation_steps=60,
    gamma=1.0,
    reward_factor=1 / 200,
    normalise_observations=True,
    hidden=(128, 256),
    activation="relu",
    learning_rate=Schedule(1e-3, 3e-5, shape="exponential"),
    updates=4,
    batch_size=64,
    buffer_size=40_000,
    warmup=1_000,
    n_step=3,
    epsilon=Schedule(0.5, 0.05, over=0.3, shape="exponential"),
    target_period=200,
    huber=2.0,
)
"""Hyperparameters of DQN and improved DQN, which differ in four switches only."""
IMPROVEMENTS = ("double", "dueling", "prioritised", "filter")
IMPROVED = {"double": True, "dueling": True, "prioritised": True}


def drive_plans(plans: tuple[PlanCase, ...], config: AbstractConfig, task: Any) -> Callable[..., Any]:  # noqa: ANN401 (a driving task)
    """Return the evaluation of a policy: each plan once from standstill, without exploration.

    The score is the mean return. ``PLAN.kwh, PLAN.late_s, PLAN.stop_m, PLAN.over_mps, PLAN.arrived`` are the
    results of each plan.
    """
    import jax
    import jax.numpy as jnp

    from metropilot.learn import make_learner
    from metropilot.policy import act
    from metropilot.sim import CODES, Outcome

    spec = make_learner(config, task).spec
    lines = [section.line_id for section in task.config.sections]
    begin = starts([lines.index(plan.line) for plan in plans], [plan.scheduled_s for plan in plans])

    def one(params: Any, key: Any, start: Any) -> Any:  # noqa: ANN401 (arrays)
        policy = partial(act, spec, params)
        state, total = drive_to_end(task, policy, task.begin(start), key, config.evaluation_steps)
        return episode_of(task, state), total

    def evaluate(params: Any, key: Any) -> dict[str, Any]:  # noqa: ANN401 (arrays)
        episode, total = jax.vmap(partial(one, params, key))(begin)
        row = {"score": jnp.mean(total)}
        arrived = (episode.outcome == CODES.index(Outcome.ARRIVED)).astype(jnp.float32)
        for k, plan in enumerate(plans):
            values = {
                "return": total[k],
                "kwh": episode.wheel_j[k] / J_PER_KWH,
                "late_s": episode.running_time_s[k] - plan.scheduled_s,
                "stop_m": episode.stop_error_m[k],
                "over_mps": episode.max_overspeed_mps[k],
                "arrived": arrived[k],
            }
            row |= {f"{plan.id}.{name}": value for name, value in values.items()}
        return row

    return evaluate


def evaluate_plans(config: AbstractConfig, task: Any) -> Callable[..., Any]:  # noqa: ANN401 (a driving task)
    """Return the evaluation of a policy on all plans, scored as in :func:`drive_plans`.

    It adds the KPIs that are evaluated for every recipe.
    """
    from metropilot.learn import DrivingEvaluation, make_learner

    rule = DrivingEvaluation(task, make_learner(config, task).spec)
    plans = drive_plans(PLANS, config, task)

    def evaluate(params: Any, key: Any) -> dict[str, Any]:  # noqa: ANN401 (arrays)
        return {**rule(params, key), **plans(params, key)}

    return evaluate


ALL_STEPS = 800_000
"""Steps of the network for all plans, and of that for the plan with the restriction."""
QUICK = {"steps": 40_000, "evaluations": 10}
DQN_RECIPE = Recipe("lu2023", replace(LEARNING, steps=ALL_STEPS), QUICK, without_filter, evaluate_plans)
"""Plain DQN, without the filter."""
IMPROVED_DQN_RECIPE = replace(DQN_RECIPE, paper=replace(DQN_RECIPE.paper, **IMPROVED), changes=None)


def plan_job(name: str, plan: PlanCase, seed: int, off: str = "", steps: int = LEARNING.steps) -> LearnJob:
    """Learning run of one plan: improved DQN without the improvement ``off``; ``all``: plain DQN."""
    on = {improvement: off not in {improvement, "all"} for improvement in IMPROVEMENTS}
    filtered = on.pop("filter")
    config = replace(LEARNING, steps=steps, **on)
    about = {"plan": plan.id, "filter": filtered, "period_s": PERIOD_S, "margin": MARGIN}
    task = partial(plan_task, plan, filtered=filtered)
    return LearnJob(f"{name}-{plan.id}", config, task, seed, partial(drive_plans, (plan,), config), about)


def all_plans_job(name: str, seed: int) -> LearnJob:
    """Learning run of the one network for all plans, with the recipe of the driver."""
    recipe = {"dqn": DQN_RECIPE, "improved_dqn": IMPROVED_DQN_RECIPE}[name]
    config = recipe.configuration("paper")
    about = {"plan": "all", "filter": name == "improved_dqn", "period_s": PERIOD_S, "margin": MARGIN}
    return LearnJob(f"{name}-all", config, recipe.make_task, seed, partial(evaluate_plans, config), about)


STEADY = 3
"""Number of consecutive evaluations that meet the demands in a steady run."""
ABOVE = 0.08
OVERSPEED_MPS = 1e-3
RULE = " ".join(
    f"""A run has converged at its first evaluation ({EVALUATIONS} per run, each one drive from standstill
    without exploration) that arrives within 3 s of the schedule and 0.3 m of the stop, without overspeed, at
    most {100 * ABOVE:.0f} % above the optimum over the same notches within {MOST_MPS2:g} m/s² for the
    running time achieved: the policy kept is the best one evaluated, so from then on there is one to ship. A
    run that never converges is censored at its length: medians are those of Kaplan and Meier, comparisons
    are log-rank tests. A run is steady if it does so in {STEADY} evaluations in a row; the tables give their
    number.""".split()
)


@dataclass(frozen=True)
class Convergence:
    """Convergence of a run under the rule.

    Attributes:
        episodes: Training episodes until convergence, or in total.
        converged: True if the run converged.
    """

    episodes: float
    converged: bool


def meet_demands(
    history: Mapping[str, ndarray], plan_id: str, scheduled_s: float, front: NotchFront
) -> ndarray:
    """Mask of the evaluations that meet the rule's demands. Shape (E,), bool."""
    column = {
        name: np.asarray(history[f"evaluation.{plan_id}.{name}"], float)
        for name in ("kwh", "late_s", "stop_m", "over_mps", "arrived")
    }
    above = column["kwh"] * J_PER_KWH / front.at(scheduled_s + column["late_s"]) - 1.0
    return (
        (column["arrived"] > 0.5)
        & (np.abs(column["late_s"]) <= PUNCTUALITY_S)
        & (np.abs(column["stop_m"]) <= STOP_TOLERANCE_M)
        & (column["over_mps"] <= OVERSPEED_MPS)
        & (above <= ABOVE)
    )


def find_convergence(history: Mapping[str, ndarray], good: ndarray, in_a_row: int = 1) -> Convergence:
    """Apply the rule to the evaluations that meet its demands.

    Args:
        history: History of the run.
        good: Mask of the evaluations that meet the demands, from :func:`meet_demands`. Shape (E,), bool.
        in_a_row: Required number of consecutive evaluations.
    """
    episodes = np.cumsum(np.nan_to_num(np.asarray(history["episodes"], float)))
    runs = np.convolve(good.astype(int), np.ones(in_a_row, int), mode="valid") == in_a_row
    if runs.any():
        return Convergence(float(episodes[int(np.argmax(runs))]), True)
    return Convergence(float(episodes[-1]), False)


@dataclass(frozen=True)
class SpeedUp:
    """Speed-up of convergence from survival statistics: runs that never converged are right-censored.

    Attributes:
        percent: Ratio of the Kaplan-Meier medians less one, %; None where a median is not reached.
        p: Two-sided p of the log-rank test; None with fewer than three runs that converged.
    """

    percent: float | None
    p: float | None


def speed_up(slow: Sequence[Convergence], fast: Sequence[Convergence]) -> SpeedUp:
    """Compute Lu23's speed-up of convergence: 800 episodes instead of 1100 are 37 % faster.

    Args:
        slow: Runs of the baseline.
        fast: Runs of the other learner.
    """
    from scipy.stats import CensoredData, logrank

    slower, faster = (
        CensoredData(
            uncensored=[run.episodes for run in runs if run.converged],
            right=[run.episodes for run in runs if not run.converged],
        )
        for runs in (slow, fast)
    )
    a, b = (median_episodes(runs) for runs in (slow, fast))
    percent = None if a is None or b is None else 100.0 * (a / b - 1.0)
    enough = sum(run.converged for run in (*slow, *fast)) >= 3
    return SpeedUp(percent, float(logrank(slower, faster).pvalue) if enough else None)


def median_episodes(runs: Sequence[Convergence]) -> float | None:
    """Kaplan-Meier median of the episodes to convergence; None where fewer than half converged."""
    from scipy.stats import CensoredData, ecdf

    known = [run.episodes for run in runs if run.converged]
    if not known:
        return None
    left = ecdf(CensoredData(known, right=[run.episodes for run in runs if not run.converged])).sf
    reached = left.quantiles[left.probabilities <= 0.5]
    return float(reached[0]) if reached.size else None
