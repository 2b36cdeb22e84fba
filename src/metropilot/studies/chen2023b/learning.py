"""Learning of the PID gains by SAC and by DDPG."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot.convoy import ConvoyTask, ConvoyTaskConfig
from metropilot.studies.learning import LearnJob, SeedResult

if TYPE_CHECKING:
    from metropilot.env import AbstractTask
    from metropilot.learn import AbstractConfig

NAMES = {"sac": "sac_pid", "ddpg": "ddpg_pid_follow"}
ETAS = {"soft": (100.0, 200.0), "paper": (1000.0, 1000.0)}
"""eta_1 and eta_2: with the paper's 1000 the reward is almost zero beyond a few millimetres."""
STEPS = {"quick": 32_000, "paper": 96_000}
FIRST_RETURN = "return of an episode, first quarter of learning"
LAST_RETURN = "return of an episode, last quarter of learning"


def config(algorithm: str, budget: str) -> AbstractConfig:
    """Configuration of the learner; the paper prints no hyperparameters."""
    from metropilot.learn import DDPGConfig, SACConfig, Schedule

    common: dict[str, Any] = {
        "steps": STEPS[budget],
        "environments": 32,
        "evaluations": 16,
        "gamma": 0.95,
        "hidden": (64, 64),
        "batch_size": 128,
        "updates": 12,
        "buffer_size": STEPS[budget],
        "warmup": 3_200,
        "critic_rate": 1e-3,
    }
    if algorithm == "sac":
        return SACConfig(actor_rate=1e-3, **common)
    return DDPGConfig(actor_rate=5e-4, noise=Schedule(0.4, 0.1), **common)


def task(eta: str) -> ConvoyTask:
    """The following task: heads on S-curves and on random profiles, a fifth of the episodes disturbed."""
    speed, gap = ETAS[eta]
    return ConvoyTask(ConvoyTaskConfig(eta_speed=speed, eta_gap=gap, disturbed=0.2))


def jobs(algorithm: str, budget: str, eta: str, seeds: range) -> list[LearnJob]:
    """Learning runs of one algorithm, one per seed."""
    return [
        LearnJob(
            f"{NAMES[algorithm]}-{budget}-{eta}",
            config(algorithm, budget),
            partial(task, eta),
            seed,
            partial(make_evaluation, algorithm, budget),
            {"eta": eta},
        )
        for seed in seeds
    ]


def first_and_last(run: SeedResult) -> tuple[float, float]:
    """Mean return of the episodes that ended in the first and in the last quarter of learning."""
    found = run.history["return"]
    found = found[np.isfinite(found)]
    quarter = max(found.size // 4, 1)
    return float(found[:quarter].mean()), float(found[-quarter:].mean())


def make_evaluation(algorithm: str, budget: str, made: AbstractTask) -> Callable[[Any, Any], dict[str, Any]]:
    """Return the evaluation of a policy: the largest gap errors of undisturbed runs behind every head."""
    import jax
    import jax.numpy as jnp

    from metropilot.convoy import MAX_PERIODS
    from metropilot.learn import make_learner
    from metropilot.policy import act

    if not isinstance(made, ConvoyTask):
        raise TypeError("the task of following is evaluated here")
    spec = make_learner(config(algorithm, budget), made).spec
    heads, wanted = made.count, made.config.gap_m

    def evaluate(params: dict[str, Any], key: Any) -> dict[str, Any]:  # noqa: ANN401 (a JAX key)
        state, seen = jax.vmap(made.begin)(jnp.arange(heads))

        def one(carry: Any, k: Any) -> tuple[Any, None]:  # noqa: ANN401 (pytrees)
            state, seen, alive, worst, apart, total = carry
            keys = jax.random.split(jax.random.fold_in(key, k), heads)
            action = jax.vmap(lambda x: act(spec, params, x))(seen)
            state, found = jax.vmap(made.step)(keys, state, action)
            plant = state.states.plant
            length = made.members.length_m[state.row, 0]
            error = jnp.abs(plant.position_m[:, 0] - length - plant.position_m[:, 1] - wanted)
            speed = jnp.abs(plant.speed_mps[:, 0] - plant.speed_mps[:, 1])
            worst = jnp.where(alive, jnp.maximum(worst, error), worst)
            apart = jnp.where(alive, jnp.maximum(apart, speed), apart)
            total = total + jnp.where(alive, found.reward, 0.0)
            alive = alive & ~found.terminated & ~found.truncated
            return (state, found.observation, alive, worst, apart, total), None

        none = jnp.zeros((heads,), jnp.float32)
        begin = (state, seen, jnp.ones((heads,), bool), none, none, none)
        last, _ = jax.lax.scan(one, begin, jnp.arange(MAX_PERIODS, dtype=jnp.uint32))
        worst, apart, total = (jnp.mean(values) for values in last[3:])
        score = -worst - 0.2 * apart
        return {"score": score, "gap_error_m": worst, "speed_difference_mps": apart, "return": total}

    return evaluate
