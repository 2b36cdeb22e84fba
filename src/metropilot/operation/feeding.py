"""A line fed by a DC network: places and powers of its trains every second, and the energy of the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.network import NetworkFlow, TrainLoads, solve_network
from metropilot.operation.power import integral_until
from metropilot.railway import Feeding
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 8.4, 6.4
MW = 1e6


class _Journey(NamedTuple):
    """One train of a direction second by second of the clock.

    Attributes:
        first_s: First second.
        position_m: Position in the middle of each second. Shape (J,).
        power_w: Mean power over each second, positive drawn. Shape (J,).
    """

    first_s: int
    position_m: Float[ndarray, " seconds"]
    power_w: Float[ndarray, " seconds"]


def _journey(
    operation: LineOperation, timetable: Timetable, profiles: Profiles, *, backward: bool
) -> _Journey:
    """Positions and powers of a direction's train from its first departure to its last arrival."""
    time_s: list[ndarray] = []
    position_m: list[ndarray] = []
    power_w: list[ndarray] = []
    for k, trip in enumerate(operation.trips):
        if trip.backward != backward:
            continue
        profile = profiles[k][int(timetable.running_time_s[k])]
        time_s.append(timetable.departure_s[k] + profile.time_s)
        sign = -1.0 if backward else 1.0
        position_m.append(trip.section.origin.position_m + sign * profile.position_m)
        # the dwell until the next departure is one more segment
        net_w = np.append(profile.net_w(0.0), np.zeros((1, 2)), axis=0)
        power_w.append(net_w + operation.trainset.auxiliary_w)
    begin_s, place_m, ends_w = (np.concatenate(each) for each in (time_s, position_m, power_w))
    # after its last arrival the train is shut down
    first_s, last_s = int(np.floor(begin_s[0])), int(np.ceil(begin_s[-1]))
    clock_s = np.clip(np.arange(first_s, last_s + 1), begin_s[0], begin_s[-1])
    reached_j = integral_until(begin_s, ends_w[:-1], clock_s)
    return _Journey(first_s, np.interp(clock_s[:-1] + 0.5, begin_s, place_m), np.diff(reached_j))


def train_loads(
    operation: LineOperation,
    timetable: Timetable,
    profiles: Profiles,
    starts_s: tuple[Sequence[int], Sequence[int]] | None = None,
) -> tuple[TrainLoads, int]:
    """Places and powers of all trains second by second, and the number of seconds.

    The power of a second is its mean, so that energies are exact; the place is that at half of it. A train
    that draws and returns in one second uses its own power first, and so do its auxiliaries.

    Args:
        operation: Line in operation.
        timetable: Timetable of one train each way.
        profiles: Powers of its trips.
        starts_s: First departures of the trains forward and backward, whole seconds, instead of one every
            headway; seconds then count from the first of all.
    """
    headway_s = operation.options.headway_s
    rows: list[TrainLoads] = []
    journeys = [_journey(operation, timetable, profiles, backward=way) for way in (False, True)]
    for backward, journey in zip((False, True), journeys, strict=True):
        count = journey.power_w.size
        if starts_s is None:
            # all trains of one headway: the same train, seen one headway later each time
            second = (journey.first_s + np.arange(count)) % headway_s
            train = np.arange(count) // headway_s
            copies = 1
        else:
            start = np.asarray(starts_s[int(backward)], dtype=int)
            second = (start[:, None] + np.arange(count)).ravel()
            train = np.repeat(np.arange(start.size), count)
            copies = start.size
        rows.append(
            TrainLoads(
                second,
                train,
                np.full(second.size, backward),
                np.tile(journey.position_m, copies),
                np.tile(journey.power_w, copies),
                # in a headway the same train comes by again and again, forward and then back
                np.zeros(second.size, int) if starts_s is None else 2 * train + backward,
            )
        )
    loads = TrainLoads(*(np.concatenate(each) for each in zip(*rows, strict=True)))
    if starts_s is None:
        return loads, headway_s
    first = int(loads.second.min())
    return loads._replace(second=loads.second - first), int(loads.second.max()) - first + 1


@dataclass(frozen=True)
class FeedingEnergy:
    """Energy of a line that a DC network feeds.

    Attributes:
        feeding: Network.
        flow: Its voltages and powers.
    """

    feeding: Feeding
    flow: NetworkFlow

    @property
    def energy_kwh(self) -> float:
        """Energy from the grid less that of the inverters."""
        return (self.flow.supplied_j - self.flow.inverted_j) / J_PER_KWH

    def _describe_storage(self) -> dict[str, Any]:
        """Energy through storages beside the track and aboard, nothing where there are none."""
        flow, told = self.flow, {}
        beside = zip(self.feeding.storages, flow.storage_w.T, flow.storage_j.T, strict=True)
        if self.feeding.storages:
            told["storages"] = [
                {
                    "name": each.name,
                    "position_m": each.position_m,
                    **_through(power_w),
                    "lowest_kwh": float(energy_j.min()) / J_PER_KWH,
                    "highest_kwh": float(energy_j.max()) / J_PER_KWH,
                }
                for each, power_w, energy_j in beside
            ]
        if self.feeding.onboard is not None:
            told["onboard_storage"] = _through(flow.onboard_w)
        return told | ({"storage_change_kwh": flow.stored_j / J_PER_KWH} if told else {})

    def as_dict(self) -> dict[str, Any]:
        """Values as JSON holds them."""
        flow = self.flow
        seconds = flow.rail_loss_w.size
        row = flow.lowest()
        return {
            "id": self.feeding.id,
            "energy_kwh": self.energy_kwh,
            "supplied_kwh": flow.supplied_j / J_PER_KWH,
            "inverted_kwh": flow.inverted_j / J_PER_KWH,
            "drawn_kwh": flow.drawn_j / J_PER_KWH,
            "returned_kwh": flow.returned_j / J_PER_KWH,
            "squeezed_kwh": (flow.offered_j - flow.returned_j) / J_PER_KWH,
            "rail_loss_kwh": float(flow.rail_loss_w.sum()) / J_PER_KWH,
            "substation_loss_kwh": float(flow.substation_loss_w.sum()) / J_PER_KWH,
            "balance": flow.imbalance,
            **self._describe_storage(),
            "lowest_v": float(flow.train_v[row]),
            "lowest_second": int(flow.loads.second[row]),
            "lowest_position_m": float(flow.loads.position_m[row]),
            "highest_v": float(flow.train_v.max()),
            "peak_w": float(flow.rectifier_w.sum(axis=1).max()),
            "substations": [
                {
                    "name": each.name,
                    "position_m": each.position_m,
                    "supplied_kwh": float(flow.rectifier_w[:, k].sum()) / J_PER_KWH,
                    "inverted_kwh": float(flow.inverter_w[:, k].sum()) / J_PER_KWH,
                    "mean_w": float(flow.rectifier_w[:, k].sum()) / seconds,
                    "peak_w": float(flow.rectifier_w[:, k].max()),
                    "lowest_v": float(flow.substation_v[:, k].min()),
                }
                for k, each in enumerate(self.feeding.substations)
            ],
        }


def _through(power_w: ndarray) -> dict[str, float]:
    """Energy into a storage and out of it."""
    parts = {"charged_kwh": np.maximum(power_w, 0.0), "discharged_kwh": np.maximum(-power_w, 0.0)}
    return {name: float(part.sum()) / J_PER_KWH for name, part in parts.items()}


def feed_line(
    operation: LineOperation, timetable: Timetable, profiles: Profiles, feeding: Feeding
) -> FeedingEnergy:
    """Feed all trains of a line in one headway by a DC network.

    Args:
        operation: Line in operation.
        timetable: Timetable.
        profiles: Powers of its trips.
        feeding: Network.

    Raises:
        InputError: A substation off the line.
        Infeasible: The network cannot carry the load.
    """
    feeding.check_line(operation.line)
    flow = solve_network(feeding, *train_loads(operation, timetable, profiles), periodic=True)
    flow.check_served()
    return FeedingEnergy(feeding, flow)


def voltage_figure(found: FeedingEnergy) -> Figure:
    """Voltage of every train and second along the line, and the power of the substations over time."""
    from metropilot.evaluate import BLUE, GREY, VERMILION, add_headline, house_style, label_panel, new_panels

    flow, feeding = found.flow, found.feeding
    told, km = found.as_dict(), flow.loads.position_m / 1000.0
    with house_style():
        figure, (along, power) = new_panels(WIDTH_IN, HEIGHT_IN, (2.0, 1.0))
        for backward, colour, name in ((False, BLUE, "forward"), (True, VERMILION, "backward")):
            rows = flow.loads.backward == backward
            along.plot(km[rows], flow.train_v[rows], ".", markersize=2.0, color=colour, label=name)
        for volts in (feeding.max_v, feeding.squeezed_above_v, feeding.reduced_below_v):
            along.axhline(volts, color=GREY, linewidth=0.5, linestyle="--")
        along.set_ylabel("V")
        for each in told["substations"]:
            place = each["position_m"] / 1000.0
            along.axvline(place, color=GREY, linewidth=0.4)
            power.vlines(place, 0.0, each["peak_w"] / MW, color=GREY, linewidth=1.0)
            power.vlines(place, 0.0, each["mean_w"] / MW, color=BLUE, linewidth=5.0)
        power.set_xticks(
            [each["position_m"] / 1000.0 for each in told["substations"]],
            [each["name"] for each in told["substations"]],
        )
        power.set_ylim(bottom=0.0)
        power.set_xlabel("substation")
        power.set_ylabel("MW")
        label_panel(power, "mean power of each substation, and highest of a second")
        add_headline(
            along,
            f"{feeding.line_id}, feeding {feeding.id}",
            f"{found.energy_kwh:.1f} kWh a headway; trains at {told['lowest_v']:.0f} to "
            f"{told['highest_v']:.0f} V; dashed: {feeding.reduced_below_v:g} V, less current; above "
            f"{feeding.squeezed_above_v:g} V less is returned, at {feeding.max_v:g} V nothing",
        )
        return figure
