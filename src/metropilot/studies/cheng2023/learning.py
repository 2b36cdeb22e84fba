"""Learning runs of DDPG-PID."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from metropilot.control import Errors
from metropilot.studies.cheng2023.drives import TUNED_FED_PID
from metropilot.studies.cheng2023.env import TrackingConfig, TrackingRewards, TrackingTask, residual_law
from metropilot.studies.cheng2023.residual import placed_gains, step_residual_pid
from metropilot.studies.cheng2023.setting import course, draw_courses
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
RESIDUAL_JOB = "ddpg_pid_residual"
SEEDS = 5
RESIDUAL_REWARDS = TrackingRewards(
    weights=(0.2, 0.2, 4.0, 0.2, 0.0),
    speed_scale_mps=0.001,
    distance_scale_m=0.001,
    jerk_scale_mps3=1.0,
    parking_scale_m=0.0005,
)
"""The same terms for errors a hundredth as large; jerk costs ten times as much, energy is the reference's."""
COURSES, CHECKED = 24, 6
"""Courses that are learned on, and others that say which policy is kept: none is one of the study's."""
NOISE_MPS = 0.001
"""Largest standard deviation of the measured speed in learning."""


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


def residual_config() -> DDPGConfig:
    """Configuration of DDPG for corrections: as above, with less noise, as an action of zeros is good."""
    from metropilot.learn import Schedule

    return replace(config(), noise=Schedule(0.2, 0.02, over=0.7), saturation_cost=0.01)


def residual_task() -> TrackingTask:
    """Drawn references, resistances and noise; the policy corrects a tuned PID beside feed-forward."""
    law = residual_law(placed_gains(TUNED_FED_PID))
    return TrackingTask(
        TrackingConfig(draw_courses(COURSES, seed=1), law, rewards=RESIDUAL_REWARDS, noise_mps=NOISE_MPS)
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


def make_residual_evaluation(made: AbstractTask) -> Callable[[Any, Any], dict[str, Any]]:
    """Return the evaluation of corrections: mean ``tracking_score`` of drawn courses not learned on."""
    import jax
    import jax.numpy as jnp

    from metropilot.learn import make_learner
    from metropilot.policy import act
    from metropilot.studies.cheng2023.tracking import track_compiled, tracking_kpis, tracking_score

    spec = make_learner(residual_config(), made).spec
    placed = placed_gains(TUNED_FED_PID)
    checked = TrackingTask(TrackingConfig(draw_courses(CHECKED, seed=2)))

    def evaluate(params: dict[str, Any], key: Any) -> dict[str, Any]:  # noqa: ANN401 (a JAX key)
        del key

        def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
            return step_residual_pid(lambda observation: act(spec, params, observation), placed, seen, memory)

        def one(index: Any) -> dict[str, Any]:  # noqa: ANN401 (a JAX integer)
            what, start = checked.course(index), Errors(jnp.float32(0.0), jnp.float32(0.0))
            record = track_compiled(what, control, start)
            kpis = tracking_kpis(what, record, jnp)
            return {"score": tracking_score(kpis), **kpis._asdict()}

        numbers = jax.vmap(one)(jnp.arange(CHECKED))
        return {name: jnp.mean(jnp.asarray(value, jnp.float32)) for name, value in numbers.items()}

    return evaluate


def jobs(seeds: Iterable[int]) -> list[LearnJob]:
    """Learning runs of the study, one per seed."""
    about = {"rewards": repr(REWARDS)}
    return [LearnJob(JOB, config(), task, seed, make_evaluation, about) for seed in seeds]


def residual_jobs(seeds: Iterable[int]) -> list[LearnJob]:
    """Learning runs of the corrections, one per seed."""
    about = {"rewards": repr(RESIDUAL_REWARDS), "corrects": repr(dict(TUNED_FED_PID))}
    return [
        LearnJob(RESIDUAL_JOB, residual_config(), residual_task, seed, make_residual_evaluation, about)
        for seed in seeds
    ]
