"""Cases of the paper with its published results, the task of the learners, the plant, the runs of the cases.

Most cells of its Tables 1 to 4 are pictures; the numbers here are from its text. Energies of the other
drivers are printed as percentages of manual driving.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from metropilot import env
from metropilot.railway import Actuation, Restriction, Section, Trainset, load_line, load_trainset
from metropilot.sim import Disturbance, Run, TimetableUpdate
from metropilot.studies.huang2025.env import ExpertAction, ExpertChoiceAction
from metropilot.units import KMH_PER_MPS

CITATION = (
    "Y. Huang, W. Lai, D. Chen, G. Lin, J. Yin: Enhanced intelligent train operation algorithms for metro "
    "train based on expert system and deep reinforcement learning. PLoS ONE 20(5), 2025, e0323478, "
    "doi 10.1371/journal.pone.0323478."
)
DECISION_US = 2100.0
"""Published mean decision time, 2.1 ms."""
TABLE2, TABLE3, TABLE4 = "Cases 1 and 2: its Table 2", "Late updates: its Table 3", "Case 3: its Table 4"
BEYOND = "Beyond the paper"

MANUAL, ITOR, STON, STOD, EITOE, EITOP = "manual", "itor", "ston", "stod", "eitoe", "eitop"
BRISK_EITOE = "eitoe at 0.8 m/s²"
"""The expert with EITOP's acceleration limit."""
EQUAL_EITOE = "eitoe at 0.8 m/s², arrival of eitop"
"""The same, told a scheduled time with which it arrives when EITOP does."""
LEARNED = (ITOR, STON, STOD, EITOP)
EXPERTS = (EITOE, EITOP)


@dataclass(frozen=True)
class PublishedCase:
    """One run to drive.

    Attributes:
        id: Short name.
        name: Name in tables.
        table: Table of the paper.
        scheduled_s: Planned running time at departure.
        origin: Station code.
        destination: Station code.
        drivers: Ids of the compared drivers.
        told_s: Time of the timetable update; None: no update.
        news_s: New planned running time of the update.
        restricted: Temporary speed restriction of the update.
        published: Published values by driver and KPI.
    """

    id: str
    name: str
    table: str
    scheduled_s: float
    origin: str = "RJ"
    destination: str = "WYJ"
    drivers: tuple[str, ...] = (*EXPERTS, BRISK_EITOE)
    told_s: float | None = None
    news_s: float | None = None
    restricted: Restriction | None = None
    published: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def published_value(self, driver: str, kpi: str) -> float | None:
        """Published value; None where the paper prints none."""
        return self.published.get(driver, {}).get(kpi)


IE, IC, RELATIVE, COAST, TOP, TOOK = (
    "Ie",
    "Ic",
    "Ie against manual",
    "coasting distance",
    "highest speed",
    "running time",
)
ALL = (MANUAL, ITOR, STON, STOD, EITOE, BRISK_EITOE, EITOP, "optimal")

CASES: tuple[PublishedCase, ...] = (
    PublishedCase(
        id="101",
        name="RJ to WYJ, 101 s",
        table=TABLE2,
        scheduled_s=101.0,
        drivers=ALL,
        published={
            MANUAL: {COAST: 677.99},
            ITOR: {RELATIVE: 1.7, COAST: 398.78},
            STON: {RELATIVE: -11.7, COAST: 661.46},
            EITOE: {IE: 380.0, RELATIVE: -34.9, COAST: 899.78, TOP: 19.49},
            EITOP: {IE: 364.0, RELATIVE: -37.7},
        },
    ),
    PublishedCase(
        id="95",
        name="RJ to WYJ, 95 s",
        table=TABLE2,
        scheduled_s=95.0,
        drivers=ALL,
        published={
            ITOR: {RELATIVE: 5.2, TOP: 22.22},
            STON: {RELATIVE: -8.8},
            EITOE: {RELATIVE: -45.0},
            EITOP: {RELATIVE: -45.0, IC: 2.92},
        },
    ),
    PublishedCase(
        id="115",
        name="RJ to WYJ, 115 s",
        table=TABLE2,
        scheduled_s=115.0,
        drivers=ALL,
        published={
            MANUAL: {TOP: 14.73},
            ITOR: {RELATIVE: 0.5, TOP: 14.69},
            STON: {RELATIVE: -1.5, TOP: 14.65},
            EITOE: {RELATIVE: 4.8, TOP: 16.15},
            EITOP: {RELATIVE: -2.7, TOP: 16.10, TOOK: 114.0},
        },
    ),
    PublishedCase(
        id="later",
        name="101 s, 15 s later, sent at 30 s",
        table=TABLE3,
        scheduled_s=101.0,
        told_s=30.0,
        news_s=116.0,
        published={EITOP: {TOOK: 114.0}},
    ),
    PublishedCase(
        id="earlier",
        name="101 s, 10 s earlier, sent at 10 s",
        table=TABLE3,
        scheduled_s=101.0,
        told_s=10.0,
        news_s=91.0,
        published={EITOP: {TOOK: 88.0}},
    ),
    PublishedCase(
        id="restricted",
        name="115 s, 40 km/h from 700 to 900 m, sent at 30 s",
        table=TABLE3,
        scheduled_s=115.0,
        told_s=30.0,
        restricted=Restriction(700.0, 900.0, 40.0 / KMH_PER_MPS),
    ),
    PublishedCase(
        id="restricted-101",
        name="101 s, 40 km/h from 700 to 900 m, sent at 30 s",
        table=TABLE3,
        scheduled_s=101.0,
        told_s=30.0,
        restricted=Restriction(700.0, 900.0, 40.0 / KMH_PER_MPS),
    ),
    PublishedCase(
        id="sjz",
        name="SJZ to XC, 190 s",
        table=TABLE4,
        origin="SJZ",
        destination="XC",
        scheduled_s=190.0,
        published={EITOE: {TOOK: 188.0}, EITOP: {TOOK: 189.0}},
    ),
    PublishedCase(
        id="xc",
        name="XC to XHM, 108 s",
        table=TABLE4,
        origin="XC",
        destination="XHM",
        scheduled_s=108.0,
        published={EITOE: {TOOK: 112.0}, EITOP: {TOOK: 109.0}},
    ),
)
BY_ID: Mapping[str, PublishedCase] = MappingProxyType({case.id: case for case in CASES})
EPISODES_TO_SETTLE = 80
"""Episodes in which the energy falls from 380 to 364 J/kg in Figs. 5 and 6, approximately."""
LEARNED_IE = (380.0, 364.0)


LINE, TRAINSET = "yizhuang-ttobench", "dkz32"
REWARDS = (
    env.Energy(),
    env.Punctuality(per_s=3.0, soft_s=0.5),
    env.Comfort(weight=0.2),
    env.Failure(price=20.0, per_m=0.05),
    env.Intervention(),
)
"""Huang25 eq. 26: energy, time error (eq. 27 at the end) and comfort; its weights are not printed."""
STOP_MPS2 = 0.95
"""Planned deceleration of the station stop."""
LEARNED_ON = (("RJ", "WYJ"), ("WYJ", "RJ"), ("XC", "XHM"), ("JG", "YZQ"))
"""Sections of the line that can be coasted to the end; the first is case 1."""
ON_THE_WAY = 0.7
"""Share of the episodes that begin between stations."""
DELAY_S, LAG_S = 0.6, 0.4
"""Dead time and time constant of its eq. 4 (assumed: no value can be read)."""
GENTLE_MPS2 = {EITOP: 0.8, BRISK_EITOE: 0.8, EQUAL_EITOE: 0.8}
"""Largest acceleration by driver; all other expert drivers keep rule 2."""
RULE2_MPS2 = 0.6
FREE = ("manual", "optimal", "flat_out")
"""Drivers that keep only the trainset's own limit of 1 m/s^2."""


def task_config() -> env.DrivingConfig:
    """Task ``huang2025``: the policy inside the expert changes the rate by a continuous value."""
    return _task_config(ExpertAction())


def choice_task_config() -> env.DrivingConfig:
    """Task ``huang2025_choices``: the policy selects one of three changes of the rate."""
    return _task_config(ExpertChoiceAction())


def gentle(config: env.DrivingConfig) -> env.DrivingConfig:
    """Limit the acceleration by the paper's second rule."""
    return replace(config, action=ExpertAction(start_mps2=RULE2_MPS2))


def _task_config(action: env.AbstractAction) -> env.DrivingConfig:
    line = load_line(LINE)
    return env.DrivingConfig(
        sections=tuple(line.section(*ends) for ends in LEARNED_ON),
        trainsets=(load_trainset(TRAINSET),),
        scenarios=env.DisturbanceDistribution(time_ratio=(1.08, 1.45), news=0.2, on_the_way=ON_THE_WAY),
        observer=("expert",),
        action=action,
        rewards=REWARDS,
        assists=env.Assists(stop_mps2=STOP_MPS2),
    )


def trainset() -> Trainset:
    """DKZ32, empty, with the actuation of eq. 4 and no other limit on the change of effort."""
    return replace(load_trainset(TRAINSET), actuation=Actuation(DELAY_S, LAG_S, float("inf")))


def section(case: PublishedCase) -> Section:
    """Section of a case."""
    return load_line(LINE).section(case.origin, case.destination)


def run_of(case: PublishedCase, seed: int = 0) -> Run:
    """Run of a case, with its timetable update."""
    news: tuple[TimetableUpdate, ...] = ()
    if case.told_s is not None:
        news = (TimetableUpdate(case.told_s, scheduled_time_s=case.news_s, restriction=case.restricted),)
    return Run(section(case), trainset(), case.scheduled_s, Disturbance(updates=news), seed=seed)


def comfortable(driver: str, plant: Trainset) -> Trainset:
    """Trainset with a driver's comfort limits, for its optimum."""
    if driver in FREE:
        return plant
    return replace(plant, max_acceleration_mps2=GENTLE_MPS2.get(driver, RULE2_MPS2))
