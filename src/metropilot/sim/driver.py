"""What a driver is: two functions, and a row in the registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, TypeVar, final

from metropilot.errors import InputError
from metropilot.sim.run import Observation, Run

Memory = Any


class AbstractDriver(ABC):
    """Whatever gives the command. Protection supervises every one of them.

    Attributes:
        id: Name in the registry and on the command line.
        summary: One line for ``metropilot drivers``.
        source: Paper or "own".
    """

    id: ClassVar[str]
    summary: ClassVar[str]
    source: ClassVar[str]

    @abstractmethod
    def init(self, run: Run) -> Memory:
        """Prepare for a run: plan, tables, the driver's own random stream from ``run.seed``.

        Raises:
            Infeasible: This driver cannot meet the run's scheduled time.
        """

    @abstractmethod
    def act(self, memory: Memory, observation: Observation) -> tuple[float, Memory]:
        """The command in [-1, 1] for the coming control period, and the memory to bring next time."""

    def read_policy(self) -> object:
        """The policy it drives by, read from its file; None for a driver that has none.

        Raises:
            InputError: The file cannot be used, or is of a policy that is none of this driver's.
        """
        return None


DriverClass = TypeVar("DriverClass", bound=type[AbstractDriver])
_REGISTRY: dict[str, type[AbstractDriver]] = {}


def register(driver: DriverClass) -> DriverClass:
    """Add a driver to the registry (class decorator)."""
    _REGISTRY[driver.id] = driver
    return driver


@final
class DriverRegistry:
    """Every driver by id."""

    def ids(self) -> tuple[str, ...]:
        """All driver ids, sorted."""
        return tuple(sorted(_REGISTRY))

    def make(self, driver_id: str, **options: object) -> AbstractDriver:
        """A driver by id.

        Raises:
            InputError: No such driver.
        """
        return self.get(driver_id)(**options)

    def get(self, driver_id: str) -> type[AbstractDriver]:
        """The class behind an id.

        Raises:
            InputError: No such driver.
        """
        if driver_id not in _REGISTRY:
            raise InputError("unknown driver", field="driver", value=driver_id, allowed=", ".join(self.ids()))
        return _REGISTRY[driver_id]
