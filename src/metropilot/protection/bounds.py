"""Bounds of the plant that protection relies on. The guarantee holds for every plant within these bounds."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from math import ceil
from typing import Any

import numpy as np

from metropilot.errors import InputError
from metropilot.physics import emergency_jerk_mps3
from metropilot.railway import Trainset


@dataclass(frozen=True)
class Bounds:
    """Declared bounds of the plant, relative to the trainset that protection was built for.

    Attributes:
        dt_s: Control period of the supervisor and of the plant.
        delay_s: Largest dead time of the service actuation (the true one may be anything from 0).
        lag_s: Largest time constant of the service actuation (from 0).
        jerk_mps3: Smallest jerk limit in service (the true one may be anything up to infinite).
        mass: Smallest and largest true mass over the nominal one.
        resistance: Smallest and largest true running resistance over the nominal one.
        service_share: Smallest true service braking force over the nominal one.
        emergency_mps2: Guaranteed emergency braking rate on level track, whatever the load and adhesion.
        emergency_reaction_s: Largest dead time of the emergency brake; traction may go on during it.
        emergency_jerk_mps3: Slowest removal of traction and build-up of the emergency brake.
        speed_error_mps: Largest error of the measured speed.
        position_error_m: Largest error of the measured position.
        controlled: True if the emergency brake is controlled to its rate on any gradient, so that a climb
            adds nothing to it.
    """

    dt_s: float
    delay_s: float = 0.0
    lag_s: float = 0.0
    jerk_mps3: float = float("inf")
    mass: tuple[float, float] = (0.8, 1.2)
    resistance: tuple[float, float] = (0.5, 1.5)
    service_share: float = 0.8
    emergency_mps2: float = 1.2
    emergency_reaction_s: float = 0.0
    emergency_jerk_mps3: float = float("inf")
    speed_error_mps: float = 0.0
    position_error_m: float = 0.0
    controlled: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            values = np.atleast_1d(getattr(self, field.name))
            positive = field.name in {"dt_s", "jerk_mps3", "mass", "emergency_mps2", "emergency_jerk_mps3"}
            endless = field.name.endswith("jerk_mps3")
            if np.isnan(values).any() or (values < 0).any() or not (endless or np.isfinite(values).all()):
                raise InputError("out of range", field=field.name, value=str(values), allowed=">= 0, finite")
            if positive and (values <= 0).any():
                raise InputError("out of range", field=field.name, value=str(values), allowed="> 0")
        for name in ("mass", "resistance"):
            low, high = getattr(self, name)
            if not low <= 1.0 <= high:
                raise InputError(
                    "bounds must hold the nominal value", field=name, value=f"{low:g} to {high:g}"
                )

    @classmethod
    def of(
        cls,
        trainset: Trainset,
        dt_s: float,
        *,
        extra_delay_s: float = 0.0,
        extra_lag_s: float = 0.0,
        speed_error_mps: float = 0.0,
        position_error_m: float = 0.0,
    ) -> Bounds:
        """The bounds that a trainset's own data and a margin on its actuation imply.

        Args:
            trainset: Nominal trainset; an ideal one leaves only the control period and the default scatter.
            dt_s: Control period.
            extra_delay_s: Dead time allowed on top of the trainset's.
            extra_lag_s: Lag allowed on top of the trainset's.
            speed_error_mps: Largest error of the measured speed.
            position_error_m: Largest error of the measured position.
        """
        return cls(
            dt_s=dt_s,
            delay_s=trainset.actuation.delay_s + extra_delay_s,
            lag_s=trainset.actuation.lag_s + extra_lag_s,
            jerk_mps3=trainset.actuation.jerk_limit_mps3,
            emergency_mps2=trainset.safe_braking.emergency_deceleration_mps2,
            emergency_reaction_s=trainset.safe_braking.reaction_s,
            emergency_jerk_mps3=emergency_jerk_mps3(trainset.safe_braking),
            speed_error_mps=speed_error_mps,
            position_error_m=position_error_m,
        )

    def hull(self, other: Bounds) -> Bounds:
        """The narrowest bounds that hold every plant of both."""
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in asdict(self)}
        smallest = {"jerk_mps3", "service_share", "emergency_mps2", "emergency_jerk_mps3", "controlled"}
        hull: dict[str, Any] = {n: (min if n in smallest else max)(pair) for n, pair in pairs.items()}
        for name in ("mass", "resistance"):
            (low, high), (least, most) = pairs[name]
            hull[name] = (min(low, least), max(high, most))
        return Bounds(**hull)

    @property
    def reaction_s(self) -> float:
        """From a command let pass to the first moment an emergency brake decided after it acts."""
        return self.dt_s * (1 + ceil(self.emergency_reaction_s / self.dt_s - 1e-3))
