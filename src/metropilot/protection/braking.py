"""Highest speed of a driver that already brakes for a lower limit ahead: a cap for planners."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import ndarray
from numpy.lib.stride_tricks import sliding_window_view

from metropilot._typing import Float
from metropilot.physics import Track, davis_n, mean_slopes
from metropilot.protection.predict import highest_speed
from metropilot.protection.types import Protection, Rates


def permitted_braking(
    protection: Protection, track: Track, position_m: Float[ndarray, " points"], deceleration_mps2: float
) -> Float[ndarray, " points"]:
    """Highest speed at each position that a driver who brakes can have without being overruled, m/s.

    The permitted speed is for a driver who holds it. One who brakes for a lower limit ahead is believed the
    share of its braking that the weakest plant within the bounds still has, and may be a little faster on the
    last metres. NumPy only; nothing of the guarantee rests on it.

    Args:
        protection: Curves and bounds.
        track: The section.
        position_m: Positions.
        deceleration_mps2: Nominal deceleration of the driver's braking.
    """
    vehicle, mass = protection.vehicle, protection.vehicle.effective_mass_kg
    weight = _weight_n(protection, track, position_m)

    def brake(speed: ndarray) -> ndarray:
        return (weight + davis_n(vehicle, speed)) / mass - deceleration_mps2

    return _highest(protection, protection.rates, protection.emergency, position_m, brake)


def permitted_before_service(
    protection: Protection, track: Track, position_m: Float[ndarray, " points"]
) -> Float[ndarray, " points"]:
    """Highest speed at each position that leaves time for the nominal service brake to one who holds it, m/s.

    The permitted speed follows from the emergency brake. Where commands act late, the supervisor's service
    brake comes in below it on the way to a lower limit, so whoever plans such a way stays under this. NumPy
    only; nothing of the guarantee rests on it.

    Args:
        protection: Curves and bounds.
        track: The section.
        position_m: Positions.
    """
    vehicle, mass = protection.vehicle, protection.vehicle.effective_mass_kg
    weight = _weight_n(protection, track, position_m)

    def hold(speed: ndarray) -> ndarray:
        return (weight + davis_n(vehicle, speed)) / mass

    return _highest(protection, protection.service_rates, protection.service, position_m, hold)


def _weight_n(protection: Protection, track: Track, position_m: ndarray) -> ndarray:
    """Force that gradient and curves ask for, N."""
    vehicle = protection.vehicle
    gradient, curve, _ = mean_slopes(vehicle, track, position_m)
    return vehicle.mass_kg * (vehicle.gravity_mps2 * gradient + curve)


def _highest(
    protection: Protection,
    rates: Rates,
    curve: ndarray,
    position_m: ndarray,
    effort_mps2: Callable[[ndarray], ndarray],
) -> ndarray:
    """:func:`highest_speed` under one brake's curve from the node at or after each position."""
    spacing, count = float(protection.spacing_m), protection.ahead.size
    node = np.ceil((position_m - protection.start_m) / spacing).astype(int)
    node = np.clip(node, 0, curve.size - count - 2)
    pull = protection.pull_mps2 if curve is protection.emergency else protection.usual_pull_mps2
    windows = sliding_window_view(curve, count)[node]
    return highest_speed(
        protection.vehicle, rates, windows, spacing * np.arange(count), pull[node], effort_mps2
    )
