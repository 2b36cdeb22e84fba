"""What a driver is: two functions, and a row in the registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, TypeVar

from metropilot._registry import Registry
from metropilot.sim.run import Observation, Run

Memory = Any


class AbstractDriver(ABC):
    """Whatever gives the command. Protection supervises every one of them.

    Attributes:
        id: Name in the registry and on the command line.
        summary: One line for ``metropilot drivers``; a driver of this package has it in its row of the
            registry.
        source: Paper or "own"; likewise.
    """

    id: ClassVar[str]
    summary: ClassVar[str] = ""
    source: ClassVar[str] = ""

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
DRIVER_REGISTRY: Registry[type[AbstractDriver]] = Registry("driver")
"""Every driver; those of this package are added by :mod:`metropilot.drivers`, which no loop needs."""


def register(driver: DriverClass) -> DriverClass:
    """Add a driver of one's own to the registry (class decorator)."""
    DRIVER_REGISTRY.register(driver)
    return driver
