"""Base class of a driver (two functions) and the registry of drivers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, TypeVar

import numpy as np

from metropilot._registry import Registry
from metropilot.errors import InputError
from metropilot.sim.run import Observation, Run

Memory = Any


class AbstractDriver(ABC):
    """Control law that gives the command of each period; protection supervises it.

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
        """Command in [-1, 1] for the coming control period, and the memory for the next call."""

    def aboard(self, number: type) -> AbstractDriver | None:
        """The form that the driver has on a controller, for :mod:`metropilot.aboard`; None: it has none.

        Args:
            number: Number type of its arithmetic, float64 or float32.
        """
        del number
        return None

    def read_policy(self) -> object:
        """Read the driver's policy from its file; None for a driver without a policy.

        Raises:
            InputError: The file cannot be used, or its policy is not one for this driver.
        """
        return None


def read_command(driver: AbstractDriver, given: object) -> float:
    """Read the command of a driver as a number; protection makes one that is not finite a full service brake.

    Raises:
        InputError: It is no number at all.
    """
    if isinstance(given, np.complexfloating):
        given = complex(given)  # of NumPy's own, float takes the real part, with a warning only
    try:
        return float(given)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        # an integer that is too large for a float may be too long to print
        told = f"{driver.id}: {'too large an integer' if isinstance(given, int) else repr(given)}"
        allowed = "a number from -1 to 1"
        raise InputError("a command that is no number", field="driver", value=told, allowed=allowed) from None


DriverClass = TypeVar("DriverClass", bound=type[AbstractDriver])
DRIVER_REGISTRY: Registry[type[AbstractDriver]] = Registry("driver", group="metropilot.drivers")
"""Every driver. :mod:`metropilot.drivers` adds the shipped ones; simulations do not import it."""


def register(driver: DriverClass) -> DriverClass:
    """Add a user's driver to the registry (class decorator)."""
    DRIVER_REGISTRY.register(driver)
    return driver
