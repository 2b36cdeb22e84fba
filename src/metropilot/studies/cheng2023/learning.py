"""Learning runs of DDPG-PID."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from metropilot.control import Errors
from metropilot.studies.cheng2023.env import TrackingConfig, TrackingRewards, TrackingTask
from metropilot.studies.cheng2023.setting import course
from metropilot.studies.learning import LearnJob

if TYPE_CHECKING:
    from metropilot.env import AbstractTask
    from metropilot.learn import DDPGConfig

REWARDS = TrackingRewards(
    weights=(0.2, 0.2, 4.0, 0.2, 0.2),
    speed_scale_mps=0.03,
    distance_scale_m=0.25,
    jerk_scale_mps3=10.0,
    parking_scale_m=0.05,
)
"""Cheng23's five terms; the scales (1 in the paper) define a small error, and parking, which is rewarded once
per run, has twenty times the paper's weight."""
JOB = "ddpg_pid"
SEEDS = 5


def config() -> DDPGConfig:
    """Configuration of DDPG; the paper prints no hyperparameters."""
    from metropilot.learn import DDPGConfig, Schedule

    return DDPGConfig(
        steps=300_000,
        environments=16,
        evaluations=80,
        gamma=0.985,
        hidden=(64, 64),
        batch_size=128,
        updates=8,
        buffer_size=131_072,
        warmup=8_000,
        actor_rate=Schedule(5e-4, 1e-4),
        critic_rate=Schedule(1e-3, 2e-4),
        noise=Schedule(0.5, 0.02, over=0.7),
        tau=0.01,
        saturation_cost=0.003,
    )


def task() -> TrackingTask:
    """The paper's task on the base scenario."""
    return TrackingTask(TrackingConfig((course(),), rewards=REWARDS))


def make_evaluation(made: AbstractTask) -> Callable[[Any, Any], dict[str, Any]]:
    """Return the evaluation of a policy: ``tracking_score`` of the base scenario from standstill."""
    import jax
    import jax.numpy as jnp

    from metropilot.learn import make_learner
    from metropilot.policy import act
    from metropilot.studies.cheng2023.ddpg_pid import step_ddpg_pid
    from metropilot.studies.cheng2023.tracking import track_compiled, tracking_kpis, tracking_score

    if not isinstance(made, TrackingTask):
        raise TypeError("the tracking task is evaluated here")
    spec, single = make_learner(config(), made).spec, made.course(0)

    def evaluate(params: dict[str, Any], key: Any) -> dict[str, Any]:  # noqa: ANN401 (a JAX key)
        del key

        def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
            return step_ddpg_pid(lambda observation: act(spec, params, observation), seen, memory)

        start = Errors(jnp.float32(0.0), jnp.float32(0.0))
        kpis = tracking_kpis(single, track_compiled(single, control, start), jnp)
        numbers = jax.tree.map(lambda value: jnp.asarray(value, jnp.float32), kpis._asdict())
        return {"score": tracking_score(kpis), **numbers}

    return evaluate


def jobs(seeds: Iterable[int]) -> list[LearnJob]:
    """Learning runs of the study, one per seed."""
    about = {"rewards": repr(REWARDS)}
    return [LearnJob(JOB, config(), task, seed, make_evaluation, about) for seed in seeds]
