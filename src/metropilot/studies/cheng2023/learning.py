"""Learning runs of DDPG-PID."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from metropilot.control import Errors
from metropilot.studies.cheng2023.drives import TUNED_FED_PID
from metropilot.studies.cheng2023.env import TrackingConfig, TrackingRewards, TrackingTask
from metropilot.studies.cheng2023.law import PAPER_LAW, TrackingLaw
from metropilot.studies.cheng2023.residual import placed_gains, residual_law
from metropilot.studies.cheng2023.setting import DT_S, course, draw_courses
from metropilot.studies.cheng2023.tracking import ReferenceCourse
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


def corrections_law() -> TrackingLaw:
    """Corrections of the tuned PID beside feed-forward."""
    return residual_law(placed_gains(TUNED_FED_PID))


def residual_task() -> TrackingTask:
    """Drawn references, resistances and noise; the policy corrects a tuned PID beside feed-forward."""
    courses = draw_courses(COURSES, seed=1)
    return TrackingTask(
        TrackingConfig(courses, corrections_law(), rewards=RESIDUAL_REWARDS, noise_mps=NOISE_MPS)
    )


def task() -> TrackingTask:
    """The paper's task on the base scenario."""
    return TrackingTask(TrackingConfig((course(),), rewards=REWARDS))


def make_evaluation(made: AbstractTask) -> Callable[[Any, Any], dict[str, Any]]:
    """Return the evaluation of a policy: ``tracking_score`` of the base scenario from standstill."""
    from metropilot.learn import make_learner

    if not isinstance(made, TrackingTask):
        raise TypeError("the tracking task is evaluated here")
    measure = _measure(PAPER_LAW, make_learner(config(), made).spec)
    single = made.course(0)
    return lambda params, _: measure(params, single)


def make_residual_evaluation(made: AbstractTask) -> Callable[[Any, Any], dict[str, Any]]:
    """Return the evaluation of corrections: mean ``tracking_score`` of drawn courses not learned on."""
    import jax
    import jax.numpy as jnp

    from metropilot.learn import make_learner

    measure = _measure(corrections_law(), make_learner(residual_config(), made).spec)
    checked = TrackingTask(TrackingConfig(draw_courses(CHECKED, seed=2))).courses

    def evaluate(params: dict[str, Any], _: Any) -> dict[str, Any]:  # noqa: ANN401 (a JAX key)
        return jax.tree.map(jnp.mean, jax.vmap(lambda what: measure(params, what))(checked))

    return evaluate


def _measure(law: TrackingLaw, spec: Any) -> Callable[[Any, ReferenceCourse], dict[str, Any]]:  # noqa: ANN401 (a policy's form)
    """Score and KPIs of a policy's parameters on a compiled course."""
    import jax.numpy as jnp

    from metropilot.policy import act
    from metropilot.studies.cheng2023.tracking import track_compiled, tracking_kpis, tracking_score

    def measure(params: dict[str, Any], what: ReferenceCourse) -> dict[str, Any]:
        def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
            return law.drive(lambda observation: act(spec, params, observation), seen, memory)

        start = Errors(jnp.float32(0.0), jnp.float32(0.0))
        kpis = tracking_kpis(what, track_compiled(what, control, start), jnp, DT_S)
        numbers = {name: jnp.asarray(value, jnp.float32) for name, value in kpis._asdict().items()}
        return {"score": tracking_score(kpis), **numbers}

    return measure


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
