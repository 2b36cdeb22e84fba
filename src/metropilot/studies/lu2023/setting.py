"""How the study learns: tasks, learners, and what evaluates a policy while it learns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from metropilot.env import DrivingTask, episode_of, starts, task_config
from metropilot.env.actions import NotchForceAction
from metropilot.env.randomization import DisturbanceDistribution
from metropilot.env.registry import LU2023_REWARDS
from metropilot.env.rewards import OnTime
from metropilot.learn import AbstractConfig, DQNConfig, Schedule
from metropilot.studies.learning import LearnJob
from metropilot.studies.lu2023.published import PLANS, PlanCase

PERIOD_S, CONTROL_S = 3.0, 0.2
MARGIN = 0.06
"""The filter's flat-out time counts so much longer: keeping clear of protection costs 4 to 5 %."""
IN_HAND_S = 0.5
"""Learned with so much less than the 3 s that are allowed."""
ALL_TIMES_S = (118.0, 142.0)
ON_THE_WAY, LEFT_RATIO = 0.8, (1.0, 1.7)
"""So many episodes begin on the way, with so much time left over the flat-out time to go."""
STATE = ("position", "speed", "time_left", "reserve", "permitted_ahead")
"""Position, speed, time; what the filter asks (time left beyond the flat-out time to go); limits ahead."""
EVALUATIONS = 40
LEARNING = DQNConfig(
    steps=60_000,
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
    n_step=1,
    epsilon=Schedule(0.5, 0.05, over=0.3, shape="exponential"),
    target_period=200,
    huber=2.0,
)
"""The same for DQN and improved DQN; what differs are the four switches."""
IMPROVEMENTS = ("double", "dueling", "prioritised", "filter")


ALL_STEPS = 160_000
"""Of the network for all plans, and of the one of the plan with the restriction."""


def lu2023_task(cases: tuple[str, ...], times_s: tuple[float, float], *, filtered: bool) -> DrivingTask:
    """A task of the study.

    Args:
        cases: Lines of the catalogue, one or both.
        times_s: Shortest and longest scheduled time.
        filtered: Whether the minimum-arrival-time filter is on.
    """
    from metropilot.railway import load_line

    base = task_config("lu2023")
    return DrivingTask(
        replace(
            base,
            sections=tuple(load_line(case).section("WHY", "WYJ") for case in cases),
            scenarios=DisturbanceDistribution(time_s=times_s, on_the_way=ON_THE_WAY, left_ratio=LEFT_RATIO),
            observer=STATE,
            action=NotchForceAction(in_time=filtered, margin=MARGIN),
            rewards=(OnTime(bonus=1000.0, allowed_s=3.0 - IN_HAND_S), *LU2023_REWARDS[1:]),
            dt=CONTROL_S,
            periods=round(PERIOD_S / CONTROL_S),
            most_decisions=75,
        )
    )


def plan_task(plan_id: str, *, filtered: bool) -> DrivingTask:
    """The task of one plan, as in the paper: state (x, v, t), one scheduled time."""
    plan = next(plan for plan in PLANS if plan.id == plan_id)
    return lu2023_task((plan.line,), (plan.scheduled_s, plan.scheduled_s), filtered=filtered)


def all_plans_task(*, filtered: bool) -> DrivingTask:
    """The task of the one network that is told the time left and the limits ahead."""
    return lu2023_task(("lu2023", "lu2023-restricted"), ALL_TIMES_S, filtered=filtered)


def learner(off: str = "", *, steps: int = LEARNING.steps) -> tuple[DQNConfig, bool]:
    """Improved DQN with one improvement off (or none; ``all``: plain DQN), and whether the filter is on."""
    on = {name: off not in {name, "all"} for name in IMPROVEMENTS}
    config = replace(
        LEARNING,
        steps=steps,
        double=on["double"],
        dueling=on["dueling"],
        prioritised=on["prioritised"],
    )
    return config, on["filter"]


def drive_plans(plans: tuple[PlanCase, ...], config: AbstractConfig, task: Any) -> Callable[..., Any]:  # noqa: ANN401 (a driving task)
    """What evaluates a policy: each plan once from standstill, without exploration.

    The score is the mean return. ``PLAN.kwh, PLAN.late_s, PLAN.stop_m, PLAN.over_mps, PLAN.arrived`` say how
    each went.
    """
    import jax
    import jax.numpy as jnp

    from metropilot.learn.registry import make_learner
    from metropilot.policy.policy import act
    from metropilot.sim import CODES, Outcome

    spec = make_learner(config, task).spec
    lines = [section.line_id for section in task.config.sections]
    begin = starts([lines.index(plan.line) for plan in plans], [plan.scheduled_s for plan in plans])

    def one(params: Any, key: Any, start: Any) -> Any:  # noqa: ANN401 (arrays)
        state, seen = task.begin(start)

        def decide(carry: Any, _: None) -> Any:  # noqa: ANN401 (arrays)
            state, seen, going, total = carry
            action = act(spec, params, seen, task.allowed(state))
            after, step = task.step(key, state, action)
            after = jax.tree.map(lambda new, old: jnp.where(going, new, old), after, state)
            total = total + jnp.where(going, step.reward, 0.0)
            return (after, step.observation, going & ~step.terminated & ~step.truncated, total), None

        first = (state, seen, jnp.ones((), bool), jnp.zeros((), jnp.float32))
        (state, _, _, total), _ = jax.lax.scan(decide, first, None, length=config.evaluation_steps)
        return episode_of(task, state), total

    def evaluate(params: Any, key: Any) -> dict[str, Any]:  # noqa: ANN401 (arrays)
        episode, total = jax.vmap(partial(one, params, key))(begin)
        row = {"score": jnp.mean(total)}
        arrived = (episode.outcome == CODES.index(Outcome.ARRIVED)).astype(jnp.float32)
        for k, plan in enumerate(plans):
            values = {
                "return": total[k],
                "kwh": episode.wheel_j[k] / 3.6e6,
                "late_s": episode.running_time_s[k] - plan.scheduled_s,
                "stop_m": episode.stop_error_m[k],
                "over_mps": episode.max_overspeed_mps[k],
                "arrived": arrived[k],
            }
            row |= {f"{plan.id}.{name}": value for name, value in values.items()}
        return row

    return evaluate


def plan_job(name: str, plan: PlanCase, seed: int, off: str = "", steps: int = LEARNING.steps) -> LearnJob:
    """One learning run of one plan."""
    config, filtered = learner(off, steps=steps)
    about = {"plan": plan.id, "filter": filtered, "period_s": PERIOD_S, "margin": MARGIN}
    task = partial(plan_task, plan.id, filtered=filtered)
    return LearnJob(f"{name}-{plan.id}", config, task, seed, partial(drive_plans, (plan,), config), about)


def all_plans_job(name: str, seed: int, off: str = "", steps: int = ALL_STEPS) -> LearnJob:
    """The run of the one network for all plans."""
    config, filtered = learner(off, steps=steps)
    about = {"plan": "all", "filter": filtered, "period_s": PERIOD_S, "margin": MARGIN}
    task = partial(all_plans_task, filtered=filtered)
    return LearnJob(f"{name}-all", config, task, seed, partial(drive_plans, PLANS, config), about)
