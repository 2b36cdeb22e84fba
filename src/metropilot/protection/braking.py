"""Highest speed of a driver that already brakes for a lower limit ahead: a cap for planners."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy import ndarray
from numpy.lib.stride_tricks import sliding_window_view

from metropilot._typing import Float
from metropilot.physics import (
    Track,
    braking_bands,
    davis_n,
    effort_at,
    mean_slopes,
    track_arrays,
    vehicle_arrays,
)
from metropilot.protection.bounds import Bounds
from metropilot.protection.curves import protect
from metropilot.protection.predict import highest_speed
from metropilot.protection.types import Protection, Rates
from metropilot.railway import Section, Trainset

USABLE_SHARE = 0.95
"""Share of the largest speed without an intervention that a stop is planned with."""
LEAST_USABLE_MPS2 = 0.1
LEAST_SHARE = 0.4
"""The end counts from where the design speed could be braked at this share of the guaranteed rate."""
COARSE_M = 4.0
"""Distance between the places before the end where that is computed."""
BINDS_MPS = 0.05
"""The end of the authority counts where it takes this much off the speed that can be held."""


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
    hold = _hold_mps2(protection, track, position_m)
    return _highest(protection, protection.service_rates, protection.service, position_m, hold)


def permitted_before_end(
    protection: Protection, track: Track, position_m: Float[ndarray, " points"]
) -> Float[ndarray, " points"]:
    """Highest speed at each position of one who holds it and spares the emergency brake, m/s.

    Other than the permitted speed it includes the end of the movement authority. NumPy only; nothing of the
    guarantee rests on it.

    Args:
        protection: Curves and bounds.
        track: The section.
        position_m: Positions.
    """
    rates, top = protection.rates, float(protection.vehicle.max_speed_mps)
    end, rate = float(track.length_m), LEAST_SHARE * float(rates.brake_mps2)
    late_s = float(rates.reaction_s) + float(rates.brake_mps2) / float(rates.jerk_mps3)
    at = np.arange(end - top * (late_s + top / (2.0 * rate)), end + COARSE_M, COARSE_M)
    at = at[at >= float(position_m.min()) - COARSE_M]
    speed = _highest(protection, rates, protection.emergency, at, _hold_mps2(protection, track, at))
    return np.interp(position_m, at, speed, left=np.inf)


def guarantees_less(trainset: Trainset, bounds: Bounds) -> bool:
    """Tell if a trainset is guaranteed a weaker emergency brake than the service brake it has."""
    vehicle = vehicle_arrays(trainset)
    able_n = effort_at(vehicle, np.linspace(0.0, trainset.max_speed_mps, 64)).brake_n.max()
    return bounds.emergency_mps2 < float(able_n) / trainset.effective_mass_kg * (1.0 - 1e-6)


def asks_for_less(trainset: Trainset) -> bool:
    """Tell if protection's service brake is weaker, at some speed, than the strongest the trainset has."""
    vehicle = vehicle_arrays(trainset)
    rates = braking_bands(vehicle).rates_mps2
    most = min(max(rates), float(vehicle.max_deceleration_mps2))
    asked = min(*rates, trainset.safe_braking.service_deceleration_mps2)
    return asked < most * (1.0 - 1e-6)


def usable_deceleration(section: Section, trainset: Trainset, bounds: Bounds) -> float:
    """Largest deceleration to plan a stop with, m/s^2: what the trainset allows and protection leaves.

    Protection reckons with the guaranteed brake. Where that is weaker than the service brake, whoever brakes
    to the stop as hard as the trainset allows is overruled on the way, and begins earlier instead.

    Args:
        section: Section with every restriction in force.
        trainset: Nominal trainset.
        bounds: Declared bounds of the plant.
    """
    most = float(trainset.max_deceleration_mps2)
    if not guarantees_less(trainset, bounds):
        return most
    guard, track = protect(section, trainset, bounds), track_arrays(section, trainset)
    at = np.arange(0.0, section.length_m, COARSE_M)
    speed = permitted_before_end(guard, track, at)
    # what a climb takes of the speed that is held, line limits and all, is not the end's doing
    endless = protect(replace(section, authority=None), trainset, bounds)
    free = np.flatnonzero(speed >= permitted_before_end(endless, track, at) - BINDS_MPS)
    binds = slice(free[-1] + 1 if free.size else 0, None)
    held = (USABLE_SHARE * speed[binds]) ** 2 / (2.0 * (section.length_m - at[binds]))
    return min(most, max(float(held.min(initial=np.inf)), LEAST_USABLE_MPS2))


def _hold_mps2(protection: Protection, track: Track, position_m: ndarray) -> Callable[[ndarray], ndarray]:
    """Effort over effective mass that holds a speed at each position."""
    weight = _weight_n(protection, track, position_m)

    def hold(speed: ndarray) -> ndarray:
        return (weight + davis_n(protection.vehicle, speed)) / protection.vehicle.effective_mass_kg

    return hold


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
    top = float(np.sqrt(2.0 * curve.max()))
    node = np.ceil((position_m - protection.start_m) / spacing).astype(int)
    node = np.clip(node, 0, curve.size - count - 2)
    pull = protection.pull_mps2 if curve is protection.emergency else protection.usual_pull_mps2
    rise = float(
        np.max(
            pull[node] + np.maximum(effort_mps2(np.full(node.shape, top)), 0.0) / rates.mass_low, initial=0.0
        )
    )
    peak = top + rise * float(rates.reaction_s) + 0.5 * rise * rise / float(rates.jerk_mps3)
    reach_m = peak * float(rates.reaction_s + max(rise + rates.brake_mps2, 0.0) / rates.jerk_mps3)
    count = min(int(np.ceil(reach_m / spacing)) + 3, count)
    windows = sliding_window_view(curve, count)[node]
    return highest_speed(
        protection.vehicle, rates, windows, spacing * np.arange(count), pull[node], effort_mps2
    )
