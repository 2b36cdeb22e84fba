"""Drivers: anything that gives the command, one file each."""

from metropilot.drivers import (  # noqa: F401 (importing a driver's file registers it)
    ddpg_pid,
    eitoe,
    expert_learned,
    flat_out,
    fuzzy_pid,
    manual,
    mpc,
    neural_pid,
    optimal,
    pid,
    pid_lu2023,
    shipped,
)
from metropilot.sim.driver import DriverRegistry

DRIVERS = DriverRegistry()

__all__ = ["DRIVERS"]
