"""What a learner is paid for: named terms that sum to the reward. A term is one class and one row."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, final

from metropilot.physics.arrays import namespace

Array = Any

J_PER_KWH = 3.6e6


class Change(NamedTuple):
    """What happened in one decision. All 0-d.

    Attributes:
        wheel_j: Traction energy at the wheel used.
        line_j: Net energy at the line used.
        jerk_mps2: Integral of the size of the jerk, m/s^2.
        seconds: Time that went by.
        overruled: Periods in which protection overruled the command.
        overspeed_mps: Largest excess over the limit.
        ended: Whether the episode ended by the task's rules.
        arrived: Whether it ended at the stop.
        late_s: Time since departure minus the scheduled running time.
        error_m: Position minus the stop.
    """

    wheel_j: Array
    line_j: Array
    jerk_mps2: Array
    seconds: Array
    overruled: Array
    overspeed_mps: Array
    ended: Array
    arrived: Array
    late_s: Array
    error_m: Array


class AbstractTerm(ABC):
    """One named share of the reward.

    Attributes:
        name: Key in ``Transition.terms``.
    """

    name: ClassVar[str]

    @abstractmethod
    def value(self, change: Change) -> Array:
        """What one decision earns. Shape ()."""


@final
@dataclass(frozen=True)
class Energy(AbstractTerm):
    """Minus traction energy at the wheel.

    Attributes:
        per_kwh: Price of a kWh.
    """

    name = "energy"
    per_kwh: float = 1.0

    def value(self, change: Change) -> Array:
        """Minus the energy used (Chen23a eq. 16, first term)."""
        return -self.per_kwh / J_PER_KWH * change.wheel_j


@final
@dataclass(frozen=True)
class LineEnergy(AbstractTerm):
    """Minus net energy at the line: efficiency, auxiliaries, recovered.

    Attributes:
        per_kwh: Price of a kWh.
    """

    name = "line_energy"
    per_kwh: float = 1.0

    def value(self, change: Change) -> Array:
        """Minus the energy used."""
        return -self.per_kwh / J_PER_KWH * change.line_j


@final
@dataclass(frozen=True)
class Comfort(AbstractTerm):
    """Minus the integral of the size of the jerk (Chen23a eq. 8).

    Attributes:
        weight: Price of 1 m/s^2 of change.
    """

    name = "comfort"
    weight: float = 0.1

    def value(self, change: Change) -> Array:
        """Minus the change of acceleration, up or down."""
        return -self.weight * change.jerk_mps2


@final
@dataclass(frozen=True)
class OnTime(AbstractTerm):
    """A sum at the end: won when the running time is close enough to the scheduled one, else lost.

    Attributes:
        bonus: The sum (Chen23a eq. 17).
        allowed_s: Largest deviation that wins.
    """

    name = "on_time"
    bonus: float = 100.0
    allowed_s: float = 8.0

    def value(self, change: Change) -> Array:
        """Plus or minus the sum, at the end only."""
        xp = namespace(change.late_s)
        won = change.arrived & (xp.abs(change.late_s) <= self.allowed_s)
        return xp.where(change.ended, xp.where(won, self.bonus, -self.bonus), 0.0 * change.late_s)


@final
@dataclass(frozen=True)
class Punctuality(AbstractTerm):
    """Minus a smooth price of arriving off time.

    Attributes:
        per_s: Price of each second late beyond the first ``soft_s``.
        early: Price of a second early over that of a second late.
        soft_s: Up to here the price is quadratic.
    """

    name = "punctuality"
    per_s: float = 1.0
    early: float = 1.0
    soft_s: float = 1.0

    def value(self, change: Change) -> Array:
        """Huber's function of the deviation, at an arrival only."""
        xp = namespace(change.late_s)
        off = xp.abs(change.late_s)
        price = xp.where(off < self.soft_s, off * off / (2.0 * self.soft_s), off - 0.5 * self.soft_s)
        price = price * xp.where(change.late_s < 0, self.early, 1.0) * self.per_s
        return xp.where(change.arrived, -price, 0.0 * price)


@final
@dataclass(frozen=True)
class StopError(AbstractTerm):
    """Minus the distance from the stop at the end.

    Attributes:
        per_m: Price of a metre.
        most: Largest price.
    """

    name = "stop_error"
    per_m: float = 1.0
    most: float = 20.0

    def value(self, change: Change) -> Array:
        """Minus the size of the error, at the end only."""
        xp = namespace(change.error_m)
        price = xp.minimum(self.per_m * xp.abs(change.error_m), self.most)
        return xp.where(change.ended, -price, 0.0 * price)


@final
@dataclass(frozen=True)
class Failure(AbstractTerm):
    """Minus a sum where the episode ends anywhere but at the stop.

    Attributes:
        price: The sum.
        per_m: Price of each metre that is left, so that further is better.
    """

    name = "failure"
    price: float = 10.0
    per_m: float = 0.02

    def value(self, change: Change) -> Array:
        """The price, at the end only."""
        xp = namespace(change.error_m)
        price = self.price + self.per_m * xp.abs(change.error_m)
        return xp.where(change.ended & (change.arrived ^ True), -price, 0.0 * price)


@final
@dataclass(frozen=True)
class Intervention(AbstractTerm):
    """Minus a price for every second in which protection overrules the command.

    Attributes:
        per_s: Price of a second.
    """

    name = "intervention"
    per_s: float = 1.0

    def value(self, change: Change) -> Array:
        """Minus the seconds."""
        return -self.per_s * change.overruled * change.seconds


@final
@dataclass(frozen=True)
class Overspeed(AbstractTerm):
    """Minus a price for speed above the limit, each second.

    Attributes:
        per_m: Price of 1 m/s for 1 s.
    """

    name = "overspeed"
    per_m: float = 1.0

    def value(self, change: Change) -> Array:
        """Minus the excess."""
        return -self.per_m * change.overspeed_mps * change.seconds


@final
@dataclass(frozen=True)
class Seconds(AbstractTerm):
    """Minus a price for every second: what time is worth where nothing is scheduled.

    Attributes:
        per_s: Price of a second.
    """

    name = "seconds"
    per_s: float = 0.1

    def value(self, change: Change) -> Array:
        """Minus the time."""
        return -self.per_s * change.seconds


TERMS: Mapping[str, type[AbstractTerm]] = MappingProxyType(
    {
        t.name: t
        for t in (
            Energy,
            LineEnergy,
            Comfort,
            OnTime,
            Punctuality,
            StopError,
            Failure,
            Intervention,
            Overspeed,
            Seconds,
        )
    }
)
