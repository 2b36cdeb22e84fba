"""What a follower is: two functions over the array namespace, and a row in the registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, final

from metropilot.convoy.step import FollowerObservation
from metropilot.errors import InputError
from metropilot.physics import Vehicle

Memory = Any
Scalar = Any


class AbstractFollower(ABC):
    """Whatever drives a trainset behind another. Written once: the host loop and compiled campaigns run it.

    Attributes:
        id: Name in the registry and on the command line.
        summary: One line for ``metropilot drivers --followers``.
        source: Paper or "own".
    """

    id: ClassVar[str]
    summary: ClassVar[str]
    source: ClassVar[str]

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


_REGISTRY: dict[str, type[AbstractFollower]] = {}


def register_follower(follower: type[AbstractFollower]) -> type[AbstractFollower]:
    """Add a follower to the registry (class decorator)."""
    _REGISTRY[follower.id] = follower
    return follower


@final
class FollowerRegistry:
    """Every follower by id."""

    def ids(self) -> tuple[str, ...]:
        """All follower ids, sorted."""
        return tuple(sorted(_REGISTRY))

    def get(self, follower_id: str) -> type[AbstractFollower]:
        """The class behind an id.

        Raises:
            InputError: No such follower.
        """
        if follower_id not in _REGISTRY:
            raise InputError(
                "unknown follower", field="driver", value=follower_id, allowed=", ".join(self.ids())
            )
        return _REGISTRY[follower_id]

    def make(self, follower_id: str, **options: object) -> AbstractFollower:
        """A follower by id.

        Raises:
            InputError: No such follower.
        """
        return self.get(follower_id)(**options)
