"""Double minimal-time distribution: how the time left is shared out among the speed-limit intervals.

The minimum-time curve (full traction up to the limits, full braking for the lower ones and the stop) gives
the least time from any state to the destination, ``tau_D``, and to the end of the interval, ``tau_k``. The
interval gets ``Tr tau_k / tau_D`` of the reserved time (Huang25 Algorithm 1, rule 5). An interval ends where
the minimum-time curve must slow down for a lower limit and traction is needed again behind it; all others are
one with the next.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from metropilot.control import Model
from metropilot.drivers.expert.ground import STEP_M, ExpertTrack, drops
from metropilot.env import SPEED_STEP_MPS, ExpertRules, coasting_time, to_go_table
from metropilot.physics import scalars

SLACK_MPS = 0.3
SLOW = 1.2
"""Coasting that takes so many times the least time is no way to go on."""


class Leg(NamedTuple):
    """One interval.

    Attributes:
        end_m: End of the interval.
        end_mps: Speed to have there, 0 at the stop.
        after_s: Least time from there to the destination, at that speed.
    """

    end_m: float
    end_mps: float
    after_s: float


class Legs(NamedTuple):
    """The intervals of a section, and the least time to its end from everywhere.

    Attributes:
        legs: In order; the last ends at the stop.
        to_go_s: Least time to the destination: rows even in the root of the distance left, columns in speed.
        length_m: Length of the section.
    """

    legs: tuple[Leg, ...]
    to_go_s: list[list[float]]
    length_m: float

    def leg(self, position_m: float) -> Leg:
        """The interval a position is in."""
        for leg in self.legs:
            if position_m < leg.end_m:
                return leg
        return self.legs[-1]

    def least_s(self, left_m: float, speed_mps: float) -> float:
        """``tau_D``: least time to the destination, s."""
        rows, columns = len(self.to_go_s), len(self.to_go_s[0])
        u = (rows - 1) * math.sqrt(min(max(left_m / self.length_m, 0.0), 1.0))
        w = min(max(speed_mps / SPEED_STEP_MPS, 0.0), columns - 1.0)
        i, j = min(int(u), rows - 2), min(int(w), columns - 2)
        u, w = u - i, w - j
        low, high = self.to_go_s[i], self.to_go_s[i + 1]
        near = low[j] * (1.0 - w) + low[j + 1] * w
        far = high[j] * (1.0 - w) + high[j + 1] * w
        return near * (1.0 - u) + far * u

    def share(self, leg: Leg, position_m: float, speed_mps: float) -> float:
        """``tau_k / tau_D``, 1 in the last interval."""
        if leg.after_s <= 0.0:
            return 1.0
        whole = self.least_s(self.length_m - position_m, speed_mps)
        return max(1.0 - leg.after_s / max(whole, leg.after_s + 1e-3), 1e-3)


def legs_of(model: Model, ground: ExpertTrack, rules: ExpertRules) -> Legs:
    """The intervals of a section for a trainset that keeps the expert's acceleration.

    Args:
        model: Nominal trainset and section.
        ground: Tables of the section.
        rules: The expert's constants.
    """
    gentle = min(rules.start_mps2, float(model.vehicle.max_acceleration_mps2))
    vehicle = model.vehicle._replace(max_acceleration_mps2=np.float64(gentle))
    table = to_go_table(vehicle, model.track)
    length = ground.length_m
    whole = Legs((), table.time_s.tolist(), length)
    left = length * np.linspace(0.0, 1.0, table.top_mps.size) ** 2
    at, fastest = _fastest(ground, gentle, np.interp(length - _nodes(length), left, table.top_mps))
    legs: list[Leg] = []
    for place, limit in drops(model):
        lower = min(limit, ground.safe(place))
        leg = Leg(place, lower, whole.least_s(length - place, lower))
        if np.interp(place, at, fastest) > lower - SLACK_MPS and _needs_power(ground, leg, rules):
            legs.append(leg)
    return whole._replace(legs=(*legs, Leg(length, 0.0, 0.0)))


def _needs_power(ground: ExpertTrack, leg: Leg, rules: ExpertRules) -> bool:
    """Tell if a trainset that coasts on from the end of an interval comes to the stop far too late."""
    stretch = ground.stretch(leg.end_m, ground.length_m, 0.0)
    return coasting_time(scalars, ground.davis, rules.brake_mps2, leg.end_mps, stretch) > SLOW * leg.after_s


def _nodes(length_m: float) -> np.ndarray:
    return np.arange(0.0, length_m, STEP_M)


def _fastest(ground: ExpertTrack, gentle_mps2: float, top_mps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The minimum-time curve: full traction from a stand, under the highest speeds that keep all limits."""
    at, speed = _nodes(ground.length_m), 0.0
    found = np.zeros_like(at)
    for k in range(1, at.size):
        pull = min(ground.traction(speed) - ground.drag(float(at[k - 1]), speed), gentle_mps2)
        speed = min(math.sqrt(max(speed * speed + 2.0 * pull * STEP_M, 0.0)), float(top_mps[k]))
        found[k] = speed
    return at, found
