"""The prediction behind every decision: the fastest that any plant within the bounds can do next.

Written once over the array namespace; the permitted curve is computed with the same formulas.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._typing import Array, Flag, Float, Scalar
from metropilot.physics import Effort, Vehicle, davis_n, effort_at, namespace
from metropilot.protection.types import Rates

HALVINGS = 13
BLOCK = 64
"""Nodes looked at together: few enough that what lies between two formulas stays in the processor's cache."""
SLACK_MPS = 1.0
"""Forces are taken at the worse of the measured speed and this much below it: it may change on the way."""


Forces = tuple[Scalar, Scalar, Scalar]
"""Gain of full traction, loss of full service brake, and acceleration with neither, m/s^2."""


class EffortsAround(NamedTuple):
    """Efforts at the two ends of the speeds that protection reckons with.

    Attributes:
        low_mps: The lower one.
        slow: Efforts there.
        quick: Efforts at the higher one, to which a fall may still speed the trainset up.
    """

    low_mps: Scalar
    slow: Effort
    quick: Effort


def efforts_around(vehicle: Vehicle, rates: Rates, speed_mps: Scalar, gain_mps: Scalar) -> EffortsAround:
    """Efforts about a measured speed; rates with the same error of the speed have the same.

    Args:
        vehicle: The nominal trainset.
        rates: Declared bounds.
        speed_mps: Measured speed.
        gain_mps: Speed that a fall may add until the emergency brake acts (:func:`gain_on_fall`).
    """
    xp = namespace(rates.speed_error_mps, speed_mps)
    low = xp.maximum(speed_mps - rates.speed_error_mps - SLACK_MPS, 0.0)
    high = speed_mps + rates.speed_error_mps + gain_mps
    return EffortsAround(low, effort_at(vehicle, low), effort_at(vehicle, high))


def gain_on_fall(rates: Rates, pull_mps2: Scalar) -> Scalar:
    """Most speed that a trainset without traction gains on a fall until the emergency brake acts, m/s."""
    xp = namespace(rates.reaction_s, pull_mps2)
    return xp.maximum(pull_mps2, 0.0) * rates.reaction_s


def fastest(
    vehicle: Vehicle,
    rates: Rates,
    speed_mps: Scalar,
    pull_mps2: Scalar,
    around: EffortsAround | None = None,
) -> Forces:
    """Largest effect of an effort: gain of full traction, loss of full service brake, and neither, m/s^2.

    The lightest trainset accelerates, the heaviest with the weakest service brake slows down.

    Args:
        vehicle: The nominal trainset.
        rates: Declared bounds.
        speed_mps: Measured speed.
        pull_mps2: Largest pull of the gradient, less certain curve resistance.
        around: Efforts about the speed where they are known.
    """
    xp = namespace(rates.mass_low, speed_mps)
    if around is None:
        around = efforts_around(vehicle, rates, speed_mps, gain_on_fall(rates, pull_mps2))
    low, slow, quick = around
    lightest = rates.mass_low * vehicle.effective_mass_kg
    heaviest = rates.mass_high * vehicle.effective_mass_kg
    push = xp.maximum(slow.traction_n, quick.traction_n) / lightest
    hold = rates.service_share * xp.minimum(slow.brake_n, quick.brake_n) / heaviest
    coast = pull_mps2 - rates.resistance_low * davis_n(vehicle, low) / heaviest
    return push, hold, coast


def acceleration(forces: Forces, share: Scalar) -> Scalar:
    """Largest acceleration of a command in [-1, 1] (see :func:`fastest`), m/s^2."""
    push, hold, coast = forces
    xp = namespace(push, share)
    return xp.maximum(share, 0.0) * push + xp.minimum(share, 0.0) * hold + coast


@no_type_check
def reaction_way(
    rates: Rates, speed_mps: Scalar, acceleration_mps2: Scalar, pull_mps2: Scalar
) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Motion and ways until a brake decided one period from now acts in full; see :func:`stays_under`.

    Returns:
        Acceleration during the reaction, m/s^2; highest speed, m/s; and the distances over which the brake
        begins to act and acts in full, m.
    """
    xp = namespace(speed_mps, acceleration_mps2, pull_mps2)
    jerk, rate = rates.jerk_mps3, rates.brake_mps2 - pull_mps2
    steady = xp.maximum(acceleration_mps2, -rate)
    rise = xp.maximum(steady, 0.0)
    peak = xp.maximum(speed_mps + rise * rates.reaction_s + 0.5 * rise * rise / jerk, 1e-6)
    begins = peak * rates.reaction_s
    return steady, peak, begins, begins + peak * (steady + rate) / jerk


@no_type_check
def stays_under(
    rates: Rates,
    curve: Float[Array, "*nodes ahead"],
    distance_m: Float[Array, "*nodes ahead"],
    speed_mps: Scalar,
    acceleration_mps2: Scalar,
    pull_mps2: Scalar,
) -> Flag:
    """True if the brake, decided one period from now, still keeps under its curve.

    The safe-braking model of IEEE 1474.1, as a convention, on energy over distance: the acceleration in
    flight goes on during the reaction; then traction falls and the brake builds up at the assumed jerk, to
    the assumed rate on the worst gradient ahead. Time is bounded from below by distance over the peak speed,
    so every point passed on the way is checked, short zones included. Once the full rate is reached under the
    curve, the curve itself is the proof.

    Between two nodes the curve is straight and the prediction concave. It keeps under its chord plus a
    quarter of the spacing times the change of its slope, and under the energy of its peak: either will do.

    Args:
        rates: The brake and the plant until it acts.
        curve: Braking curve at the nodes around and ahead, m^2/s^2.
        distance_m: Distance to each of them, the first at hand or just behind.
        speed_mps: Upper bound on the present speed.
        acceleration_mps2: Upper bound on the acceleration during the reaction.
        pull_mps2: Largest pull of the gradient over the distance.
    """
    xp = namespace(curve, speed_mps)
    jerk, rate = rates.jerk_mps3, rates.brake_mps2 - pull_mps2
    steady, peak, begins, full = reaction_way(rates, speed_mps, acceleration_mps2, pull_mps2)
    built = xp.clip(distance_m - begins, 0.0, full - begins)
    beyond = xp.maximum(distance_m - full, 0.0)
    slope = steady - jerk / peak * built
    energy = 0.5 * speed_mps * speed_mps + steady * distance_m
    energy = energy - 0.5 * jerk / peak * built * built - (steady + rate) * beyond

    left, right = slice(None, -1), slice(1, None)
    spacing = distance_m[..., right] - distance_m[..., left]
    bulge = 0.25 * spacing * (slope[..., left] - slope[..., right])
    room = curve - energy
    under = xp.minimum(room[..., left], room[..., right]) >= bulge
    level = xp.minimum(curve[..., left], curve[..., right]) >= 0.5 * peak * peak
    cells = under | level | (distance_m[..., left] > full)
    return xp.all(cells & (full <= distance_m[..., -1:]), axis=-1)


def highest_speed(
    vehicle: Vehicle,
    rates: Rates,
    curve: Float[ndarray, "nodes ahead"],
    distance_m: Float[ndarray, " ahead"],
    pull_mps2: Float[ndarray, " nodes"],
    effort_mps2: Callable[[Float[ndarray, " nodes"]], Float[ndarray, " nodes"]],
) -> Float[ndarray, " nodes"]:
    """Highest speed that a driver can have at each node without being overruled, m/s (NumPy).

    Args:
        vehicle: The nominal trainset.
        rates: The brake and the plant until it acts.
        curve: Braking curve from each node on, m^2/s^2.
        distance_m: Distance to those, from 0.
        pull_mps2: Largest pull of the gradient.
        effort_mps2: The driver's force over the effective mass at given speeds, traction positive.
    """
    low, high = np.zeros(curve.shape[0]), np.sqrt(2.0 * curve[:, 0])
    blocks = [slice(k, k + BLOCK) for k in range(0, curve.shape[0], BLOCK)]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        speed = middle + 2.0 * rates.speed_error_mps
        effort, gain = effort_mps2(middle), gain_on_fall(rates, pull_mps2)
        around = efforts_around(vehicle, rates, speed, gain)
        # on a fall that command may give less at the speed gained
        given = effort_at(vehicle, speed + rates.speed_error_mps).brake_n
        lasting = around.quick.brake_n / np.maximum(given, 1.0)
        braking = effort * np.minimum(lasting, 1.0) * rates.service_share / rates.mass_high
        seen = np.where(effort > 0, effort / rates.mass_low, braking)
        seen = seen + fastest(vehicle, rates, speed, pull_mps2, around)[2]
        fits = np.concatenate(
            [
                stays_under(
                    rates, curve[k], distance_m[None, :], *(x[k, None] for x in (speed, seen, pull_mps2))
                )
                for k in blocks
            ]
        )
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    return low
