"""The three learners as tuned, the ablations, and the learning runs of the study."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import mean, median
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from metropilot.learn import DDPGConfig, PPOConfig, Schedule
from metropilot.studies.chen2023a.setting import make_assisted, make_evaluation, make_unassisted
from metropilot.studies.learning import LearnJob

if TYPE_CHECKING:
    from metropilot.learn import AbstractConfig

TRIALS = 40
"""Settings tried for each learner on :data:`TUNING_SEEDS` by ``benchmarks/chen2023a_tuning.py``."""
TUNING_SEEDS = (101, 102, 103, 104)
TUNING_EPISODES = 5_000
DECISIONS = 85
"""Decisions in an episode that arrives about on time; converts the paper's episodes to steps."""

FIRST_COMMAND = 0.8
"""Mean command of every policy before learning: large enough that some episodes arrive in time."""
DECAYING = ("learning_rate", "actor_rate", "critic_rate", "noise")
"""Fields that the setting ``decay`` of a trial multiplies at the end of learning, falling evenly to it."""
BASE_PPO = PPOConfig(environments=16, rollout=128, minibatches=16, initial_bias=FIRST_COMMAND, gamma=1.0)
BASE_DDPG = DDPGConfig(
    environments=16,
    updates=4,
    batch_size=64,
    buffer_size=96_000,
    initial_bias=math.atanh(FIRST_COMMAND),
    warmup=2_000,
    gamma=1.0,
    noise=0.2,
    n_step=40,
    reward_factor=0.01,
    normalise_observations=True,
)
"""The state has no time, so what an end is worth is told over many steps, not by the critic alone."""
BASE_TD3 = replace(BASE_DDPG, twin=True, smoothing=0.2, delay=2)
FOLDER = Path(__file__).parent / "trials"


def trials(learner: str) -> list[dict[str, Any]]:
    """Read the tuning trials of one learner with their scores."""
    path = FOLDER / f"{learner}.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def schedules_of(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a configuration by the settings of a trial, its ``decay`` as schedules."""
    fields = dict(settings)
    decay = fields.pop("decay", 1.0)
    if isinstance(decay, float) and decay == 1.0:
        return fields
    return {
        name: Schedule(value, decay * value) if name in DECAYING else value for name, value in fields.items()
    }


RULES: Mapping[str, Callable[[Sequence[float]], float]] = MappingProxyType(
    {"ppo": median, "ppo_scaled": median, "ddpg": mean, "td3": median}
)
"""Score of a tuning trial from those of its seeds, by learner: mean or median, whichever chose the settings
with the larger median return over the seeds of the tables."""


def best_trial(learner: str, found: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Select the trial of a learner whose settings are used."""
    return max(found, key=lambda trial: RULES[learner](trial["score"]))


def tuned_config(learner: str, base: AbstractConfig) -> AbstractConfig:
    """Configuration of a learner with the best settings of its trials."""
    found = trials(learner)
    if not found:
        return base
    return replace(base, **schedules_of(best_trial(learner, found)["settings"]))


LEARNERS: Mapping[str, AbstractConfig] = MappingProxyType(
    {
        "ppo": tuned_config("ppo", BASE_PPO),
        "ppo_scaled": tuned_config("ppo_scaled", replace(BASE_PPO, reward_scaling=True)),
        "ddpg": tuned_config("ddpg", BASE_DDPG),
    }
)
"""Configurations with the tuned settings."""
BEYOND: Mapping[str, AbstractConfig] = MappingProxyType({"td3": tuned_config("td3", BASE_TD3)})
"""Of learners that the paper does not have."""

NAMES: Mapping[str, str] = MappingProxyType(
    {"ppo": "PPO", "ppo_scaled": "PPO, reward scaling", "ddpg": "DDPG", "td3": "TD3"}
)


def ablations() -> dict[str, AbstractConfig]:
    """Plain and scaled PPO with one thing changed, both with the settings tuned for the plain one."""
    plain = LEARNERS["ppo"]
    changes = {
        "as tuned": {},
        "advantages not normalised": {"normalise_advantages": False},
        "gradients not clipped": {"max_gradient_norm": None},
        "neither": {"normalise_advantages": False, "max_gradient_norm": None},
    }
    found: dict[str, AbstractConfig] = {}
    for name, change in changes.items():
        found[f"{name}, plain"] = replace(plain, **change)
        found[f"{name}, scaled"] = replace(plain, reward_scaling=True, **change)
    found["as tuned, rewards times 0.01"] = replace(plain, reward_factor=0.01)
    return found


def set_length(config: AbstractConfig, episodes: int, chunks: int) -> AbstractConfig:
    """Set a learner's steps for about ``episodes`` episodes and about ``chunks`` evaluations."""
    a_time = config.environments * (
        config.rollout if isinstance(config, PPOConfig) else getattr(config, "collect", 1)
    )
    iterations = max(1, round(episodes * DECISIONS / a_time))
    a_chunk = max(1, round(iterations / chunks))
    evaluations = max(1, round(iterations / a_chunk))
    return replace(config, steps=evaluations * a_chunk * a_time, evaluations=evaluations)


def jobs(
    configs: Mapping[str, AbstractConfig], seeds: Sequence[int], *, assisted: bool = True, prefix: str = ""
) -> list[LearnJob]:
    """Learning runs of every learner and seed, learners varying slowest."""
    task = make_assisted if assisted else make_unassisted
    return [
        LearnJob(
            name=prefix + name.replace(", ", "-").replace(" ", "_"),
            config=config,
            task=task,
            seed=seed,
            evaluation=partial(make_evaluation, config),
            about={"task": task.__name__, "setting": SETTING},
        )
        for name, config in configs.items()
        for seed in seeds
    ]


SETTING = 3
"""Version of the task; increment it when the task changes, so that stored runs are repeated."""
