"""Search for the settings of study chen2023a: the same number of random trials for each learner.

``python -m benchmarks.chen2023a_tuning LEARNER FILE [TRIALS]`` writes one JSON line a trial and goes on from
the file it finds. PPO and PPO with reward scaling try the same settings. A trial learns a few thousand
episodes on the study's tuning seeds, which no table reports; its score is the mean evaluation return over the
second half of the learning.
"""

from __future__ import annotations

import json
import random
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from metropilot.learn import AbstractConfig
from metropilot.studies.chen2023a.learners import (
    BASE_DDPG,
    BASE_PPO,
    TRIALS,
    TUNING_EPISODES,
    TUNING_SEEDS,
    sized,
)

PPO_SPACE: dict[str, tuple[Any, ...]] = {
    "learning_rate": (1e-4, 3e-4, 1e-3),
    "environments": (16, 64),
    "epochs": (4, 10),
    "lambda_": (0.95, 0.99),
    "gamma": (0.99, 0.997, 1.0),
    "initial_std": (0.3, 0.6),
    "entropy": (0.0, 0.003),
}
DDPG_SPACE: dict[str, tuple[Any, ...]] = {
    "actor_rate": (1e-4, 3e-4, 1e-3),
    "critic_rate": (3e-4, 1e-3, 3e-3),
    "tau": (0.001, 0.005, 0.02),
    "gamma": (0.99, 0.997, 1.0),
    "noise": (0.1, 0.2, 0.4),
    "noise_kind": ("gaussian", "ornstein_uhlenbeck"),
    "batch_size": (64, 128),
}
BASES: dict[str, tuple[Any, dict[str, tuple[Any, ...]]]] = {
    "ppo": (BASE_PPO, PPO_SPACE),
    "ppo_scaled": (replace(BASE_PPO, reward_scaling=True), PPO_SPACE),
    "ddpg": (BASE_DDPG, DDPG_SPACE),
}


def settings(space: dict[str, tuple[Any, ...]], trials: int) -> list[dict[str, Any]]:
    """What is tried: the base settings first, then random ones, the same in every call."""
    draw = random.Random(2023)
    return [{}] + [{name: draw.choice(values) for name, values in space.items()} for _ in range(trials - 1)]


def trial(base: AbstractConfig, changes: dict[str, Any]) -> dict[str, Any]:
    """Learn on every tuning seed, side by side in one program."""
    import jax
    import numpy as np

    from metropilot.learn import learn
    from metropilot.studies.chen2023a.setting import make_assisted, measured

    config = sized(replace(base, **changes), TUNING_EPISODES, 30)
    task = make_assisted()
    begun = time.perf_counter()
    one = partial(learn, config, task, evaluate=measured(config, task))
    _, history = jax.jit(jax.vmap(one))(jax.vmap(jax.random.key)(np.array(TUNING_SEEDS, np.uint32)))
    half = {
        name: np.asarray(history[f"evaluation.{name}"])[:, 15:]
        for name in ("score", "running_time_s", "energy_kwh")
    }
    scores = half["score"].mean(axis=1)
    return {
        "changes": changes,
        "score": float(scores.mean()),
        "scores": scores.round(2).tolist(),
        "running_time_s": half["running_time_s"].mean(axis=1).round(2).tolist(),
        "energy_kwh": half["energy_kwh"].mean(axis=1).round(2).tolist(),
        "seconds": round(time.perf_counter() - begun, 1),
    }


def main(learner: str, path: Path, trials: int = TRIALS) -> None:
    """Do the trials that the file does not hold, then say which was best."""
    base, space = BASES[learner]
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    for changes in settings(space, trials)[len(done) :]:
        done.append(trial(base, changes))
        with path.open("a") as file:
            file.write(json.dumps(done[-1]) + "\n")
    print(learner, json.dumps(max(done, key=lambda found: found["score"])))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *(int(n) for n in sys.argv[3:]))
