"""Drivers: anything that gives the command, one file each."""

from metropilot.drivers import flat_out, manual, optimal, pid  # noqa: F401 (importing a driver's file registers it)
from metropilot.drivers.base import AbstractDriver, DriverRegistry, register

DRIVERS = DriverRegistry()

__all__ = ["DRIVERS", "AbstractDriver", "DriverRegistry", "register"]
