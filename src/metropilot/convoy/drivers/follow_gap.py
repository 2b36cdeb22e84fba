"""The linear controller of gap and speed difference: constant gap, or constant time gap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, final, no_type_check

import numpy as np

from metropilot.convoy.drivers.base import AbstractFollower
from metropilot.convoy.drivers.motion import command_for
from metropilot.convoy.step import FollowerObservation
from metropilot.errors import InputError
from metropilot.physics import Vehicle, namespace

Scalar = Any
LATE = 0.35
"""Bandwidth times the age of messages: what comes late must not be answered quickly."""
FORGET = 0.995
OPENING_MPS, CLOSING_MPS2 = 3.0, 0.35
"""How fast a long gap is opened, and the deceleration that a run up to the trainset ahead is planned with."""


@dataclass(frozen=True)
class FollowGapOptions:
    """How the gap is held.

    Attributes:
        time_gap_s: Added to the wanted gap times the own speed; 0: constant gap.
        bandwidth_per_s: How quickly an error of the gap decays; 0: 2, or 0.9 where commands act late.
        damping: Of that decay.
        feedforward: Share of the acceleration ahead taken over.
    """

    time_gap_s: float = 0.0
    bandwidth_per_s: float = 0.0
    damping: float = 1.0
    feedforward: float = 1.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("time_gap_s", 0.0, 10.0),
            ("bandwidth_per_s", 0.0, 4.0),
            ("damping", 0.3, 3.0),
            ("feedforward", 0.0, 1.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError("out of range", field=name, value=value, allowed=f"{low:g} to {high:g}")


class GapMemory(NamedTuple):
    """What the driver knows of its trainset and of the link. All 0-d.

    Attributes:
        bandwidth_per_s: How quickly this trainset can be made to hold a gap.
        age_s: How old messages get: the most of late, fading.
    """

    bandwidth_per_s: Scalar
    age_s: Scalar


@final
class FollowGap(AbstractFollower):
    """Acceleration ahead, speed difference, gap error; a long gap is closed at a speed that can be lost."""

    id = "follow_gap"

    def __init__(self, options: FollowGapOptions | None = None) -> None:
        self.options = options or FollowGapOptions()

    def init(self, vehicle: Vehicle, period_s: float) -> GapMemory:
        """Choose the bandwidth."""
        late = float(vehicle.delay_s) + float(vehicle.lag_s) > 0 or np.isfinite(float(vehicle.jerk_mps3))
        chosen = self.options.bandwidth_per_s or (0.9 if late else min(2.0, 0.4 / period_s))
        kind = np.asarray(vehicle.mass_kg).dtype.type
        return GapMemory(kind(chosen), kind(0.0))

    @no_type_check
    def act(self, memory: GapMemory, sight: FollowerObservation) -> tuple[Scalar, GapMemory]:
        """One period of the law; late messages make it slower and take less of the acceleration ahead."""
        options = self.options
        xp = namespace(sight.position_m, sight.gap_m)
        age = xp.maximum(sight.age_s, FORGET * memory.age_s)
        rate = xp.minimum(memory.bandwidth_per_s, LATE / xp.maximum(age, 1e-3))
        error = sight.gap_m - sight.wanted_gap_m - options.time_gap_s * sight.speed_mps
        gain = 2.0 * options.damping * rate
        linear = rate / (2.0 * options.damping) * error
        braked = (xp.maximum(2.0 * CLOSING_MPS2 * error, 0.0)) ** 0.5
        faster = xp.maximum(xp.minimum(linear, braked), -OPENING_MPS)
        taken = options.feedforward * xp.maximum(1.0 - gain * age, 0.0)
        wanted = taken * sight.ahead_mps2 + gain * (sight.ahead_mps + faster - sight.speed_mps)
        return command_for(sight, wanted), memory._replace(age_s=age)
