"""Run under a ceiling: reach a speed, hold it, and be slow enough wherever a lower limit begins.

The ceiling is the most restrictive speed profile, moved toward the trainset by what protection's own reaction
needs, so that a driver that keeps under it gives protection no reason to intervene.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.drivers.observer import Ahead, Model
from metropilot.drivers.stopping import Curve, required_ahead
from metropilot.physics import Track, track_arrays, vehicle_arrays
from metropilot.railway import SafeBraking, Section, Trainset

MARGIN_MPS = 0.2
"""How far below the limit a driver holds."""
APPROACH_PER_S = 0.8
"""Acceleration for each m/s below the speed to hold."""
EASE_SHARE = 0.4
"""Jerk at which traction is eased off before the speed is reached, over the trainset's limit."""
HOLD_BRAKE_MPS2 = 0.3
"""Strongest braking to hold a speed downhill."""


class Ceiling(NamedTuple):
    """Speeds to keep under.

    Attributes:
        from_m: Where each piece begins. Shape (K,).
        speed_mps: The speed to keep, margin taken off. Shape (K,).
    """

    from_m: Float[ndarray, " pieces"]
    speed_mps: Float[ndarray, " pieces"]

    def at(self, position_m: float) -> float:
        """The speed to keep at a position."""
        k = int(np.searchsorted(self.from_m, position_m, side="right")) - 1
        return float(self.speed_mps[max(k, 0)])


def model_of(section: Section, trainset: Trainset, dt: float) -> Model:
    """What a driver believes about trainset and section, as the plant's numbers."""
    return Model(vehicle_arrays(trainset), track_arrays(section, trainset), dt)


def ceiling_of(track: Track, safe: SafeBraking, dt: float, margin_mps: float = MARGIN_MPS) -> Ceiling:
    """The ceiling of a section: each lower limit begins earlier by the way gone while protection reacts.

    Args:
        track: Its most restrictive speed profile.
        safe: Protection's reaction and build-up.
        dt: Control period, s.
        margin_mps: How far to stay below.
    """
    valid = np.isfinite(track.limit_from_m)
    start, limit = track.limit_from_m[valid], track.limit_mps[valid]
    keep = np.maximum(limit - margin_mps, 0.5 * limit)
    moved = start.copy()
    reaction_s = safe.reaction_s + safe.buildup_s + dt
    for k in range(1, start.size):
        if limit[k] < limit[k - 1]:
            moved[k] = start[k] - limit[k] * reaction_s
    edges = np.unique(np.concatenate([start, moved]))
    ends = np.append(start[1:], np.inf)
    speeds = [float(keep[(moved <= x) & (ends > x)].min()) for x in edges]
    return Ceiling(edges, np.array(speeds))


def ceiling_acceleration(
    model: Model, ahead: Ahead, ceiling: Ceiling, cruise_mps: float, curve: Curve
) -> float:
    """The acceleration that runs as fast as a cruising speed and the ceiling allow, comfortably.

    Args:
        model: What the driver believes about trainset and section.
        ahead: The state when the command begins to act.
        ceiling: Speeds to keep under.
        cruise_mps: Speed to hold where the ceiling is higher.
        curve: Deceleration and jerk to slow down with.

    Returns:
        Wanted acceleration, m/s^2.
    """
    x, v = ahead.position_m, ahead.speed_mps
    wanted = approach(model, v, min(ceiling.at(x), cruise_mps))
    most = float(model.vehicle.max_deceleration_mps2)
    slowing = curve._replace(end_mps2=0.0)
    k = int(np.searchsorted(ceiling.from_m, x, side="right"))
    horizon = x + v * v / (2.0 * curve.deceleration_mps2) + 3.0 * v + 10.0
    while k < ceiling.from_m.size and ceiling.from_m[k] < horizon:
        lower = min(float(ceiling.speed_mps[k]), cruise_mps)
        if lower < v:
            required, falling = required_ahead(ahead, float(ceiling.from_m[k]) - x, slowing, lower)
            if required >= curve.deceleration_mps2 or falling > 0.0 or ahead.acceleration_mps2 < -0.1:
                wanted = min(wanted, -min(required, (v - lower) / model.dt, most))
        k += 1
    return wanted


def approach(model: Model, speed_mps: float, target_mps: float) -> float:
    """Acceleration toward a speed, eased off in time for the jerk limit, never above what service allows."""
    missing = target_mps - speed_mps
    if missing < 0:
        return max(APPROACH_PER_S * missing, -HOLD_BRAKE_MPS2 if missing > -1.0 else -1.0)
    jerk = EASE_SHARE * float(model.vehicle.jerk_mps3)
    eased = math.sqrt(2.0 * jerk * missing) if math.isfinite(jerk) else math.inf
    return min(float(model.vehicle.max_acceleration_mps2), APPROACH_PER_S * missing, eased)
