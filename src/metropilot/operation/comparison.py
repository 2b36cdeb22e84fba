"""Energy of a line by driving and by timetable beside its floor, of a headway or of a day."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from metropilot.operation.line_service import EnergyBalance, LineOperation
from metropilot.planning import excess_percent
from metropilot.units import J_PER_KWH


def mean_of_all(values: Sequence[float | None]) -> float | None:
    """Mean, None where one is missing: that of the others would be a better case."""
    known = [each for each in values if each is not None]
    return float(np.mean(known)) if len(known) == len(values) else None


def saved_percent(kwh: float | None, plain_kwh: float | None) -> float | None:
    """Energy below another one, %; None where one is missing, or there is next to nothing to compare with.

    Args:
        kwh: Energy.
        plain_kwh: Energy it is compared with.
    """
    if kwh is None or plain_kwh is None:
        return None
    more = excess_percent(kwh * J_PER_KWH, plain_kwh * J_PER_KWH)
    return None if more is None else 0.0 - more


def saved_and_gap_percent(
    kwh: float | None, plain_kwh: float, floor_kwh: float
) -> tuple[float | None, float | None]:
    """Energy below that of cruise and brake, and above the floor, %; None where that compares with nothing.

    Args:
        kwh: Energy; None where there is none.
        plain_kwh: Energy of cruise and brake with the plain timetable.
        floor_kwh: Floor.
    """
    if kwh is None:
        return None, None
    return saved_percent(kwh, plain_kwh), excess_percent(kwh * J_PER_KWH, floor_kwh * J_PER_KWH)


@dataclass(frozen=True)
class DrivenEnergy:
    """Energy of a line as a driver drives it.

    Attributes:
        driver: Driver id.
        plain_kwh: Energy with the plain timetable, mean over the offset; None where a network cannot carry
            the load.
        energy_kwh: Energy with the timetable found; None likewise.
        mean_late_s: Mean arrival after the timetable.
        scatter_s: Standard deviation of it.
    """

    driver: str
    plain_kwh: float | None
    energy_kwh: float | None
    mean_late_s: float
    scatter_s: float


@dataclass(frozen=True)
class ScatteredEnergy:
    """Energy with optimal driving and the timetable found, where departures scatter.

    Attributes:
        seconds: Most by which a departure moves either way, evenly drawn.
        energy_kwh: Mean energy of several draws; None where a network cannot carry the load of one.
        deviation_kwh: Standard deviation of it.
    """

    seconds: float
    energy_kwh: float | None
    deviation_kwh: float | None


@dataclass(frozen=True, kw_only=True)
class ComparedEnergy:
    """Energy of all trains of a line.

    Attributes:
        searched: True if dwells and running times were searched, not the offset of the directions alone.
        cruise_kwh: Cruise and brake with the plain timetable, mean over the offset.
        driving_only_kwh: Optimal driving with the plain timetable, mean over the offset.
        timetable_only_kwh: Cruise and brake with the timetable found for it.
        floor_kwh: Energy that no timetable with the same freedom undercuts.
        balance: Optimal driving with the best timetable found, by the best of its plans for each trip.
        driven: The same with a driver, where one was asked for.
        scattered: Optimal driving and the timetable found, with departures that scatter, where asked for.
    """

    searched: bool
    cruise_kwh: float
    driving_only_kwh: float
    timetable_only_kwh: float
    floor_kwh: float
    balance: EnergyBalance
    driven: DrivenEnergy | None = None
    scattered: tuple[ScatteredEnergy, ...] = ()

    @property
    def energy_kwh(self) -> float:
        """Energy with optimal driving and the timetable found."""
        return self.balance.supplied_kwh

    @property
    def gap_percent(self) -> float:
        """Energy above the floor."""
        return 100.0 * (self.energy_kwh / self.floor_kwh - 1.0)

    def describe(self, operation: LineOperation, network: dict[str, Any] | None) -> dict[str, Any]:
        """Values that a headway and a day have, as JSON holds them.

        Args:
            operation: Line in operation.
            network: Values of the network that feeds it, if one does.
        """
        trainset, options, balance = operation.trainset, operation.options, self.balance
        return {
            "line": operation.line.id,
            "trainset": trainset.id,
            "load": trainset.load,
            "floor_kwh": self.floor_kwh,
            "energy_kwh": self.energy_kwh,
            "gap_percent": self.gap_percent,
            "cruise_kwh": self.cruise_kwh,
            "driving_only_kwh": self.driving_only_kwh,
            "timetable_only_kwh": self.timetable_only_kwh,
            "optimised": self.searched,
            "driver": None if self.driven is None else vars(self.driven),
            "scattered": [vars(each) for each in self.scattered],
            "returned_kwh": balance.returned_j / J_PER_KWH,
            "received_kwh": balance.received_j / J_PER_KWH,
            "unreceived_kwh": balance.unreceived_j / J_PER_KWH,
            "feeding": {
                "zones": options.zones,
                "transfer_loss": options.transfer_loss,
                **({} if network is None else {"network": network}),
            },
        }
