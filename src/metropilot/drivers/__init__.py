"""Drivers: anything that gives the command, one file each."""

from metropilot.drivers.base import AbstractDriver, DriverRegistry, register

DRIVERS = DriverRegistry()

__all__ = ["DRIVERS", "AbstractDriver", "DriverRegistry", "register"]
