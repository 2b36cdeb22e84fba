"""Plans and published results of the paper's Table 5, and the task: notches, rewards, the time filter."""

from __future__ import annotations

from dataclasses import dataclass, replace

from metropilot import env
from metropilot.railway import Section, load_line, load_trainset
from metropilot.studies.lu2023 import env as lu2023_env

CITATION = (
    "T. Lu and B. Liu: Automatic Driving Operation Strategy of Urban Rail Train Based on Improved DQN "
    "Algorithm. "
    "Computers, Materials & Continua, 2023 (Lu23 in these pages)."
)
RULES = "eitoe"
"""Driver by rules alone, the simple rival; its effort is continuous."""
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

    @property
    def section(self) -> Section:
        """Its section."""
        return load_line(self.line).section("WHY", "WYJ")


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


def plan_case(plan_id: str) -> PlanCase:
    """A plan by id."""
    return next(plan for plan in PLANS if plan.id == plan_id)


TRAINSET, NOTCHES = "lu2023", "lu2023"
LINES = ("lu2023", "lu2023-restricted")
"""The section without and with 55 km/h from 600 to 930 m."""
PERIOD_S = 3.0
MARGIN = 0.03
"""Relative margin on the filter's flat-out time, for protection and the steps of the notches."""
MOST_MPS2 = 0.8
"""Largest acceleration and deceleration in the paper."""
ASSISTS = env.Assists(margin_mps=0.02, stop_use=0.98, let_go=0.3)
"""Station-stop braking by the two strongest notches, close to the trainset's best."""
LATE_S, SOFT_S = 0.1, 3.0
"""Lateness that earns the whole bonus while learning, and the one over which it is lost (the paper: 3 s)."""
TIME_BONUS, STOP_BONUS = 1000.0, 500.0
"""Bonuses of time and stop."""
WORK_PER_J, JUMP, SWITCH = 2e-5, 2.0, 10.0
"""Prices of work, of a jump of the acceleration and of a change of regime."""
ALL_TIMES_S = (118.0, 142.0)
ON_THE_WAY, LEFT_RATIO = 0.4, (1.0, 1.5)
"""Share of episodes that begin between stations, and their range of time left over flat-out time to go."""
REWARDS = (
    env.OnTime(bonus=TIME_BONUS, allowed_s=LATE_S, soft_s=SOFT_S),
    lu2023_env.EffortEnergy(per_j=WORK_PER_J),
    lu2023_env.StopWindow(bonus=STOP_BONUS),
    lu2023_env.AccelerationComfort(jump_price=JUMP),
    lu2023_env.Moving(),
    lu2023_env.RegimeSwitch(price=SWITCH),
)
"""Lu23 eqs. 15 to 20, and a price of changes between traction, coasting and braking."""
STATE = ("position", "speed", "time_left", "reserve", "permitted_ahead", "command")
"""Position, speed, time left, the filter's reserve (time left beyond flat-out time to go), limits ahead."""
ACTION = lu2023_env.NotchForceAction(margin=MARGIN, most_mps2=MOST_MPS2, below_mps=0.03, late_brake=True)
"""The notches, and which of them can be chosen."""


def task_config() -> env.DrivingConfig:
    """Task ``lu2023``: both lines, running times of all plans, time left and limits ahead observed."""
    return env.DrivingConfig(
        sections=tuple(load_line(line).section("WHY", "WYJ") for line in LINES),
        trainsets=(load_trainset(TRAINSET),),
        scenarios=_times(ALL_TIMES_S),
        observer=STATE,
        action=ACTION,
        rewards=REWARDS,
        assists=ASSISTS,
        dt=lu2023_env.CONTROL_S,
        periods=round(PERIOD_S / lu2023_env.CONTROL_S),
        most_decisions=75,
    )


def without_filter(config: env.DrivingConfig) -> env.DrivingConfig:
    """Remove the minimum-arrival-time filter from a task."""
    return replace(config, action=replace(ACTION, in_time=False))


def plan_task(plan: PlanCase, *, filtered: bool) -> env.DrivingTask:
    """Make the task of one plan, as in the paper: one line, one scheduled time."""
    config = task_config() if filtered else without_filter(task_config())
    return env.DrivingTask(
        replace(config, sections=(plan.section,), scenarios=_times((plan.scheduled_s, plan.scheduled_s)))
    )


def _times(times_s: tuple[float, float]) -> env.DisturbanceDistribution:
    return env.DisturbanceDistribution(time_s=times_s, on_the_way=ON_THE_WAY, left_ratio=LEFT_RATIO)
