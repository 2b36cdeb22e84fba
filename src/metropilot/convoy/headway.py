"""Capacity of convoys: the gap that protection needs, headway, trainsets per hour."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metropilot.convoy.model import Convoy, ConvoyGuard, convoy_members
from metropilot.protection import TrainAhead, at_start, spare_gap

OVERLAP_M = 20.0


def needed_gap_m(convoy: Convoy, guard: ConvoyGuard, speed_mps: float, age_s: float = 0.0) -> float:
    """Smallest gap, rear to front, at which protection does not intervene at a common steady speed.

    Args:
        convoy: The convoy; its last pair is considered.
        guard: Assumption of protection.
        speed_mps: Speed of both.
        age_s: Age of the last message.
    """
    pair = convoy_members(replace(convoy, guard=guard))
    own = pair[-1]
    if own.protection is None:
        return 0.0
    far, at = np.float64(1e4), np.float64(0.4 * convoy.section.length_m)
    ahead = TrainAhead(at + far, np.float64(speed_mps), np.float64(0.0), np.float64(age_s), own.bounds)
    watched = at_start(own.protection)
    spare = spare_gap(own.protection, watched, at, np.float64(speed_mps), np.float64(0.0), ahead)
    return float(far - spare)


@dataclass(frozen=True)
class ConvoyService:
    """Service on a line: convoys of identical trainsets under a moving block.

    Attributes:
        count: Trainsets of a convoy; 1: no convoys.
        length_m: Length of one trainset.
        inside_m: Gap inside a convoy.
        apart_m: Gap between convoys at the speed on the line.
        speed_mps: Speed on the line.
        rate_mps2: Acceleration and deceleration in service.
        dwell_s: Time at a platform.
    """

    count: int
    length_m: float
    inside_m: float
    apart_m: float
    speed_mps: float
    rate_mps2: float = 0.8
    dwell_s: float = 30.0

    @property
    def convoy_m(self) -> float:
        """Length of a convoy."""
        return self.count * self.length_m + (self.count - 1) * self.inside_m

    @property
    def line_per_h(self) -> float:
        """Trainsets that pass a point of plain line in an hour at a steady speed."""
        return 3600.0 * self.count * self.speed_mps / (self.convoy_m + self.apart_m)

    @property
    def platform_per_h(self) -> float:
        """Trainsets an hour through a platform as long as a convoy.

        Dwell, the time until the convoy has cleared platform and overlap, and the time the next one, as near
        as its braking distance, takes to run in.
        """
        clear_m, rate, speed = self.convoy_m + OVERLAP_M, self.rate_mps2, self.speed_mps
        rising_m = 0.5 * speed**2 / rate
        clear_s = (2.0 * min(clear_m, rising_m) / rate) ** 0.5 + max(clear_m - rising_m, 0.0) / speed
        return 3600.0 * self.count / (self.dwell_s + clear_s + speed / rate)
