"""What a follower is: two functions over the array namespace, and a row in the registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from metropilot._registry import Registry
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import Vehicle

Memory = Any
Scalar = Any


class AbstractFollower(ABC):
    """Whatever drives a trainset behind another. Written once: the host loop and compiled campaigns run it.

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
        """Prepare for a run: a tuple of NumPy numbers.

        Args:
            vehicle: The own trainset as its driver knows it.
            period_s: Control period.
        """

    @abstractmethod
    def act(self, memory: Memory, sight: FollowerObservation) -> tuple[Scalar, Memory]:
        """The command in [-1, 1] for the coming period, and the memory to bring next time."""


FOLLOWER_REGISTRY: Registry[type[AbstractFollower]] = Registry("follower", field="driver")
"""Every follower; those of this package are added by :mod:`metropilot.convoy.drivers`."""


def register_follower(follower: type[AbstractFollower]) -> type[AbstractFollower]:
    """Add a follower of one's own to the registry (class decorator)."""
    FOLLOWER_REGISTRY.register(follower)
    return follower
