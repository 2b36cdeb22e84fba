"""DC feeding of a line: substations, rails and the limits of trains on their voltage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from metropilot._schema import check_fields, declare
from metropilot.errors import InputError
from metropilot.railway.line import Line
from metropilot.railway.record import CatalogueRecord, check_positions
from metropilot.units import KINDS, tidy

MOST_V = 1e4
LEAST_OHM, LEAST_OHM_PER_M = 1e-8, 1e-9
"""Least resistances, far below any real one: with less the rounding of a voltage is a current that counts."""
LEAST_CONTROL_OHM = 1e-3
"""The same of a storage: with less, power and limit of a control that steep are found by chance only."""
MILLIOHM = KINDS["resistance"]["mohm"]
MILLIOHM_PER_KM = KINDS["resistance per length"]["mohm/km"]


@dataclass(frozen=True, kw_only=True)
class Substation:
    """A substation: a diode rectifier behind its inner resistance, and an inverter where there is one.

    Attributes:
        position_m: Position along the line.
        name: Name.
        no_load_v: Voltage without current; above it the rectifier blocks.
        resistance_ohm: Inner resistance, the fall of the voltage per current.
        inverter_v: Voltage above which the inverter returns current to the grid; None: no inverter.
        inverter_ohm: Its inner resistance.
    """

    position_m: float
    name: str = ""
    no_load_v: float = declare(850.0, unit="V", low=0.0, above=True, high=MOST_V)
    resistance_ohm: float = declare(0.018, unit="ohm", low=LEAST_OHM, high=100.0, shown=MILLIOHM)
    inverter_v: float | None = declare(None, unit="V", low=0.0, above=True, high=MOST_V)
    inverter_ohm: float = declare(0.03, unit="ohm", low=LEAST_OHM, high=100.0, shown=MILLIOHM)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.inverter_v is not None and not self.inverter_v > self.no_load_v:
            raise InputError(
                "an inverter that takes the rectifier's current",
                field="inverter_v",
                value=tidy(self.inverter_v),
                unit="V",
                allowed=f"above the no-load voltage, {self.no_load_v:g} V",
            )


@dataclass(frozen=True, kw_only=True)
class Storage:
    """Storage of energy on the line's voltage, beside the track or aboard each train.

    It charges above one voltage and discharges below another, by as much current as the voltage is beyond it
    over a resistance, up to its power and as long as there is room or energy.

    Attributes:
        position_m: Position along the line; of no meaning aboard.
        name: Name.
        capacity_j: Energy that it takes, at its cells.
        power_w: Most power, at its terminals.
        efficiency: Of charging, and once more of discharging.
        charge_above_v: Voltage above which it charges.
        discharge_below_v: Voltage below which it discharges.
        resistance_ohm: Fall of the voltage per current that its control keeps; nothing is lost in it.
    """

    position_m: float = 0.0
    name: str = ""
    capacity_j: float = declare(36e6, unit="J", low=0.0, above=True, high=1e12, shown=KINDS["energy"]["kWh"])
    power_w: float = declare(1e6, unit="W", low=0.0, above=True, high=1e9, shown=KINDS["power"]["kW"])
    efficiency: float = declare(0.95, low=0.0, above=True, high=1.0)
    charge_above_v: float = declare(860.0, unit="V", low=0.0, above=True, high=MOST_V)
    discharge_below_v: float = declare(820.0, unit="V", low=0.0, above=True, high=MOST_V)
    resistance_ohm: float = declare(0.01, unit="ohm", low=LEAST_CONTROL_OHM, high=100.0, shown=MILLIOHM)

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.charge_above_v > self.discharge_below_v:
            raise InputError(
                "a storage that charges and discharges at once",
                field="charge_above_v",
                value=tidy(self.charge_above_v),
                unit="V",
                allowed=f"above discharge_below, {self.discharge_below_v:g} V",
            )


def _voltage(field: str, value: float, allowed: str) -> dict[str, Any]:
    """Attributes of the error of a voltage."""
    return {"field": field, "value": tidy(value), "unit": "V", "allowed": allowed}


@dataclass(frozen=True, kw_only=True)
class Feeding(CatalogueRecord):
    """DC feeding of one line.

    Each direction has a conductor rail and running rails of its own, both tied to those of the other
    direction at substations and at storages beside the track, nowhere else.

    Attributes:
        id: Catalogue id or file stem.
        name: Name.
        line_id: Line along which positions count.
        substations: Substations by increasing position.
        conductor_ohm_per_m: Resistance of the conductor rail of one track.
        running_ohm_per_m: Resistance of the running rails of one track, as its return path.
        max_current_a: Most that a train draws.
        reduced_below_v: Voltage below which this falls, linearly.
        cut_off_v: Voltage at which it is nil.
        squeezed_above_v: Voltage above which a braking train returns less than it could, linearly.
        max_v: Voltage at which it returns nothing.
        storages: Storages beside the track by increasing position; the tracks are tied there.
        onboard: Storage aboard each train; None: none.
    """

    id: str
    name: str
    line_id: str
    substations: tuple[Substation, ...]
    conductor_ohm_per_m: float = declare(
        8e-6, unit="ohm/m", low=LEAST_OHM_PER_M, high=1.0, shown=MILLIOHM_PER_KM
    )
    running_ohm_per_m: float = declare(15e-6, unit="ohm/m", low=0.0, high=1.0, shown=MILLIOHM_PER_KM)
    max_current_a: float = declare(6000.0, unit="A", low=0.0, above=True, high=1e5)
    reduced_below_v: float = declare(550.0, unit="V", low=0.0, above=True, high=MOST_V)
    cut_off_v: float = declare(500.0, unit="V", low=0.0, above=True, high=MOST_V)
    squeezed_above_v: float = declare(870.0, unit="V", low=0.0, above=True, high=MOST_V)
    max_v: float = declare(900.0, unit="V", low=0.0, above=True, high=MOST_V)
    storages: tuple[Storage, ...] = ()
    onboard: Storage | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.substations:
            raise InputError("needs substations", field="substations", value=0, allowed="at least 1")
        check_positions("substations", [each.position_m for each in self.substations])
        check_positions("storages", [each.position_m for each in self.storages])
        highest_v = max(s.no_load_v for s in self.substations)
        lowest_v = min(s.no_load_v for s in self.substations)
        order = [
            (f"substations[{index}].no_load_voltage", each.no_load_v, self.cut_off_v, self.max_v)
            for index, each in enumerate(self.substations)
        ]
        order += [
            ("reduced_below_v", self.reduced_below_v, self.cut_off_v, lowest_v),
            ("squeezed_above_v", self.squeezed_above_v, highest_v, self.max_v),
        ]
        for name, value, low, high in order:
            if not low < value < high:
                raise InputError("out of order", **_voltage(name, value, f"between {low:g} and {high:g} V"))
        self._check_in_reach()

    def _check_in_reach(self) -> None:
        """Refuse a voltage that no train brings about: that inverter or storage would never do anything."""
        inverters = [("inverters.voltage", each.inverter_v) for each in self.substations]
        storages = [("storage", each) for each in self.storages]
        storages += [] if self.onboard is None else [("onboard_storage", self.onboard)]
        above = [(f"{block}.charge_above", each.charge_above_v) for block, each in storages]
        below = [(f"{block}.discharge_below", each.discharge_below_v) for block, each in storages]
        for name, value in (*inverters, *above):
            if value is not None and not value < self.max_v:
                allowed = f"below max_voltage of the trains, {self.max_v:g} V"
                raise InputError("a voltage that is never reached", **_voltage(name, value, allowed))
        for name, value in below:
            if not value > self.cut_off_v:
                allowed = f"above cut_off of the trains, {self.cut_off_v:g} V"
                raise InputError("a voltage that is never reached", **_voltage(name, value, allowed))

    @property
    def ohm_per_m(self) -> float:
        """Resistance of the loop of one track: conductor rail and running rails."""
        return self.conductor_ohm_per_m + self.running_ohm_per_m

    def check_line(self, line: Line) -> None:
        """Refuse another line than that of the feeding, and a substation or a storage off it.

        Args:
            line: Line to feed.

        Raises:
            InputError: Another line, or the place off it, its position and where the line is.
        """
        if self.line_id != line.id:
            raise InputError(
                "a feeding of another line", file=self.id, field="line", value=self.line_id, allowed=line.id
            )
        first_m, last_m = (line.stations[k].position_m for k in (0, -1))
        for kind, places in (("substation", self.substations), ("storage", self.storages)):
            for index, each in enumerate(places):
                if not first_m <= each.position_m <= last_m:
                    raise InputError(
                        f"{kind} off the line: {each.name or index}",
                        file=self.id,
                        field=f"{kind}s[{index}].position",
                        value=tidy(each.position_m),
                        unit="m",
                        allowed=f"{first_m:g} to {last_m:g} m",
                    )
