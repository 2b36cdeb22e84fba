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
        sized,
        trials,
    )
    from metropilot.studies.chen2023a.setting import make_assisted, measured

__all__ = [
    "BASE_DDPG",
    "BASE_PPO",
    "FOLDER",
    "TRIALS",
    "TUNING_EPISODES",
    "TUNING_SEEDS",
    "make_assisted",
    "measured",
    "sized",
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
            "sized",
            "trials",
        ),
        "setting": (
            "make_assisted",
            "measured",
        ),
    },
)
