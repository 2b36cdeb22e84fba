"""The linear controller of gap and speed difference: constant gap, or constant time gap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, final, no_type_check

import numpy as np

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Scalar
from metropilot.control import PredictedState
from metropilot.convoy.drivers.base import closing_mps
from metropilot.convoy.drivers.own_place import AbstractPlaceFollower, PlaceMemory
from metropilot.convoy.plan import PlannedMotion
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import Vehicle, namespace

LATE = 0.35
"""Largest product of bandwidth and age of messages, for stability with delayed messages."""
FORGET = 0.995


@dataclass(frozen=True)
class FollowGapOptions(CheckedFields):
    """Options of :class:`FollowGap`.

    Attributes:
        time_gap_s: Time gap; its product with the own speed is added to the desired gap; 0: constant gap.
        bandwidth_per_s: Bandwidth of the gap control; 0: 2, or 0.9 with dead time, lag or jerk limit.
        damping: Damping ratio of the gap control.
        feedforward: Share of the acceleration of the trainset ahead that is fed forward.
    """

    time_gap_s: float = declare(0.0, unit="s", low=0.0, high=10.0)
    bandwidth_per_s: float = declare(0.0, low=0.0, high=4.0)
    damping: float = declare(1.0, low=0.3, high=3.0)
    feedforward: float = declare(1.0, low=0.0, high=1.0)


class GapMemory(NamedTuple):
    """Bandwidth for the trainset, and age of messages. All 0-d.

    Attributes:
        bandwidth_per_s: Bandwidth of the gap control for this trainset.
        age_s: Largest recent age of messages, with exponential forgetting.
    """

    bandwidth_per_s: Scalar
    age_s: Scalar


@final
class FollowGap(AbstractPlaceFollower):
    """Linear control on acceleration ahead, speed difference and gap error.

    A long gap is closed no faster than ``CLOSING_MPS2`` can brake.
    """

    id = "follow_gap"

    def __init__(self, options: FollowGapOptions | None = None) -> None:
        self.options = options or FollowGapOptions()

    def init_law(self, vehicle: Vehicle, period_s: float) -> GapMemory:
        """Choose the bandwidth."""
        late = float(vehicle.delay_s) + float(vehicle.lag_s) > 0 or np.isfinite(float(vehicle.jerk_mps3))
        chosen = self.options.bandwidth_per_s or (0.9 if late else min(2.0, 0.4 / period_s))
        kind = np.asarray(vehicle.mass_kg).dtype.type
        return GapMemory(kind(chosen), kind(0.0))

    @no_type_check
    def hold_place(
        self,
        memory: PlaceMemory,
        observation: FollowerObservation,
        place: PlannedMotion,
        ahead: PredictedState,
    ) -> tuple[Scalar, GapMemory]:
        """Evaluate the law; without a plan, late messages reduce bandwidth and feedforward."""
        options, law = self.options, memory.law
        xp = namespace(observation.position_m, observation.gap_m)
        age = xp.maximum(observation.age_s, FORGET * law.age_s)
        # A place behind a plan is late by the age of messages, and not fed back on it.
        late_s = xp.where(memory.alone > 0.0, age + ahead.seconds, 0.0 * age)
        rate = xp.minimum(law.bandwidth_per_s, LATE / xp.maximum(late_s, 1e-3))
        error = place.position_m - ahead.position_m - options.time_gap_s * ahead.speed_mps
        gain = 2.0 * options.damping * rate
        faster = closing_mps(rate / (2.0 * options.damping), error, observation.most_mps2)
        taken = options.feedforward * xp.maximum(1.0 - gain * late_s, 0.0)
        wanted = taken * place.acceleration_mps2 + gain * (place.speed_mps + faster - ahead.speed_mps)
        return wanted, law._replace(age_s=age)
