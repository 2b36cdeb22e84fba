"""Energy of a line by driving and timetable beside its floor, its timetable as a table, and pictures."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from metropilot._io import fill_folder, write_json
from metropilot._provenance import provenance
from metropilot._typing import Float
from metropilot.convoy import BlockingTimes
from metropilot.operation.comparison import ComparedEnergy
from metropilot.operation.feeding import FeedingEnergy, voltage_figure
from metropilot.operation.floor import TripFloors, check_sharp, zone_floor_j
from metropilot.operation.headway import check_headway, line_headways
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.network_search import refine_timetable
from metropilot.operation.power import SAME_S
from metropilot.operation.search import best_offset, choose_plans, find_timetable
from metropilot.operation.service_hours import AS_PLANNED, ServiceHours, ServiceScatter
from metropilot.physics import vehicle_arrays
from metropilot.planning import is_mapped
from metropilot.railway import Feeding
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 8.4, 5.2
MW = 1e6
HEADWAYS_DRAWN = 3
"""Headways that a train graph shows."""
RECEIVED = 1.0, 4.0
"""Power that plans count on being received, where it is not all, over that of the auxiliaries."""
SETTLED = 1e-3
"""Nearer than this to the floor with all received, no sharper one is looked for."""


@dataclass(frozen=True, kw_only=True)
class OperationEnergy(ComparedEnergy):
    """Energy of all trains of a line in one headway, which is that of one train in a round trip.

    Attributes:
        operation: Line in operation.
        all_received_floor_kwh: The same as far as it is known without zones and headway: all is received.
        timetable: Timetable of ``balance``.
        profiles: Its profiles of power.
        network_kwh: What a network takes by driving and timetable, where one feeds the line, None where it
            cannot carry the load: ``cruise_kwh``, ``driving_only_kwh``, ``timetable_only_kwh`` (with that
            found for the zones), and where the timetable of optimal driving was sought on the network
            ``zones_timetable_kwh`` with the one that is best for the zones.
    """

    operation: LineOperation
    all_received_floor_kwh: float
    timetable: Timetable
    profiles: Profiles
    network_kwh: Mapping[str, float | None] = field(default_factory=dict)

    def headways(self) -> tuple[BlockingTimes, BlockingTimes]:
        """Blocking times of ``timetable`` forward and backward."""
        return line_headways(self.operation, self.timetable, self.profiles)

    def as_dict(self, network: FeedingEnergy | None = None) -> dict[str, Any]:
        """Values as JSON holds them.

        Args:
            network: What a network makes of ``timetable``, if one feeds the line.
        """
        fed = None if network is None else network.as_dict() | dict(self.network_kwh)
        return self.describe(self.operation, fed) | {
            "headway_s": self.operation.options.headway_s,
            "all_received_floor_kwh": self.all_received_floor_kwh,
            "technical_headway_s": max(each.headway_s for each in self.headways()),
            "fleet": self.operation.fleet(self.timetable),
        }


def operation_energy(
    operation: LineOperation,
    *,
    searched: bool = False,
    seed: int = 0,
    plans: Mapping[str, Sequence[Profiles]] | None = None,
    floors: TripFloors | None = None,
    feeding: Feeding | None = None,
    sharp: bool = False,
    scatter: ServiceScatter = AS_PLANNED,
) -> OperationEnergy:
    """Compute the energy of a line by driving and timetable, and its floor.

    The floor knows headway and zones where the energy is more than ``SETTLED`` above the floor with all that
    is returned received.

    Args:
        operation: Line in operation.
        searched: Search dwells and running times too, within their windows; else only the offset.
        seed: Seed of the search.
        plans: What :func:`plan_trips` gave for all running times of the windows, if it is there; it depends
            on neither headway nor zones.
        floors: Least energies of the trips, as far as they are there; the same holds.
        feeding: Network for which the timetable of optimal driving is sought in the end, where dwells and
            running times are searched; the energies of a driver and of scattered departures are its own.
        sharp: Sharpen the floor too, where each section is a zone; see :func:`zone_floor_j`.
        scatter: What does not go as planned, hour after hour, reported besides.

    Raises:
        InputError: Trains disturb one another at the headway; names the section or station.
    """
    if sharp:
        check_sharp(operation)
    plans = plans or plan_trips(operation, windows=searched)
    (all_received, *_), (cruise, *_) = plans["optimal"], plans["cruise"]
    check_headway(operation, operation.plain_timetable(), all_received, cruise)

    def find(driving: str) -> tuple[Timetable, Profiles]:
        if searched:
            adapted = driving == "optimal" and feeding is None
            return find_timetable(operation, plans[driving], seed=seed, adapted=adapted)
        timetable = best_offset(operation, plans[driving][0])
        return timetable, choose_plans(operation, timetable, plans[driving])[0]

    (timetable, profiles), cruised = find("optimal"), find("cruise")
    hours, network_kwh = ServiceHours(operation, feeding), dict[str, float | None]()
    if feeding is not None:
        plain = {"cruise_kwh": cruise, "driving_only_kwh": all_received}
        network_kwh = {name: hours.plain_kwh(each) for name, each in plain.items()}
        network_kwh["timetable_only_kwh"] = hours.periodic_kwh(*cruised)
    if searched and feeding is not None:
        network_kwh["zones_timetable_kwh"] = hours.periodic_kwh(timetable, profiles)
        chosen = plans["optimal"]
        timetable, profiles = refine_timetable(operation, timetable, profiles, chosen, feeding, seed=seed)
    balance, floor_j = operation.energy(timetable, profiles), operation.floor_j(all_received)
    settled = balance.supplied_j <= (1.0 + SETTLED) * floor_j
    floors = floors or TripFloors(operation)
    met_j = floor_j if settled else zone_floor_j(operation, floors, windows=searched, sharp=sharp)
    return OperationEnergy(
        operation=operation,
        searched=searched,
        cruise_kwh=operation.mean_energy_j(cruise) / J_PER_KWH,
        driving_only_kwh=operation.mean_energy_j(all_received) / J_PER_KWH,
        timetable_only_kwh=operation.energy(*cruised).supplied_kwh,
        balance=balance,
        floor_kwh=max(floor_j, met_j) / J_PER_KWH,
        all_received_floor_kwh=floor_j / J_PER_KWH,
        timetable=timetable,
        profiles=profiles,
        network_kwh=network_kwh,
        **hours.scatter(timetable, profiles, scatter),
    )


def plan_trips(operation: LineOperation, *, windows: bool = False) -> dict[str, list[Profiles]]:
    """Profiles to choose from by driving: ``optimal``, and ``cruise``.

    Where efficiencies are constant, optimal driving has further plans, which count on less being received.

    Args:
        operation: Line in operation.
        windows: True for every running time of the windows.
    """
    received_w = [math.inf]
    if not is_mapped(vehicle_arrays(operation.silent)):
        received_w += [share * operation.trainset.auxiliary_w for share in RECEIVED]
    return {
        "optimal": [operation.profiles(windows=windows, received_w=each) for each in received_w],
        "cruise": [operation.profiles("cruise", windows=windows)],
    }


class TrainPath(NamedTuple):
    """A piece of a train graph over which the train draws, returns, or does neither.

    Attributes:
        use: 1 where it draws, -1 where it returns, 0 where it coasts or stands.
        time_s: Times.
        position_m: Positions on the line.
    """

    use: int
    time_s: Float[np.ndarray, " points"]
    position_m: Float[np.ndarray, " points"]


def train_paths(found: OperationEnergy, last_s: float) -> Iterator[TrainPath]:
    """Paths of all trains of a train graph from 0 to a time.

    Args:
        found: Energy and timetable.
        last_s: End of the graph.
    """
    operation, table = found.operation, found.timetable
    headway_s = operation.options.headway_s
    arrival, dwell = table.arrival_s, operation.dwells_s(table)
    for k, trip in enumerate(operation.trips):
        profile = found.profiles[k][int(table.running_time_s[k])]
        start_m, end_m = trip.section.origin.position_m, trip.section.destination.position_m
        position = start_m + (1.0 if end_m > start_m else -1.0) * profile.position_m
        net = profile.net_w(0.0).mean(axis=1)
        use = np.sign(np.where(np.abs(net) > 1e3, net, 0.0))
        edges = np.concatenate([[0], np.flatnonzero(np.diff(use)) + 1, [use.size]])
        first = int(-(arrival[k] + dwell[k]) // headway_s)
        for turn in range(first, int((last_s - table.departure_s[k]) // headway_s) + 1):
            time = profile.time_s + table.departure_s[k] + turn * headway_s
            for a, b in pairwise(edges.tolist()):
                yield TrainPath(int(use[a]), time[a : b + 1], position[a : b + 1])
            yield TrainPath(0, np.array([time[-1], time[-1] + dwell[k]]), position[[-1, -1]])


def line_figure(found: OperationEnergy) -> Figure:
    """Train graph of three headways, with what each train draws and returns."""
    from metropilot.evaluate import GREEN, GREY, VERMILION, add_headline, house_style, new_panels

    last_s = HEADWAYS_DRAWN * found.operation.options.headway_s
    with house_style():
        figure, (axes,) = new_panels(WIDTH_IN, HEIGHT_IN, (1.0,))
        colours = {1: VERMILION, 0: GREY, -1: GREEN}
        for use, name in ((1, "draws"), (0, "coasts or stands"), (-1, "returns")):
            axes.plot([], [], color=colours[use], label=name)
        for path in train_paths(found, last_s):
            axes.plot(path.time_s, path.position_m / 1000.0, color=colours[path.use], linewidth=1.1)
        stations = found.operation.line.stations
        axes.set_yticks([s.position_m / 1000.0 for s in stations], [s.code for s in stations])
        axes.set_xlim(0, last_s)
        axes.set_xlabel("time, s")
        add_headline(axes, _title(found), _below(found))
        return figure


def power_figure(found: OperationEnergy) -> Figure:
    """Net power of the trains in each zone over one headway; what is below zero nobody receives."""
    from metropilot.evaluate import (
        BLUE,
        VERMILION,
        add_headline,
        house_style,
        label_panel,
        new_panels,
    )

    zones = found.operation.zone_power(found.timetable, found.profiles)
    with house_style():
        height_in = max(HEIGHT_IN, 0.62 * len(zones) + 1.3)
        figure, panels = new_panels(WIDTH_IN, height_in, (1.0,) * len(zones))
        for k, (axes, zone) in enumerate(zip(panels, zones, strict=True)):
            # within an instant pieces end and begin one after the other: no power that anybody sees
            lasts = np.diff(zone.time_s) > SAME_S
            time = np.stack([zone.time_s[:-1], zone.time_s[1:]], axis=1)[lasts].ravel()
            power = zone.power_w[lasts].ravel() / MW
            axes.plot(time, power, color=BLUE, linewidth=0.9)
            axes.fill_between(time, np.minimum(power, 0.0), color=VERMILION, alpha=0.5, linewidth=0)
            axes.axhline(0.0, color="black", linewidth=0.5)
            axes.set_ylabel("MW")
            if k:
                label_panel(axes, f"zone {k + 1}")
        panels[-1].set_xlim(0, found.operation.options.headway_s)
        panels[-1].set_xlabel("time, s")
        add_headline(panels[0], _title(found), f"net power of each zone; {_below(found)}")
        return figure


def _title(found: OperationEnergy) -> str:
    operation = found.operation
    trainset = operation.trainset
    return f"{operation.line.id}, {trainset.id} {trainset.load}, every {operation.options.headway_s} s"


def _below(found: OperationEnergy) -> str:
    return f"{found.energy_kwh:.1f} kWh a round trip, {found.gap_percent:.2f} % above the floor"


TIMETABLE_COLUMNS = (
    "direction",
    "origin",
    "destination",
    "zone",
    "departure_s",
    "arrival_s",
    "running_time_s",
    "dwell_s",
)


def write_operation(folder: Path, found: OperationEnergy, network: FeedingEnergy | None = None) -> None:
    """Write `line.json`, `timetable.csv`, and the pictures `trains` and `power` as SVG and PNG.

    Args:
        folder: Folder; created if missing.
        found: Energy and timetable.
        network: What a network makes of the timetable; written too, with the picture `voltage`.

    Raises:
        InputError: The folder cannot be made or written.
    """
    from metropilot.evaluate import save_figure

    with fill_folder(folder) as scratch:
        write_json(scratch / "line.json", found.as_dict(network) | {"made_with": provenance()})
        with (scratch / "timetable.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(TIMETABLE_COLUMNS)
            writer.writerows(_timetable_rows(found))
        save_figure(line_figure(found), scratch / "trains")
        save_figure(power_figure(found), scratch / "power")
        if network is not None:
            save_figure(voltage_figure(network), scratch / "voltage")


def _timetable_rows(found: OperationEnergy) -> list[tuple[object, ...]]:
    """One row a trip; the dwell is that at its destination."""
    table = found.timetable
    dwell = found.operation.dwells_s(table)
    return [
        (
            "backward" if trip.backward else "forward",
            trip.section.origin.code,
            trip.section.destination.code,
            trip.zone + 1,
            round(float(table.departure_s[k])),
            round(float(table.arrival_s[k])),
            int(table.running_time_s[k]),
            round(float(dwell[k])),
        )
        for k, trip in enumerate(found.operation.trips)
    ]
