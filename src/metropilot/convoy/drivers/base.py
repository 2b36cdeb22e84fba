"""Interface of followers: two functions over the array namespace, and a row in the registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from metropilot._registry import Registry
from metropilot._typing import Scalar
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import Vehicle

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


FOLLOWER_REGISTRY: Registry[type[AbstractFollower]] = Registry("follower", field="driver")
"""Every follower; those of this package are added by :mod:`metropilot.convoy.drivers`."""


def register_follower(follower: type[AbstractFollower]) -> type[AbstractFollower]:
    """Add a follower to the registry (class decorator)."""
    FOLLOWER_REGISTRY.register(follower)
    return follower
