"""Learning runs: recipes, evaluation during learning, and the policy files."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metropilot import learn
from metropilot.studies.huang2025.setting import LEARNED, gentle
from metropilot.studies.learning import LearnJob, SeedResult, drive_to_end, write_policy
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot.env import DrivingTask
    from metropilot.learn import AbstractConfig, PolicyEvaluation

COMMAND = "metropilot reproduce huang2025 --budget paper"
WATCHED_S = 101.0
EITOP_BASE = replace(
    learn.PPO_BASE,
    steps=3_000_000,
    environments=128,
    minibatches=8,
    hidden=(32, 32),
    normalise_observations=False,
    evaluations=12,
)
EITOP_RECIPE = learn.Recipe("huang2025", EITOP_BASE, {"steps": 1_000_000, "evaluations": 6})
ITOR_BASE = replace(
    learn.TABLE_BASE,
    steps=8_000_000,
    environments=256,
    bins=(40, 24, 1, 4, 1, 12, 1),
    low=(0.0, 0.0, 0.0, -0.6, 0.0, -3.0, -1.0),
    high=(2.0, 1.2, 2.0, 0.6, 1.2, 3.0, 1.0),
)
"""Of the expert policies' features the table uses distance, speed, rate and the lateness under coasting."""
ITOR_RECIPE = learn.Recipe("huang2025_choices", ITOR_BASE, {"steps": 2_000_000, "evaluations": 8})
STO: dict[str, Any] = {
    **learn.REPLAY_BASE,
    "steps": 160_000,
    "updates": 8,
    "batch_size": 128,
    "hidden": (64, 64),
    "gamma": 0.999,
    "n_step": 10,
    "noise": learn.Schedule(0.6, 0.1),
}
"""Hyperparameters of STOD and STON."""
STOD_RECIPE = learn.Recipe("huang2025", learn.DDPGConfig(**STO), learn.REPLAY_QUICK, changes=gentle)
STON_RECIPE = learn.Recipe("huang2025", learn.NAFConfig(**STO), learn.REPLAY_QUICK, changes=gentle)


def make_task(driver: str) -> DrivingTask:
    """Make the task of a driver's recipe."""
    return learn.RECIPES.get(driver).make_task()


def make_evaluation(config: AbstractConfig, driver: str, task: Any) -> PolicyEvaluation:  # noqa: ANN401 (a driving task)
    """Return the evaluation of a policy: the recipe's own rule, and Ie and time of case 1.

    Args:
        config: Configuration of the learner.
        driver: Id of the driver.
        task: Task of its recipe.
    """
    import jax
    import jax.numpy as jnp

    from metropilot.env import starts
    from metropilot.learn import DrivingEvaluation, make_learner
    from metropilot.policy import act
    from metropilot.sim import running_time

    del driver
    spec = make_learner(config, task).spec
    rule = DrivingEvaluation(task, spec)
    begin = jax.tree.map(lambda x: x[0], starts([0], [WATCHED_S]))

    def case1(params: Any, key: Any) -> dict[str, Any]:  # noqa: ANN401 (arrays)
        def gain(before: Any, after: Any, _: Any) -> Any:  # noqa: ANN401 (arrays)
            moved = after.plant.position_m - before.plant.position_m
            return jnp.abs(after.plant.acceleration_mps2) * moved

        state, ie = drive_to_end(task, partial(act, spec, params), task.begin(begin), key, 320, gain)
        took = running_time(state.run)
        return {"case1_ie_jpkg": ie, "case1_time_s": took, "case1_kwh": state.plant.traction_j / J_PER_KWH}

    def evaluate(params: Any, key: Any) -> dict[str, Any]:  # noqa: ANN401 (arrays)
        return {**rule(params, key), **case1(params, key)}

    return evaluate


def job(driver: str, seed: int, budget: str) -> LearnJob:
    """One learning run of a driver."""
    config = learn.RECIPES.get(driver).configuration(budget)
    name = driver if budget == "paper" else f"quick-{driver}"
    evaluation = partial(make_evaluation, config, driver)
    return LearnJob(name, config, partial(make_task, driver), seed, evaluation, {"driver": driver})


def write_result(folder: Path, result: SeedResult) -> Path:
    """Write the policy of a learning run."""
    path = folder / f"{result.job.name}-{result.job.seed}.safetensors"
    return write_policy(path, result, COMMAND, task=learn.RECIPES.get(result.job.about["driver"]).task)


def jobs(seeds: range, budget: str) -> list[LearnJob]:
    """Learning runs of the study, drivers varying slowest."""
    return [job(driver, seed, budget) for driver in LEARNED for seed in seeds]
