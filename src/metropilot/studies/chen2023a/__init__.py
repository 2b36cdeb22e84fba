"""Chen et al. 2023: PPO with reward scaling, PPO and DDPG drive one section by position and speed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.studies.chen2023a.learning import (
        BASE_DDPG,
        BASE_PPO,
        FOLDER,
        TRIALS,
        TUNING_EPISODES,
        TUNING_SEEDS,
        set_length,
        trials,
    )
    from metropilot.studies.chen2023a.setting import make_assisted, make_evaluation

__all__ = [
    "BASE_DDPG",
    "BASE_PPO",
    "FOLDER",
    "TRIALS",
    "TUNING_EPISODES",
    "TUNING_SEEDS",
    "make_assisted",
    "make_evaluation",
    "set_length",
    "trials",
]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "learning": (
            "BASE_DDPG",
            "BASE_PPO",
            "FOLDER",
            "TRIALS",
            "TUNING_EPISODES",
            "TUNING_SEEDS",
            "set_length",
            "trials",
        ),
        "setting": (
            "make_assisted",
            "make_evaluation",
        ),
    },
)
