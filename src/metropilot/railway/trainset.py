"""Trainsets: everything about the vehicle that driving depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from metropilot._schema import Range
from metropilot.errors import InputError
from metropilot.railway.effort import Efficiency, EffortCurve
from metropilot.railway.record import CatalogueRecord
from metropilot.units import KMH_PER_MPS, si_unit

CurveFormula = Literal["none", "600/r", "6.3/(r-55)"]
POSITIVE_FIELDS = (
    "service_deceleration_mps2",
    "max_acceleration_mps2",
    "max_deceleration_mps2",
    "max_speed_mps",
    "adhesion",
    "gravity_mps2",
)
LARGEST_PULL_MPS2 = 10.0
"""Traction over mass: more than its weight no trainset pulls; kg for t, or N for kN, is far beyond."""
COMMAND_TIME = Range(0.0, 5.0)
SERVICE_JERK = Range(0.05, 100.0, infinite=True)
"""Dead times and lags of commands, and jerk limits, that a trainset may declare: others end no drive."""
TRUE_TIME = Range(0.0, 2.0 * COMMAND_TIME.high)
"""Dead time and lag of the true plant, which a run may make later by as much."""


@dataclass(frozen=True)
class Davis:
    """Running resistance ``a + b v + c v^2`` with v in m/s.

    Attributes:
        a: Constant term, N (or N/kg).
        b: Linear term, N/(m/s) (or N/kg/(m/s)).
        c: Quadratic term, N/(m/s)^2 (or N/kg/(m/s)^2).
        per_mass: True when the coefficients are per kilogram and the resistance grows with the load.
    """

    a: float
    b: float
    c: float
    per_mass: bool = False

    def newtons(self, mass_kg: float) -> tuple[float, float, float]:
        """The three coefficients as forces for a trainset of this mass."""
        factor = mass_kg if self.per_mass else 1.0
        return (self.a * factor, self.b * factor, self.c * factor)


@dataclass(frozen=True)
class Actuation:
    """Actuation between a command and the force at the wheel.

    Attributes:
        delay_s: Dead time before a new command acts.
        lag_s: Time constant of the first-order lag after it.
        jerk_limit_mps3: Bound on the change of acceleration in service (infinite: none).
    """

    delay_s: float = 0.0
    lag_s: float = 0.0
    jerk_limit_mps3: float = float("inf")


@dataclass(frozen=True)
class SafeBraking:
    """Guaranteed braking that protection relies on; the safe-braking model of IEEE 1474.1 as a convention.

    Attributes:
        emergency_deceleration_mps2: Guaranteed emergency braking rate on level track.
        service_deceleration_mps2: Braking rate protection asks for first.
        reaction_s: From the decision to the traction cut-off (protection's own cycle comes on top).
        buildup_s: From the traction cut-off to the full guaranteed emergency rate.
        emergency_jerk_mps3: Rate at which the emergency brake builds up.
    """

    emergency_deceleration_mps2: float = 1.2
    service_deceleration_mps2: float = 1.0
    reaction_s: float = 0.0
    buildup_s: float = 0.0
    emergency_jerk_mps3: float = float("inf")


@dataclass(frozen=True)
class Couplers:
    """Spring and damper between neighbouring vehicles, for the multi-body model (Huang25 eq. 3).

    Attributes:
        vehicles: Number of vehicles; the mass is split evenly.
        stiffness_n_per_m: Spring rate of each coupler.
        damping_n_s_per_m: Damping of each coupler.
    """

    vehicles: int = 1
    stiffness_n_per_m: float = 5e6
    damping_n_s_per_m: float = 5e5


@dataclass(frozen=True)
class Trainset(CatalogueRecord):
    """A trainset with one load aboard; :meth:`with_load` gives the same vehicle with another.

    Attributes:
        id: Catalogue id or file stem.
        name: Full name.
        loads: Total mass of each named load, kg (e.g. AW0, AW2, AW3).
        load: The load aboard, a key of ``loads``.
        length_m: Length; 0 gives the papers' point mass.
        rotating_fraction: Rotating mass as a share of the mass: effective mass is ``mass * (1 + fraction)``.
        davis: Running resistance.
        curve_formula: Curve resistance: none, ``600/r`` N/kN (Chinese rule) or ``6.3/(r-55)`` N/kg (Huang25).
        tunnel_n_per_mps2: Extra aerodynamic resistance by tunnel cross section: pairs (m^2, N/(m/s)^2).
        traction: Traction force over speed.
        electric_brake: Electric (recoverable) braking force over speed.
        friction_brake_n: Friction braking force available beside it.
        service_deceleration_mps2: Effort that command -1 asks for where blending can give it, as force over
            effective mass; infinite: command -1 asks for all electric and friction force there is.
        max_acceleration_mps2: Largest acceleration in service.
        max_deceleration_mps2: Largest deceleration in service.
        max_speed_mps: Design speed.
        efficiency_traction: Wheel over line power in traction.
        efficiency_braking: Line over wheel power in electric braking.
        receptivity: Share of the electrically braked energy that the line takes.
        auxiliary_w: Power of the auxiliaries at the line.
        actuation: Delay, lag and jerk limit.
        adhesion: Largest wheel force over weight (infinite: never limits).
        safe_braking: Guaranteed braking that protection relies on.
        couplers: Multi-body data.
        notches: Named lists of forces in N, traction positive, braking negative (e.g. Lu23's twelve levels).
        gravity_mps2: Standard gravity used with this data.
    """

    id: str
    name: str
    loads: Mapping[str, float]
    load: str
    davis: Davis
    traction: EffortCurve
    electric_brake: EffortCurve
    length_m: float = 0.0
    rotating_fraction: float = 0.0
    curve_formula: CurveFormula = "none"
    tunnel_n_per_mps2: tuple[tuple[float, float], ...] = ()
    friction_brake_n: float = 0.0
    service_deceleration_mps2: float = float("inf")
    max_acceleration_mps2: float = 1.0
    max_deceleration_mps2: float = 1.0
    max_speed_mps: float = 80 / KMH_PER_MPS
    efficiency_traction: Efficiency = field(default_factory=lambda: Efficiency.constant(1.0))
    efficiency_braking: Efficiency = field(default_factory=lambda: Efficiency.constant(1.0))
    receptivity: float = 0.0
    auxiliary_w: float = 0.0
    actuation: Actuation = Actuation()
    adhesion: float = float("inf")
    safe_braking: SafeBraking = SafeBraking()
    couplers: Couplers = Couplers()
    notches: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    gravity_mps2: float = 9.81

    def __post_init__(self) -> None:
        if self.load not in self.loads:
            raise InputError(
                "unknown load", file=self.id, field="load", value=self.load, allowed=", ".join(self.loads)
            )
        for name, low in (
            ("length_m", 0.0),
            ("rotating_fraction", 0.0),
            ("friction_brake_n", 0.0),
            ("auxiliary_w", 0.0),
            ("receptivity", 0.0),
        ):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= low):
                raise InputError("out of range", file=self.id, field=name, value=value, allowed=f">= {low:g}")
        for name in POSITIVE_FIELDS:
            value = getattr(self, name)
            if not value > 0:
                raise InputError("out of range", file=self.id, field=name, value=value, allowed="> 0")
        for name, bounds, kind in (
            ("delay_s", TRUE_TIME, "time"),
            ("lag_s", TRUE_TIME, "time"),
            ("jerk_limit_mps3", SERVICE_JERK, "jerk"),
        ):
            value = getattr(self.actuation, name)
            if not bounds.admit(value):
                raise InputError(
                    "out of range",
                    file=self.id,
                    field=f"actuation.{name}",
                    value=value,
                    unit=si_unit(kind).name,
                    allowed=bounds.describe(si_unit(kind)),
                )
        for load, mass in self.loads.items():
            if not (np.isfinite(mass) and mass > 0):
                raise InputError(
                    "out of range",
                    file=self.id,
                    field=f"loads.{load}",
                    value=mass,
                    unit="kg",
                    allowed="> 0 kg",
                )

    def check_masses(self, file: str) -> None:
        """Refuse a load that is lighter than the traction allows: its unit is wrong, or that of the force.

        Args:
            file: Name of the trainset in the error.

        Raises:
            InputError: Naming the load, its mass and the least one.
        """
        speeds = np.linspace(0.0, self.max_speed_mps, 33)
        largest = float(np.max(self.traction.at(speeds)))
        least = largest / LARGEST_PULL_MPS2
        for load, mass in self.loads.items():
            if mass < least:
                raise InputError(
                    "lighter than its traction allows: is a unit wrong?",
                    file=file,
                    field=f"mass.loads.{load}",
                    value=float(mass),
                    unit="kg",
                    allowed=f">= {least:.6g} kg with the traction of {largest / 1e3:g} kN",
                )

    @property
    def mass_kg(self) -> float:
        """Mass with the load aboard."""
        return float(self.loads[self.load])

    @property
    def effective_mass_kg(self) -> float:
        """Mass including the rotating share."""
        return self.mass_kg * (1.0 + self.rotating_fraction)

    def with_load(self, load: str) -> Trainset:
        """The same trainset with another of its loads.

        Raises:
            InputError: The trainset has no such load.
        """
        return replace(self, load=load)

    def ideal(self) -> Trainset:
        """The same trainset with ideal actuation: no delay, lag or jerk limit, brakes without build-up."""
        safe = replace(self.safe_braking, reaction_s=0.0, buildup_s=0.0, emergency_jerk_mps3=float("inf"))
        return replace(self, actuation=Actuation(), safe_braking=safe)
