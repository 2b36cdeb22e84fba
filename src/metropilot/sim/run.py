"""Run: one trip from a stop to the next, with its disturbance; observation and outcome of a run."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, field
from enum import Enum
from typing import NamedTuple

from metropilot._schema import CheckedFields, declare
from metropilot.protection import Bounds
from metropilot.railway import Section, Trainset
from metropilot.sim.disturbance import Disturbance

CONTROL_PERIOD_S = 0.2
PUNCTUALITY_S = 3.0
"""Largest deviation from the scheduled running time that counts as punctual."""
STOP_TOLERANCE_M = 0.3
"""Largest stop error at which the trainset has arrived."""


class Outcome(Enum):
    """Outcome of a run; a value, never an exception."""

    ARRIVED = "arrived"
    OVERSHOT = "overshot"
    OVERSPEED = "overspeed"
    STALLED = "stalled"
    OUT_OF_TIME = "out_of_time"


@dataclass(frozen=True)
class Run(CheckedFields):
    """One trip from a stop to the next.

    Attributes:
        section: Section.
        trainset: Nominal trainset.
        scheduled_time_s: Scheduled running time, s.
        disturbance: Disturbance, unknown to the driver.
        dt: Control period, s.
        seed: Seed of all random numbers of the run.
        coupled: Nominal trainsets virtually coupled behind, each with the distance of its front from that of
            this trainset. The section's limits hold until the last of them has cleared them.
        bounds: Bounds that protection allows for; None: those of the disturbance
            (:func:`metropilot.sim.declared_bounds`).
    """

    section: Section
    trainset: Trainset
    scheduled_time_s: float = declare(MISSING, "Running time.", unit="s", low=0.0, above=True, option="time")
    disturbance: Disturbance = field(default_factory=Disturbance)
    dt: float = declare(CONTROL_PERIOD_S, "Control period.", unit="s", low=0.01, high=1.0)
    seed: int = 0
    coupled: tuple[tuple[Trainset, float], ...] = ()
    bounds: Bounds | None = None


class Observation(NamedTuple):
    """Input of a driver in one control period.

    Attributes:
        time_s: Time since departure.
        position_m: Measured position of the head.
        speed_mps: Measured speed.
        acceleration_mps2: Acceleration over the last period, from the propulsion control.
        scheduled_time_s: Scheduled running time in force.
        permitted_mps: Permitted speed at the position.
        section: The section with every restriction announced so far.
        intervention: Level of protection's intervention in the last period, an index into
            :data:`metropilot.protection.LEVELS`; 0: the command passed.
    """

    time_s: float
    position_m: float
    speed_mps: float
    acceleration_mps2: float
    scheduled_time_s: float
    permitted_mps: float
    section: Section
    intervention: int = 0
