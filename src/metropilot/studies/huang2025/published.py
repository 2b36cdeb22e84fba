"""Cases of the paper and its published results.

Most cells of its Tables 1 to 4 are pictures; the numbers here are from its text. Energies of the other
drivers are printed as percentages of manual driving.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

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
LEARNED = (ITOR, STON, STOD, EITOP)
EXPERTS = (EITOE, EITOP)


@dataclass(frozen=True)
class PublishedRestriction:
    """A temporary speed restriction.

    Attributes:
        from_m: Start.
        to_m: End.
        limit_mps: Permitted speed.
    """

    from_m: float
    to_m: float
    limit_mps: float


@dataclass(frozen=True)
class PublishedCase:
    """One run to drive.

    Attributes:
        id: Short name.
        name: Name in tables.
        table: Table of the paper.
        origin: Station code.
        destination: Station code.
        scheduled_s: Planned running time at departure.
        drivers: Ids of the compared drivers.
        told_s: Time of the timetable update; None: no update.
        news_s: New planned running time of the update.
        restricted: Temporary speed restriction of the update.
        published: Published values by driver and KPI.
    """

    id: str
    name: str
    table: str
    origin: str
    destination: str
    scheduled_s: float
    drivers: tuple[str, ...]
    told_s: float | None = None
    news_s: float | None = None
    restricted: PublishedRestriction | None = None
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
ALL = (MANUAL, ITOR, STON, STOD, EITOE, EITOP, "optimal")

CASES: tuple[PublishedCase, ...] = (
    PublishedCase(
        id="101",
        name="RJ to WYJ, 101 s",
        table=TABLE2,
        origin="RJ",
        destination="WYJ",
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
        origin="RJ",
        destination="WYJ",
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
        origin="RJ",
        destination="WYJ",
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
        origin="RJ",
        destination="WYJ",
        scheduled_s=101.0,
        drivers=EXPERTS,
        told_s=30.0,
        news_s=116.0,
        published={EITOP: {TOOK: 114.0}},
    ),
    PublishedCase(
        id="earlier",
        name="101 s, 10 s earlier, sent at 10 s",
        table=TABLE3,
        origin="RJ",
        destination="WYJ",
        scheduled_s=101.0,
        drivers=EXPERTS,
        told_s=10.0,
        news_s=91.0,
        published={EITOP: {TOOK: 88.0}},
    ),
    PublishedCase(
        id="restricted",
        name="115 s, 40 km/h from 700 to 900 m, sent at 30 s",
        table=TABLE3,
        origin="RJ",
        destination="WYJ",
        scheduled_s=115.0,
        drivers=EXPERTS,
        told_s=30.0,
        restricted=PublishedRestriction(700.0, 900.0, 40.0 / KMH_PER_MPS),
    ),
    PublishedCase(
        id="restricted-101",
        name="101 s, 40 km/h from 700 to 900 m, sent at 30 s",
        table=TABLE3,
        origin="RJ",
        destination="WYJ",
        scheduled_s=101.0,
        drivers=EXPERTS,
        told_s=30.0,
        restricted=PublishedRestriction(700.0, 900.0, 40.0 / KMH_PER_MPS),
    ),
    PublishedCase(
        id="sjz",
        name="SJZ to XC, 190 s",
        table=TABLE4,
        origin="SJZ",
        destination="XC",
        scheduled_s=190.0,
        drivers=EXPERTS,
        published={EITOE: {TOOK: 188.0}, EITOP: {TOOK: 189.0}},
    ),
    PublishedCase(
        id="xc",
        name="XC to XHM, 108 s",
        table=TABLE4,
        origin="XC",
        destination="XHM",
        scheduled_s=108.0,
        drivers=EXPERTS,
        published={EITOE: {TOOK: 112.0}, EITOP: {TOOK: 109.0}},
    ),
)
BY_ID: Mapping[str, PublishedCase] = MappingProxyType({case.id: case for case in CASES})
EPISODES_TO_SETTLE = 80
"""Episodes in which the energy falls from 380 to 364 J/kg in Figs. 5 and 6, approximately."""
LEARNED_IE = (380.0, 364.0)
