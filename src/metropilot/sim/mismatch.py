"""Plant mismatch: the true plant of a trainset, from the nominal one and a disturbance, as arrays."""

from __future__ import annotations

from typing import Any, no_type_check

from metropilot._typing import Array, Scalar
from metropilot.physics import Vehicle, namespace


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
        vehicle = vehicle._replace(traction=_cap(vehicle.traction, most_n), brake=_cap(vehicle.brake, most_n))
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
def _cap(pieces: Array, most_n: Array) -> Array:
    """Limit the pieces of an effort curve to a largest force. Shape (P, 6), the cap in the last column."""
    xp = _arrays(pieces, most_n)
    return xp.concatenate([pieces[:, :5], xp.minimum(pieces[:, 5:], most_n)], axis=1)
