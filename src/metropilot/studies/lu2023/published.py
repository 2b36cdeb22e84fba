"""Published results of Lu and Liu 2023, and the plans of their Table 5."""

from __future__ import annotations

from dataclasses import dataclass

CITATION = (
    "T. Lu and B. Liu: Automatic Driving Operation Strategy of Urban Rail Train Based on Improved DQN "
    "Algorithm. "
    "Computers, Materials & Continua, 2023 (Lu23 in these pages)."
)
TABLE, CONVERGENCE, ABLATION, BEYOND = (
    "Table 5: arrival of the plans",
    "Figures 6 and 7: episodes to convergence",
    "Beyond the paper: each improvement off in turn",
    "Beyond the paper: one network for all plans",
)


@dataclass(frozen=True)
class Published:
    """One column of Table 5.

    Attributes:
        stop_m: Stopping error.
        late_s: Size of the time error.
        kwh: Energy of the section; the paper does not state if braking work is included.
    """

    stop_m: float
    late_s: float
    kwh: float


@dataclass(frozen=True)
class PlanCase:
    """One plan: a scheduled time, with or without the restriction.

    Attributes:
        id: Id in file names.
        name: Name in tables.
        scheduled_s: Scheduled running time.
        restricted: 55 km/h from 600 to 930 m.
        published: Column of Table 5.
    """

    id: str
    name: str
    scheduled_s: float
    restricted: bool
    published: Published

    @property
    def line(self) -> str:
        """Id of its line in the catalogue."""
        return "lu2023-restricted" if self.restricted else "lu2023"


PLANS = (
    PlanCase("120", "120 s", 120.0, False, Published(0.27, 1.3, 17.054)),
    PlanCase("120-restricted", "120 s, 55 km/h at 600-930 m", 120.0, True, Published(0.10, 1.2, 25.68)),
    PlanCase("130", "130 s", 130.0, False, Published(0.10, 0.6, 14.802)),
    PlanCase("140", "140 s", 140.0, False, Published(0.16, 0.9, 12.89)),
)
PID_130 = Published(0.21, 4.1, 15.12)
EPISODES = {("120", "improved_dqn"): 800.0, ("120", "dqn"): 1100.0, ("130", "improved_dqn"): 2100.0}
"""Episodes to convergence as the paper states them; plain DQN at 130 s does not converge."""
FASTER_PERCENT = 37.0
PID_SWITCHES_IN_500_M = 13.0


def plan_case(plan_id: str) -> PlanCase:
    """A plan by id."""
    return next(plan for plan in PLANS if plan.id == plan_id)
