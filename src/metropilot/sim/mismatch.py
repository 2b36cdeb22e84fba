"""Plant mismatch: the true plant of a trainset, from the nominal one and a disturbance, as arrays."""

from __future__ import annotations

from typing import Any, no_type_check

from metropilot.physics import Vehicle, namespace

Array = Any


@no_type_check
def true_vehicle(
    nominal: Vehicle,
    *,
    mass_factor: Array = 1.0,
    resistance_factor: Array = 1.0,
    delay_s: Array = 0.0,
    lag_s: Array = 0.0,
    headwind_mps: Array = 0.0,
    adhesion: Array = float("inf"),
    brake_factor: Array = 1.0,
) -> Vehicle:
    """The trainset as it truly is; :meth:`metropilot.sim.Disturbance.true_plant` on arrays, NumPy and JAX.

    A batch draws another disturbance for every run, so the law is needed on numbers as well as on a trainset.
    Arguments left at their defaults (as plain numbers) cost nothing in a compiled program.

    Args:
        nominal: The trainset as driver and planner know it.
        mass_factor: True over nominal mass; brakes are load-compensated. 0-d.
        resistance_factor: True over nominal Davis resistance. 0-d.
        delay_s: Dead time on top of the nominal one. 0-d, s.
        lag_s: Lag on top of the nominal one. 0-d, s.
        headwind_mps: Wind from ahead; the square term meets ``(v + w)^2``. 0-d, m/s.
        adhesion: Traction, or electric braking, over weight at which the driven wheels slip. 0-d.
        brake_factor: True over nominal service braking force. 0-d.
    """
    vehicle = nominal
    if _given(mass_factor, 1.0):
        vehicle = vehicle._replace(
            mass_kg=vehicle.mass_kg * mass_factor,
            effective_mass_kg=vehicle.effective_mass_kg * mass_factor,
            service_n=vehicle.service_n * mass_factor,
            emergency_n=vehicle.emergency_n * mass_factor,
            adhesion_n=vehicle.adhesion_n * mass_factor,
        )
    if _given(resistance_factor, 1.0):
        vehicle = vehicle._replace(davis_n=vehicle.davis_n * resistance_factor)
    if _given(headwind_mps, 0.0):
        a, b, c = vehicle.davis_n[0], vehicle.davis_n[1], vehicle.davis_n[2]
        xp = _arrays(vehicle.davis_n, headwind_mps)
        wind = headwind_mps
        vehicle = vehicle._replace(davis_n=xp.stack([a + c * wind * wind, b + 2.0 * c * wind, c]))
    if _given(adhesion, float("inf")):
        most_n = adhesion * vehicle.mass_kg * vehicle.gravity_mps2
        vehicle = vehicle._replace(
            traction=_capped(vehicle.traction, most_n), brake=_capped(vehicle.brake, most_n)
        )
    if _given(brake_factor, 1.0):
        vehicle = vehicle._replace(service_n=vehicle.service_n * brake_factor)
    if _given(delay_s, 0.0):
        vehicle = vehicle._replace(delay_s=vehicle.delay_s + delay_s)
    if _given(lag_s, 0.0):
        vehicle = vehicle._replace(lag_s=vehicle.lag_s + lag_s)
    return vehicle


def _given(value: Array, default: float) -> bool:
    return not (isinstance(value, float) and value == default)


@no_type_check
def _arrays(*values: Array) -> Any:  # noqa: ANN401 (numpy or jax.numpy)
    return namespace(*values)


@no_type_check
def _capped(pieces: Array, most_n: Array) -> Array:
    """Pieces of an effort curve with their caps lowered. Shape (P, 6)."""
    xp = _arrays(pieces, most_n)
    return xp.concatenate([pieces[:, :5], xp.minimum(pieces[:, 5:], most_n)], axis=1)
