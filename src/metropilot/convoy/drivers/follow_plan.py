"""Follower of a planned motion: feed-forward of its place, one bandwidth for place and speed, own mark."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final, no_type_check

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Scalar
from metropilot.control import PredictedState
from metropilot.convoy.drivers.base import Memory, closing_mps
from metropilot.convoy.drivers.own_place import AbstractPlaceFollower, PlaceMemory
from metropilot.convoy.own_plant import most_bandwidth
from metropilot.convoy.plan import PlannedMotion
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import namespace


@dataclass(frozen=True)
class FollowPlanOptions(CheckedFields):
    """Options of :class:`FollowPlan`.

    Attributes:
        bandwidth_per_s: Bandwidth of the correction of place and speed, as far as the trainset admits it.
        damping: Its damping ratio.
    """

    bandwidth_per_s: float = declare(0.8, low=0.05, high=3.0)
    damping: float = declare(1.0, low=0.5, high=3.0)


@final
class FollowPlan(AbstractPlaceFollower):
    """Keeps its place in the planned motion of the convoy and stops at its own mark."""

    id = "follow_plan"

    def __init__(self, options: FollowPlanOptions | None = None) -> None:
        self.options = options or FollowPlanOptions()

    @no_type_check
    def hold_place(
        self,
        memory: PlaceMemory,
        observation: FollowerObservation,
        place: PlannedMotion,
        ahead: PredictedState,
    ) -> tuple[Scalar, Memory]:
        """Evaluate the law."""
        options, most = self.options, most_bandwidth(observation.vehicle)
        bandwidth = namespace(most).minimum(options.bandwidth_per_s, most)
        gain = 2.0 * options.damping * bandwidth
        rate = bandwidth / (2.0 * options.damping)
        faster = closing_mps(rate, place.position_m - ahead.position_m, observation.most_mps2)
        return place.acceleration_mps2 + gain * (place.speed_mps + faster - ahead.speed_mps), memory.law
