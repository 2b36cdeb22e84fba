"""Search for the settings of study chen2023a: the same number of random trials for each learner.

``python -m benchmarks.chen2023a_tuning LEARNER [TRIALS]`` writes one JSON line a trial into the folder
``trials`` of the study, which takes its settings there, and goes on from what it finds. PPO with and without
scaling try the same settings, and so do DDPG and TD3. A trial learns a few thousand episodes on the study's
tuning seeds, which no table reports; the score of a seed is the mean evaluation return over the last fifth
of the learning.
"""

from __future__ import annotations

import copy
import json
import random
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from metropilot.learn import AbstractConfig
from metropilot.studies.chen2023a import (
    BASE_DDPG,
    BASE_PPO,
    BASE_TD3,
    FOLDER,
    TRIALS,
    TUNING_EPISODES,
    TUNING_SEEDS,
    best_trial,
    schedules_of,
    set_length,
    trials,
)

DISCOUNTS = (0.997, 1.0)
"""A smaller one changes what is asked for: at 0.99 the bonus of the arrival is worth less than half at the
start, and the best return so discounted is an early, dear arrival."""
PPO_SPACE: dict[str, tuple[float, ...]] = {
    "learning_rate": (1e-4, 3e-4, 1e-3),
    "decay": (1.0, 0.1),
    "lambda_": (0.9, 0.95, 0.99),
    "gamma": DISCOUNTS,
    "clip": (0.1, 0.2),
    "initial_std": (0.2, 0.4, 0.6),
    "entropy": (0.0, 0.003),
}
DDPG_SPACE: dict[str, tuple[float, ...]] = {
    "actor_rate": (1e-4, 3e-4, 1e-3),
    "critic_rate": (3e-4, 1e-3, 3e-3),
    "decay": (1.0, 0.1),
    "gamma": DISCOUNTS,
    "noise": (0.1, 0.2, 0.4),
    "tau": (0.001, 0.005, 0.02),
}
BASES: dict[str, tuple[AbstractConfig, dict[str, tuple[float, ...]]]] = {
    "ppo": (BASE_PPO, PPO_SPACE),
    "ppo_scaled": (replace(BASE_PPO, reward_scaling=True), PPO_SPACE),
    "ddpg": (BASE_DDPG, DDPG_SPACE),
    "td3": (BASE_TD3, DDPG_SPACE),
}
Values = dict[str, float]


def settings(base: AbstractConfig, space: dict[str, tuple[float, ...]], trials: int) -> list[Values]:
    """Settings that are tried: the base settings first, then random ones, the same in every call."""
    draw = random.Random(2023)
    first = {name: 1.0 if name == "decay" else float(getattr(base, name)) for name in space}
    return [first] + [
        {name: draw.choice(values) for name, values in space.items()} for _ in range(trials - 1)
    ]


def program(base: AbstractConfig) -> Callable[[Values], dict[str, Any]]:
    """Learns on every tuning seed in turn; the settings are arguments, so it is compiled once."""
    import jax
    import numpy as np

    from metropilot.learn import keep_compiled, learn
    from metropilot.studies.chen2023a import make_assisted, make_evaluation

    keep_compiled()
    config = set_length(base, TUNING_EPISODES, 30)
    task = make_assisted()
    evaluate = make_evaluation(config, task)
    keys = jax.vmap(jax.random.key)(np.array(TUNING_SEEDS, np.uint32))

    def run(values: dict[str, Any]) -> dict[str, Any]:
        told = copy.copy(config)
        for name, value in schedules_of(values).items():
            object.__setattr__(told, name, value)
        return jax.lax.map(lambda key: learn(told, task, key, evaluate)[1], keys)

    compiled = jax.jit(run)
    return lambda values: compiled({name: np.float32(value) for name, value in values.items()})


def trial(learned: Callable[[Values], dict[str, Any]], values: Values) -> dict[str, Any]:
    """One setting and what came of it, a number a seed."""
    import numpy as np

    begun = time.perf_counter()
    history = {name: np.asarray(column) for name, column in learned(values).items()}
    names = ("score", "running_time_s", "energy_kwh", "arrived")
    late = {name: history[f"evaluation.{name}"] for name in names}
    late = {name: column[:, -(column.shape[1] // 5) :].mean(axis=1) for name, column in late.items()}
    told = {name: [round(float(v), 3) for v in column] for name, column in late.items()}
    seconds = round(time.perf_counter() - begun, 1)
    return {"settings": values, "mean": float(late["score"].mean()), **told, "seconds": seconds}


def main(learner: str, count: int = TRIALS) -> None:
    """Do the trials that are not there, then say which was best."""
    base, space = BASES[learner]
    done, path = trials(learner), FOLDER / f"{learner}.jsonl"
    todo = settings(base, space, count)[len(done) :]
    learned = program(base) if todo else None
    FOLDER.mkdir(exist_ok=True)
    for values in todo:
        assert learned is not None
        done.append(trial(learned, values))
        with path.open("a") as file:
            file.write(json.dumps(done[-1]) + "\n")
    print(learner, json.dumps(best_trial(learner, done)))


if __name__ == "__main__":
    main(sys.argv[1], *(int(n) for n in sys.argv[2:]))
