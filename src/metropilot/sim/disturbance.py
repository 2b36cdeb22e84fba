"""Disturbance of a run: plant mismatch, noise of the measured speed, changes of the timetable."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, replace
from typing import Any, no_type_check

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Array, Scalar
from metropilot.physics import Vehicle, namespace
from metropilot.railway import Actuation, Davis, EffortCurve, Restriction, Trainset


@no_type_check
def true_vehicle(
    nominal: Vehicle,
    *,
    mass_factor: Scalar = 1.0,
    resistance_factor: Scalar = 1.0,
    delay_s: Scalar = 0.0,
    lag_s: Scalar = 0.0,
    headwind_mps: Scalar = 0.0,
    adhesion: Scalar = float("inf"),
    brake_factor: Scalar = 1.0,
) -> Vehicle:
    """True plant as arrays: :meth:`metropilot.sim.Disturbance.true_plant` for NumPy and JAX.

    A batch draws another disturbance for every run, so the law is needed on numbers as well as on a trainset.
    Arguments left at their defaults (as plain numbers) cost nothing in a compiled program.

    Args:
        nominal: Nominal plant, as driver and planner know it.
        mass_factor: True over nominal mass; brakes are load-compensated. 0-d.
        resistance_factor: True over nominal Davis resistance. 0-d.
        delay_s: Dead time in addition to the nominal one. 0-d, s.
        lag_s: Lag in addition to the nominal one. 0-d, s.
        headwind_mps: Wind from ahead; the quadratic term acts on ``(v + w)^2``. 0-d, m/s.
        adhesion: Traction, or electric braking, over weight at which the driven wheels slip. 0-d.
        brake_factor: True over nominal service braking force. 0-d.
    """
    vehicle = nominal
    if _differs(mass_factor, 1.0):
        vehicle = vehicle._replace(
            mass_kg=vehicle.mass_kg * mass_factor,
            effective_mass_kg=vehicle.effective_mass_kg * mass_factor,
            service_n=vehicle.service_n * mass_factor,
            emergency_n=vehicle.emergency_n * mass_factor,
            adhesion_n=vehicle.adhesion_n * mass_factor,
        )
    if _differs(resistance_factor, 1.0):
        vehicle = vehicle._replace(davis_n=vehicle.davis_n * resistance_factor)
    if _differs(headwind_mps, 0.0):
        a, b, c = vehicle.davis_n[0], vehicle.davis_n[1], vehicle.davis_n[2]
        xp = _arrays(vehicle.davis_n, headwind_mps)
        wind = headwind_mps
        vehicle = vehicle._replace(davis_n=xp.stack([a + c * wind * wind, b + 2.0 * c * wind, c]))
    if _differs(adhesion, float("inf")):
        most_n = adhesion * vehicle.mass_kg * vehicle.gravity_mps2
        vehicle = vehicle._replace(
            traction=_mismatch_cap(vehicle.traction, most_n), brake=_mismatch_cap(vehicle.brake, most_n)
        )
    if _differs(brake_factor, 1.0):
        vehicle = vehicle._replace(service_n=vehicle.service_n * brake_factor)
    if _differs(delay_s, 0.0):
        vehicle = vehicle._replace(delay_s=vehicle.delay_s + delay_s)
    if _differs(lag_s, 0.0):
        vehicle = vehicle._replace(lag_s=vehicle.lag_s + lag_s)
    return vehicle


def _differs(value: Scalar, default: float) -> bool:
    # A traced or batched value may differ: only a plain number can be compared without a compiled branch.
    return not (isinstance(value, float) and value == default)


@no_type_check
def _arrays(*values: Array) -> Any:  # noqa: ANN401 (numpy or jax.numpy)
    return namespace(*values)


@no_type_check
def _mismatch_cap(pieces: Array, most_n: Array) -> Array:
    """Limit the pieces of an effort curve to a largest force. Shape (P, 6), the cap in the last column."""
    xp = _arrays(pieces, most_n)
    return xp.concatenate([pieces[:, :5], xp.minimum(pieces[:, 5:], most_n)], axis=1)


LATEST_S = 36_000.0
"""Latest announcement of an update: ten hours after departure."""
NOISE_CUT = 3.0
"""Standard deviations at which the noise of the measured speed is cut, so that protection can bound it."""


@dataclass(frozen=True)
class TimetableUpdate(CheckedFields):
    """Change of the arrival time or a temporary speed restriction (TSR) announced during the run.

    Attributes:
        at_s: Time of the announcement, s after departure.
        scheduled_time_s: New scheduled running time, s; None: unchanged.
        restriction: New temporary speed restriction; None: none.
    """

    at_s: float = declare(MISSING, "When it is announced, after departure.", unit="s", low=0.0, high=LATEST_S)
    scheduled_time_s: float | None = declare(
        None,
        "New running time.",
        unit="s",
        low=0.0,
        above=True,
        label="Arrive after",
        step=1.0,
    )
    restriction: Restriction | None = None


@dataclass(frozen=True)
class Disturbance(CheckedFields):
    """Difference between a run and the data that driver and planner have.

    Each field is declared once, here, with its name, unit, range and help text. Command line, `run.toml`,
    HTTP API, console, campaigns, convoys and learners take it from this class.

    Attributes:
        ideal: Drop the trainset's own delay, lag and jerk limit.
        mass_factor: True mass over nominal mass.
        resistance_factor: True over nominal Davis resistance.
        delay_s: Dead time in addition to the trainset's.
        lag_s: Lag in addition to the trainset's.
        speed_noise_mps: Standard deviation of the measured speed (cut at three deviations).
        headwind_mps: Wind from ahead on the whole section; below 0 it blows from behind.
        adhesion: Traction, or electric braking, over weight at which the driven wheels slip; infinite: dry
            rail. Friction brakes supply the rest of the braking force; the guaranteed emergency brake does
            not depend on adhesion (sand, track brake).
        brake_factor: True over nominal service braking force; the guaranteed emergency brake does not
            depend on it.
        updates: New arrival times and temporary speed restrictions announced during the run.
    """

    ideal: bool = declare(False, "Ideal actuation: no delay, lag or jerk limit.", label="Ideal actuation")
    mass_factor: float = declare(
        1.0,
        "True mass over nominal mass.",
        low=0.5,
        high=2.0,
        label="True mass / nominal",
        step=0.05,
    )
    resistance_factor: float = declare(
        1.0,
        "True over nominal Davis resistance.",
        low=0.0,
        high=5.0,
        label="True resistance / nominal",
        step=0.1,
    )
    delay_s: float = declare(
        0.0,
        "Additional dead time.",
        unit="s",
        low=0.0,
        high=5.0,
        label="Additional dead time",
        step=0.1,
    )
    lag_s: float = declare(
        0.0,
        "Additional lag.",
        unit="s",
        low=0.0,
        high=5.0,
        label="Additional lag",
        step=0.1,
    )
    speed_noise_mps: float = declare(
        0.0,
        "Standard deviation of the measured speed.",
        unit="m/s",
        low=0.0,
        high=1.0,
        label="Speed noise, 1σ",
        step=0.01,
    )
    headwind_mps: float = declare(
        0.0,
        "Wind from ahead; below 0 from behind.",
        unit="m/s",
        low=-25.0,
        high=25.0,
        label="Headwind",
        step=1.0,
    )
    adhesion: float = declare(
        float("inf"),
        "Traction or electric braking over weight at which the driven wheels slip, e.g. 0.06.",
        low=0.05,
        infinite=True,
        label="Adhesion (empty: dry rail)",
        step=0.01,
    )
    brake_factor: float = declare(
        1.0,
        "True over nominal service braking force.",
        low=0.5,
        high=1.5,
        label="True service brake / nominal",
        step=0.05,
    )
    updates: tuple[TimetableUpdate, ...] = ()

    def nominal(self, trainset: Trainset) -> Trainset:
        """Nominal trainset: the data that driver and planner use."""
        return trainset.ideal() if self.ideal else trainset

    def true_plant(self, trainset: Trainset) -> Trainset:
        """True plant: the nominal trainset with the disturbance applied.

        With wind ``w`` the quadratic term of the resistance is ``c (v + w)^2`` instead of ``c v^2``. This is
        exact while the trainset is faster than a wind from behind; tunnels are treated as open track.
        """
        known = self.nominal(trainset)
        mass = known.mass_kg * self.mass_factor
        a, b, c = (x * self.resistance_factor for x in known.davis.newtons(known.mass_kg))
        wind = self.headwind_mps
        most_n = self.adhesion * mass * known.gravity_mps2
        actuation = Actuation(
            known.actuation.delay_s + self.delay_s,
            known.actuation.lag_s + self.lag_s,
            known.actuation.jerk_limit_mps3,
        )
        return replace(
            known,
            loads={**known.loads, known.load: mass},
            davis=Davis(a + c * wind * wind, b + 2.0 * c * wind, c),
            traction=_cap(known.traction, most_n),
            electric_brake=_cap(known.electric_brake, most_n),
            service_deceleration_mps2=known.service_deceleration_mps2 * self.brake_factor,
            actuation=actuation,
        )


def _cap(curve: EffortCurve, most_n: float) -> EffortCurve:
    """Limit an effort curve to a largest force, N."""
    return EffortCurve(tuple(replace(piece, cap_n=min(piece.cap_n, most_n)) for piece in curve.pieces))
