"""Statements of the paper about its figures 5 to 19, the task of the study, and the evaluation of a policy.

The paper prints no table of results and no kWh.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from metropilot import env
from metropilot.errors import InputError
from metropilot.railway import load_line, load_trainset
from metropilot.sim import CODES, Outcome, OutcomeRule
from metropilot.studies.learning import drive_to_end
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot._typing import Array
    from metropilot.env import AbstractTask
    from metropilot.learn import AbstractConfig, PolicyEvaluation
    from metropilot.policy import Params

CITATION = (
    "Chen, B.; Gao, C.; Zhang, L.; Chen, J.; Chen, J.; Li, Y. Optimal Control Algorithm for Subway Train "
    "Operation by Proximal Policy Optimization. *Applied Sciences* 13 (2023), 7456."
)
PRESCRIBED_S = 80.0
THRESHOLD_S = 88.0
EPISODES = 20_000
PPO_EPISODES = 21_000
"""Section 4: "not yet converged over 21,000 episodes"."""

CONVERGED_AT: Mapping[str, float] = MappingProxyType({"ppo_scaled": 3000.0, "ddpg": 3000.0})
"""Episodes after which the reward is called stable (figs. 5 and 7); plain PPO never (fig. 6)."""
CONVERGED: Mapping[str, float] = MappingProxyType({"ppo": 0.0, "ppo_scaled": 1.0, "ddpg": 1.0})
"""Share of the runs whose reward converged: one run each."""
ENERGY_ORDER = ("ddpg", "ppo_scaled", "ppo")
"""Most energy first (figs. 14 to 16): DDPG "much higher", plain PPO lowest because it is late."""
IMPACT_ORDER = ("ddpg", "ppo_scaled", "ppo")
"""Highest mean impact rate first (figs. 17 to 19)."""

ALLOWED_S = THRESHOLD_S - PRESCRIBED_S
IN_HAND_S = 0.5
"""Part of the time allowed that is not used while learning."""
SOFT_S = 4.0
"""Time over which the bonus of a late run turns into its negative."""
REWARDS = (
    env.Energy(),
    env.Comfort(weight=0.1),
    env.OnTime(bonus=100.0, allowed_s=ALLOWED_S - IN_HAND_S, soft_s=SOFT_S),
    env.Failure(price=100.0, per_m=0.1),
)
"""Chen23a eqs. 16 and 17 with two changes. The bonus of a late run falls evenly, not at once, and from half a
second before the time allowed: the least energy is just within what is allowed, and noise of exploration
crosses a sharp edge. The last term is added:
the paper's train always arrives, at worst late; without it standing still would have the largest return of
all late runs."""
ACTION = env.RegimeAction()
DECISION_S = 1.0
COMFORT = 0.1
UNASSISTED_TOLERANCE_M = 5.0


def task_config() -> env.DrivingConfig:
    """The task ``chen2023a``."""
    return env.DrivingConfig(
        sections=(load_line("yizhuang").section("YZQ", "WHY"),),
        trainsets=(load_trainset("cheng2023"),),
        scenarios=env.DisturbanceDistribution(time_s=(80.0, 80.0)),
        observer="position_speed",
        action=ACTION,
        rewards=REWARDS,
        assists=env.Assists(late=True),
        periods=2,
    )


def make_assisted() -> env.DrivingTask:
    """The study's task: position and speed in, share of the available force out, rewards of eqs. 16 and 17.

    Around an action of zero the trainset coasts. Assists do the station-stop braking and keep the speed
    limit; see the deviations.
    """
    return env.DrivingTask(task_config())


def make_unassisted() -> env.DrivingTask:
    """The same task without the stop assist; the policy must stop by itself within 5 m of the stop point."""
    rule = OutcomeRule(tolerance_m=UNASSISTED_TOLERANCE_M)
    return env.DrivingTask(replace(task_config(), assists=env.Assists(stop=False), outcomes=rule))


def longest_s(task: env.DrivingTask) -> float:
    """Time after which an episode ends."""
    rule = task.config.outcomes
    return rule.late_ratio * PRESCRIBED_S + rule.late_s


def longest_decisions(task: env.DrivingTask) -> int:
    """Number of decisions that is enough for any episode."""
    return int(longest_s(task) / DECISION_S) + 2


def make_evaluation(
    config: AbstractConfig, task: AbstractTask, end: Outcome = Outcome.ARRIVED
) -> PolicyEvaluation:
    """Return the evaluation of a policy: one deterministic run from standstill without exploration.

    Args:
        config: Configuration of the learner.
        task: One of this module's tasks.
        end: Outcome that counts as arrived.

    Returns:
        A function of parameters and a key that gives ``score`` (the return), ``running_time_s`` (130 s unless
        arrived), ``energy_kwh`` (wheel), ``impact_mps3`` (mean size of the jerk), ``stopping_error_m``,
        ``arrived`` (1 or 0), ``end_mps`` (speed at the end), each of shape ().

    Raises:
        InputError: The task is not a driving task.
    """
    import jax
    import jax.numpy as jnp

    from metropilot.learn import make_learner
    from metropilot.policy import act

    if not isinstance(task, env.DrivingTask):
        raise InputError("not a driving task", field="task", value=type(task).__name__)

    spec = make_learner(config, task).spec
    start = jax.tree.map(lambda x: x[0], env.starts([0], [PRESCRIBED_S]))
    longest, decisions = longest_s(task), longest_decisions(task)

    def evaluate(params: Params, key: Array) -> dict[str, Array]:
        state, returned = drive_to_end(task, partial(act, spec, params), task.begin(start), key, decisions)
        run = env.episode_of(task, state)
        arrived = run.outcome == CODES.index(end)
        return {
            "score": returned,
            "running_time_s": jnp.where(arrived, run.running_time_s, longest),
            "energy_kwh": run.wheel_j / J_PER_KWH,
            "impact_mps3": run.jerk_mps2 / jnp.maximum(run.running_time_s, 1.0),
            "stopping_error_m": jnp.abs(run.stop_error_m),
            "arrived": arrived.astype(jnp.float32),
            "end_mps": state.plant.speed_mps,
        }

    return evaluate
