"""A run: one trip from a stop to the next, with everything that may go differently than planned."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from metropilot.errors import InputError
from metropilot.railway import Actuation, Davis, EffortCurve, Restriction, Section, Trainset

CONTROL_PERIOD_S = 0.2
PUNCTUALITY_S = 3.0
STOP_TOLERANCE_M = 0.3
NOISE_CUT = 3.0
LEAST_ADHESION = 0.05


class Outcome(Enum):
    """How a run ended; a value, never an exception."""

    ARRIVED = "arrived"
    OVERSHOT = "overshot"
    OVERSPEED = "overspeed"
    STALLED = "stalled"
    OUT_OF_TIME = "out_of_time"


@dataclass(frozen=True)
class TimetableUpdate:
    """Something the driver is told during the run.

    Attributes:
        at_s: When it is announced, s after departure.
        scheduled_time_s: New scheduled running time, if that is the news.
        restriction: New temporary speed restriction, if that is the news.
    """

    at_s: float
    scheduled_time_s: float | None = None
    restriction: Restriction | None = None


@dataclass(frozen=True)
class Disturbance:
    """How the plant differs from the data the driver has: switches of the scenario, never of the driver.

    Attributes:
        ideal_actuation: Drop the trainset's own delay, lag and jerk limit.
        mass_factor: True mass over the mass the driver believes.
        resistance_factor: True Davis resistance over the one the driver believes.
        extra_delay_s: Dead time on top of the trainset's.
        extra_lag_s: Lag on top of the trainset's.
        speed_noise_mps: Standard deviation of the measured speed (cut at three deviations).
        headwind_mps: Wind from ahead on the whole section; below 0 it blows from behind.
        adhesion: Traction, or electric braking, over weight at which the driven wheels slip; infinite: dry
            rail. Friction brakes fill up what the electric brake cannot give; the guaranteed emergency brake
            does not depend on it (sand, track brake).
        brake_factor: True service braking force over the one the driver believes; the guaranteed emergency
            brake does not depend on it.
        news: What the driver is told on the way.
    """

    ideal_actuation: bool = False
    mass_factor: float = 1.0
    resistance_factor: float = 1.0
    extra_delay_s: float = 0.0
    extra_lag_s: float = 0.0
    speed_noise_mps: float = 0.0
    headwind_mps: float = 0.0
    adhesion: float = float("inf")
    brake_factor: float = 1.0
    news: tuple[TimetableUpdate, ...] = ()

    def __post_init__(self) -> None:
        for name, low, high in (
            ("mass_factor", 0.5, 2.0),
            ("resistance_factor", 0.0, 5.0),
            ("extra_delay_s", 0.0, 5.0),
            ("extra_lag_s", 0.0, 5.0),
            ("speed_noise_mps", 0.0, 1.0),
            ("headwind_mps", -25.0, 25.0),
            ("brake_factor", 0.5, 1.5),
        ):
            value = getattr(self, name)
            if not (np.isfinite(value) and low <= value <= high):
                raise InputError("out of range", field=name, value=value, allowed=f"{low:g} to {high:g}")
        if not self.adhesion >= LEAST_ADHESION:
            raise InputError(
                "out of range", field="adhesion", value=self.adhesion, allowed=f"{LEAST_ADHESION:g} or more"
            )

    def nominal(self, trainset: Trainset) -> Trainset:
        """The trainset as the driver and the planner know it."""
        return trainset.ideal() if self.ideal_actuation else trainset

    def true_plant(self, trainset: Trainset) -> Trainset:
        """The trainset as it really is in this scenario.

        The air meets the trainset at ``v + w``, so that ``c (v + w)^2`` stands for ``c v^2``; exact while the
        trainset is faster than a wind from behind, and in tunnels taken as in the open.
        """
        known = self.nominal(trainset)
        mass = known.mass_kg * self.mass_factor
        a, b, c = (x * self.resistance_factor for x in known.davis.newtons(known.mass_kg))
        wind = self.headwind_mps
        most_n = self.adhesion * mass * known.gravity_mps2
        actuation = Actuation(
            known.actuation.delay_s + self.extra_delay_s,
            known.actuation.lag_s + self.extra_lag_s,
            known.actuation.jerk_limit_mps3,
        )
        return replace(
            known,
            loads={**known.loads, known.load: mass},
            davis=Davis(a + c * wind * wind, b + 2.0 * c * wind, c),
            traction=_capped(known.traction, most_n),
            electric_brake=_capped(known.electric_brake, most_n),
            service_deceleration_mps2=known.service_deceleration_mps2 * self.brake_factor,
            actuation=actuation,
        )


def _capped(curve: EffortCurve, most_n: float) -> EffortCurve:
    """An effort curve where no more than this can be put on the rail."""
    return EffortCurve(tuple(replace(piece, cap_n=min(piece.cap_n, most_n)) for piece in curve.pieces))


@dataclass(frozen=True)
class Run:
    """One trip to drive.

    Attributes:
        section: Where.
        trainset: With what, as the driver knows it.
        scheduled_time_s: In what running time.
        scenario: What the driver does not know.
        dt: Control period, s.
        seed: Seed of everything random in the run.
    """

    section: Section
    trainset: Trainset
    scheduled_time_s: float
    scenario: Disturbance = field(default_factory=Disturbance)
    dt: float = CONTROL_PERIOD_S
    seed: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.scheduled_time_s) and self.scheduled_time_s > 0):
            raise InputError(
                "scheduled time out of range",
                field="scheduled_time_s",
                value=self.scheduled_time_s,
                unit="s",
                allowed="greater than the minimum running time, finite",
            )
        if not (np.isfinite(self.dt) and 0.01 <= self.dt <= 1.0):
            raise InputError(
                "control period out of range", field="dt", value=self.dt, unit="s", allowed="0.01 to 1 s"
            )


class Observation(NamedTuple):
    """What a driver is given each control period.

    Attributes:
        time_s: Time since departure.
        position_m: Measured position of the head.
        speed_mps: Measured speed.
        acceleration_mps2: Acceleration over the last period, from the propulsion control.
        scheduled_time_s: Scheduled running time as it stands now.
        permitted_mps: Speed protection permits here.
        section: The section with every restriction announced so far.
    """

    time_s: float
    position_m: float
    speed_mps: float
    acceleration_mps2: float
    scheduled_time_s: float
    permitted_mps: float
    section: Section
