"""Chen et al. 2023: PPO with reward scaling, PPO and DDPG drive one section by position and speed."""

from __future__ import annotations

from metropilot.studies.chen2023a.reproduce import reproduce
from metropilot.studies.study import Study

__all__ = ["STUDY"]

STUDY = Study(
    id="chen2023a",
    title="Chen et al. 2023: PPO with reward scaling",
    citation=(
        "Chen, B.; Gao, C.; Zhang, L.; Chen, J.; Chen, J.; Li, Y. Optimal Control Algorithm for Subway Train "
        "Operation by Proximal Policy Optimization. *Applied Sciences* 13 (2023), 7456."
    ),
    reproduce=reproduce,
)
