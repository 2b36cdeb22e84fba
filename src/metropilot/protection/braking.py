"""How fast a driver may go that is already braking for a lower limit ahead: a cap for planners."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.lib.stride_tricks import sliding_window_view

from metropilot.physics import Track, davis_n
from metropilot.physics.resistance import felt_slopes
from metropilot.protection.predict import highest_speed
from metropilot.protection.types import Protection


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
        deceleration_mps2: What the driver brakes with, nominally.
    """
    vehicle = protection.vehicle
    spacing, count = float(protection.spacing_m), protection.ahead.size
    node = np.ceil((position_m - protection.start_m) / spacing).astype(int)
    node = np.clip(node, 0, protection.emergency.size - count - 2)
    gradient, curve, _ = felt_slopes(vehicle, track, position_m)
    weight = vehicle.mass_kg * (vehicle.gravity_mps2 * gradient + curve)

    def braking(speed: ndarray) -> ndarray:
        return (weight + davis_n(vehicle, speed)) / vehicle.effective_mass_kg - deceleration_mps2

    return highest_speed(
        vehicle,
        protection.rates,
        sliding_window_view(protection.emergency, count)[node],
        spacing * np.arange(count),
        protection.pull_mps2[node],
        braking,
    )
