"""Statements of Chen et al. 2023 about figures 5 to 19. The paper prints no table of results and no kWh."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

CITATION = (
    "Chen, B.; Gao, C.; Zhang, L.; Chen, J.; Chen, J.; Li, Y. Optimal Control Algorithm for Subway Train "
    "Operation by Proximal Policy Optimization. *Applied Sciences* 13 (2023), 7456."
)
PRESCRIBED_S = 80.0
THRESHOLD_S = 88.0
EPISODES = 20_000
PPO_EPISODES = 21_000
"""Section 4: "not yet converged over 21,000 episodes"."""

CONVERGED_AT: Mapping[str, float] = MappingProxyType({"ppo_scaled": 3000.0, "ddpg": 3000.0})
"""Episodes after which the reward is called stable (figs. 5 and 7); plain PPO never (fig. 6)."""
CONVERGED: Mapping[str, float] = MappingProxyType({"ppo": 0.0, "ppo_scaled": 1.0, "ddpg": 1.0})
"""Share of the runs whose reward converged: one run each."""
LOSS_CONVERGED: Mapping[str, float] = MappingProxyType({"ppo": 0.0, "ppo_scaled": 1.0, "ddpg": 0.0})
"""Share of the runs whose loss converged (figs. 8 to 10)."""
ENERGY_ORDER = ("ddpg", "ppo_scaled", "ppo")
"""Most energy first (figs. 14 to 16): DDPG "much higher", plain PPO lowest because it is late."""
IMPACT_ORDER = ("ddpg", "ppo_scaled", "ppo")
"""Highest mean impact rate first (figs. 17 to 19)."""
