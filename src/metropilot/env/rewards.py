"""Reward terms: named terms that sum to the reward. A term is one class and one row."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, NamedTuple, final

from metropilot._typing import Flag, Scalar
from metropilot.physics import namespace
from metropilot.units import J_PER_KWH


class PeriodChange(NamedTuple):
    """Changes over one decision, the input of the reward terms. All 0-d.

    Attributes:
        wheel_j: Traction energy at the wheel used.
        line_j: Net energy at the line used.
        jerk_mps2: Integral of the absolute jerk, m/s^2.
        seconds: Duration.
        overruled: Share of the periods in which protection overruled the command.
        overspeed_mps: Largest excess over the limit.
        ended: True if the task's rules ended the episode.
        arrived: True if it ended at the stop.
        late_s: Running time to the standstill, or to now, minus the scheduled running time.
        error_m: Position minus the stop.
        braked_j: Energy taken by the electric brake at the wheel.
        acceleration_mps2: Acceleration at the end.
        before_mps2: Acceleration at the end of the decision before.
        speed_mps: Speed at the end.
        command: Command at the end.
        command_before: Command at the end of the decision before.
    """

    wheel_j: Scalar
    line_j: Scalar
    jerk_mps2: Scalar
    seconds: Scalar
    overruled: Scalar
    overspeed_mps: Scalar
    ended: Flag
    arrived: Flag
    late_s: Scalar
    error_m: Scalar
    braked_j: Scalar
    acceleration_mps2: Scalar
    before_mps2: Scalar
    speed_mps: Scalar
    command: Scalar
    command_before: Scalar


class AbstractTerm(ABC):
    """Named term of the reward.

    Attributes:
        name: Key in ``Transition.terms``.
    """

    name: ClassVar[str]

    @abstractmethod
    def value(self, change: PeriodChange) -> Scalar:
        """Reward of one decision. Shape ()."""


@final
@dataclass(frozen=True)
class Energy(AbstractTerm):
    """Minus traction energy at the wheel.

    Attributes:
        per_kwh: Price of a kWh.
    """

    name = "energy"
    per_kwh: float = 1.0

    def value(self, change: PeriodChange) -> Scalar:
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

    def value(self, change: PeriodChange) -> Scalar:
        """Minus the energy used."""
        return -self.per_kwh / J_PER_KWH * change.line_j


@final
@dataclass(frozen=True)
class Comfort(AbstractTerm):
    """Minus the integral of the absolute jerk (Chen23a eq. 8).

    Attributes:
        weight: Price of 1 m/s^2 of change.
    """

    name = "comfort"
    weight: float = 0.1

    def value(self, change: PeriodChange) -> Scalar:
        """Minus the change of acceleration, up or down."""
        return -self.weight * change.jerk_mps2


@final
@dataclass(frozen=True)
class OnTime(AbstractTerm):
    """Bonus at the end if the running time is close enough to the scheduled one, otherwise its negative.

    Attributes:
        bonus: The bonus (Chen23a eq. 17).
        allowed_s: Largest deviation that earns it.
        soft_s: Further deviation over which the bonus falls to its negative, evenly; 0: at once, as printed.
    """

    name = "on_time"
    bonus: float = 100.0
    allowed_s: float = 8.0
    soft_s: float = 0.0

    def value(self, change: PeriodChange) -> Scalar:
        """Plus or minus the bonus, or what is between them, at the end only."""
        xp = namespace(change.late_s)
        beyond_s = xp.abs(change.late_s) - self.allowed_s
        if self.soft_s > 0.0:
            share = xp.clip(1.0 - 2.0 * beyond_s / self.soft_s, -1.0, 1.0)
        else:
            share = xp.where(beyond_s <= 0.0, 1.0, -1.0)
        won = xp.where(change.arrived, share, -1.0)
        return xp.where(change.ended, self.bonus * won, 0.0 * change.late_s)


@final
@dataclass(frozen=True)
class Punctuality(AbstractTerm):
    """Minus a smooth price of arriving off time.

    Attributes:
        per_s: Price of each second late beyond the first ``soft_s``.
        early: Price of a second early over that of a second late.
        soft_s: Deviation up to which the price is quadratic.
    """

    name = "punctuality"
    per_s: float = 1.0
    early: float = 1.0
    soft_s: float = 1.0

    def value(self, change: PeriodChange) -> Scalar:
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

    def value(self, change: PeriodChange) -> Scalar:
        """Minus the size of the error, at the end only."""
        xp = namespace(change.error_m)
        price = xp.minimum(self.per_m * xp.abs(change.error_m), self.most)
        return xp.where(change.ended, -price, 0.0 * price)


@final
@dataclass(frozen=True)
class Failure(AbstractTerm):
    """Minus a price if the episode ends anywhere but at the stop.

    Attributes:
        price: The price.
        per_m: Further price of each metre that is left, so that progress is rewarded.
    """

    name = "failure"
    price: float = 10.0
    per_m: float = 0.02

    def value(self, change: PeriodChange) -> Scalar:
        """Minus the price, at the end only."""
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

    def value(self, change: PeriodChange) -> Scalar:
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

    def value(self, change: PeriodChange) -> Scalar:
        """Minus the excess."""
        return -self.per_m * change.overspeed_mps * change.seconds


@final
@dataclass(frozen=True)
class Seconds(AbstractTerm):
    """Minus a price for every second, as the value of time without a timetable.

    Attributes:
        per_s: Price of a second.
    """

    name = "seconds"
    per_s: float = 0.1

    def value(self, change: PeriodChange) -> Scalar:
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
