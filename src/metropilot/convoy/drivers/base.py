"""Interface of followers: two functions over the array namespace, and a row in the registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, no_type_check

from metropilot._registry import Registry
from metropilot._typing import Scalar
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import Vehicle, namespace

STILL_MPS = 0.02
STILL_M = 0.1
OPENING_MPS, CLOSING_MPS2, CLOSING_SHARE = 3.0, 0.35, 0.6
"""Largest speed at which a gap is opened, and deceleration with which closing a long gap is planned: at most,
and over what the brakes are controlled to."""


@no_type_check
def closing_mps(rate_per_s: Scalar, error_m: Scalar, most_mps2: Scalar) -> Scalar:
    """Speed at which a gap that is too long by an error is closed; negative: opened.

    A long gap is closed no faster than a gentle deceleration can brake.

    Args:
        rate_per_s: Rate at which a short gap is closed, over the error.
        error_m: Error of the gap.
        most_mps2: Deceleration that the brakes are controlled to.
    """
    xp = namespace(rate_per_s, error_m)
    gentle_mps2 = xp.minimum(CLOSING_SHARE * most_mps2, CLOSING_MPS2)
    braking = (xp.maximum(2.0 * gentle_mps2 * error_m, 0.0)) ** 0.5
    return xp.maximum(xp.minimum(rate_per_s * error_m, braking), -OPENING_MPS)


@no_type_check
def waits(observation: FollowerObservation, gap_m: Scalar) -> Scalar:
    """True if both trainsets stand and the gap is closed up, so that the follower holds its brakes.

    Args:
        observation: Of the follower.
        gap_m: Gap that it closes up to.
    """
    near = observation.gap_m <= gap_m + STILL_M
    return (observation.speed_mps <= STILL_MPS) & (observation.ahead_mps <= STILL_MPS) & near


Memory = Any


class AbstractFollower(ABC):
    """Driver of a trainset behind another; the host loop and compiled campaigns run the same code.

    Attributes:
        id: Name in the registry and on the command line.
        summary: One line for ``metropilot drivers --followers``; a follower of this package has it in its
            row of the registry.
        source: Paper or "own"; likewise.
    """

    id: ClassVar[str]
    summary: ClassVar[str] = ""
    source: ClassVar[str] = ""

    @abstractmethod
    def init(self, vehicle: Vehicle, period_s: float) -> Memory:
        """Make the memory at the start of a run: a tuple of NumPy numbers.

        Args:
            vehicle: Nominal plant of the own trainset.
            period_s: Control period.
        """

    @abstractmethod
    def act(self, memory: Memory, observation: FollowerObservation) -> tuple[Scalar, Memory]:
        """Choose the command in [-1, 1] for the coming period; also returns the next memory."""


FOLLOWER_REGISTRY: Registry[type[AbstractFollower]] = Registry(
    "follower", field="driver", group="metropilot.followers"
)
"""Every follower; those of this package are added by :mod:`metropilot.convoy.drivers`."""


def register_follower(follower: type[AbstractFollower]) -> type[AbstractFollower]:
    """Add a follower to the registry (class decorator)."""
    FOLLOWER_REGISTRY.register(follower)
    return follower
