"""What an action of the policy means: a few numbers, or a choice, become a command in [-1, 1].

Each kind is written over the array namespace, so that a driver on the host maps actions exactly as the task
did. A kind is one small class and one row of :data:`ACTIONS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, final

import numpy as np

from metropilot.errors import InputError
from metropilot.task.interface import ActionSpace
from metropilot.task.observers import Sight, limited_force

Array = Any


class AbstractAction(ABC):
    """How actions become commands."""

    @property
    @abstractmethod
    def space(self) -> ActionSpace:
        """What an action is."""

    @abstractmethod
    def command(self, sight: Sight, action: Array, period_s: float) -> Array:
        """The command in [-1, 1] that an action asks for.

        Args:
            sight: What the policy saw when it acted.
            action: Shape (size,), or an integer choice of shape ().
            period_s: Time between two decisions.
        """


def _ordered(field: str, pair: tuple[float, float], allowed: str, *, equal: bool = False) -> None:
    """Refuse a number that is not above another."""
    low, high = pair
    if not (low <= high if equal else low < high):
        raise InputError("out of range", field=field, value=pair[1], allowed=allowed)


@final
@dataclass(frozen=True)
class CommandAction(AbstractAction):
    """The command itself (Chen23a: share of the traction or braking force available)."""

    @property
    def space(self) -> ActionSpace:
        """One number."""
        return ActionSpace(size=1)

    def command(self, sight: Sight, action: Array, period_s: float) -> Array:
        """The number, clipped."""
        del period_s
        return sight.xp.clip(action[0], -1.0, 1.0)


@final
@dataclass(frozen=True)
class RegimeAction(AbstractAction):
    """The command with room for the regimes of the optimum: exact coasting in the middle, full effort early.

    An optimal drive is full traction, holding a speed, coasting and braking. A Gaussian policy never hits
    exactly 0 by itself, and needs a large mean to stay at full effort.

    Attributes:
        coast: Actions up to this size mean coasting.
        full: Actions from this size on mean full effort.
    """

    coast: float = 0.2
    full: float = 0.8

    def __post_init__(self) -> None:
        """Refuse a dead zone that leaves no room for effort."""
        _ordered("coast", (0.0, self.coast), "0 or more, below full", equal=True)
        _ordered("full", (self.coast, self.full), "above coast")

    @property
    def space(self) -> ActionSpace:
        """One number."""
        return ActionSpace(size=1)

    def command(self, sight: Sight, action: Array, period_s: float) -> Array:
        """0 in the dead zone, then linear up to full effort."""
        del period_s
        size = sight.xp.clip((sight.xp.abs(action[0]) - self.coast) / (self.full - self.coast), 0.0, 1.0)
        return sight.xp.where(action[0] < 0.0, -size, size)


@final
@dataclass(frozen=True)
class EffortAction(AbstractAction):
    """The effort wanted, traction or braking, per kilogram: what a plan is made of, whatever the trainset.

    Attributes:
        scale_mps2: Effort of an action of 1.
        coast_mps2: Smaller efforts mean coasting.
    """

    scale_mps2: float = 1.5
    coast_mps2: float = 0.06

    @property
    def space(self) -> ActionSpace:
        """One number."""
        return ActionSpace(size=1)

    def command(self, sight: Sight, action: Array, period_s: float) -> Array:
        """The command whose force is the effort's, 0 for less than coasting."""
        del period_s
        effort = self.scale_mps2 * sight.xp.clip(action[0], -1.0, 1.0)
        force = effort * sight.vehicle.effective_mass_kg
        return sight.xp.where(sight.xp.abs(effort) < self.coast_mps2, 0.0, limited_force(sight, force))


@final
@dataclass(frozen=True)
class IncrementAction(AbstractAction):
    """The change of the command (Huang25): smooth by construction.

    Attributes:
        rate_per_s: Largest change of the command in a second.
    """

    rate_per_s: float = 0.5

    def __post_init__(self) -> None:
        """Refuse a command that cannot be changed."""
        _ordered("rate_per_s", (0.0, self.rate_per_s), "above 0")

    @property
    def space(self) -> ActionSpace:
        """One number."""
        return ActionSpace(size=1)

    def command(self, sight: Sight, action: Array, period_s: float) -> Array:
        """The last command, moved."""
        moved = sight.command + self.rate_per_s * period_s * sight.xp.clip(action[0], -1.0, 1.0)
        return sight.xp.clip(moved, -1.0, 1.0)


@final
@dataclass(frozen=True)
class NotchAction(AbstractAction):
    """One of a table of notches: commands, or forces of the trainset's own levels (Lu23's twelve).

    Attributes:
        notches: Commands in [-1, 1], or forces in N, traction positive.
        forces: Whether they are forces.
    """

    notches: tuple[float, ...] = (-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0)
    forces: bool = False

    @property
    def space(self) -> ActionSpace:
        """One choice a notch."""
        return ActionSpace(count=len(self.notches))

    def command(self, sight: Sight, action: Array, period_s: float) -> Array:
        """The notch; a force is asked for as far as it is available."""
        del period_s
        notch = sight.xp.asarray(self.notches, np.float32)[action]
        return limited_force(sight, notch) if self.forces else notch


@final
@dataclass(frozen=True)
class GainsAction(AbstractAction):
    """Gains of a controller that holds a share of the permitted speed; each spans a range logarithmically.

    Attributes:
        low: Least of each gain: proportional (1/(m/s)) and speed held over the permitted speed.
        high: Largest of each.
    """

    low: tuple[float, ...] = (0.05, 0.3)
    high: tuple[float, ...] = (2.0, 1.0)

    def __post_init__(self) -> None:
        """Refuse ranges that are empty or have no logarithm."""
        if not len(self.low) == len(self.high) == 2:
            raise InputError("not a range of two gains", field="high", value=len(self.high), allowed="2")
        for low, high in zip(self.low, self.high, strict=True):
            _ordered("low", (0.0, low), "above 0, below high")
            _ordered("high", (low, high), "above low")

    @property
    def space(self) -> ActionSpace:
        """One number a gain."""
        return ActionSpace(size=len(self.low))

    def gains(self, sight: Sight, action: Array) -> Array:
        """The gains an action stands for. Shape (size,)."""
        xp = sight.xp
        low, high = (np.log(np.asarray(ends, np.float32)) for ends in (self.low, self.high))
        return xp.exp(low + (high - low) * (0.5 + 0.5 * xp.clip(action, -1.0, 1.0)))

    def command(self, sight: Sight, action: Array, period_s: float) -> Array:
        """Proportional control of the speed to the share of the permitted speed."""
        del period_s
        gain, share = self.gains(sight, action)
        return sight.xp.clip(gain * (share * sight.permitted_mps - sight.speed_mps), -1.0, 1.0)


ACTIONS: Mapping[str, type[AbstractAction]] = MappingProxyType(
    {
        "command": CommandAction,
        "regime": RegimeAction,
        "effort": EffortAction,
        "increment": IncrementAction,
        "notches": NotchAction,
        "gains": GainsAction,
    }
)
