"""Folder of a day: values, timetable, pictures, and what repeats it."""

from __future__ import annotations

import csv
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot._io import encode_parquet, fill_folder, write_json
from metropilot._provenance import provenance
from metropilot.operation.day import HOUR_S, MINUTE_S
from metropilot.operation.day_energy import DayEnergy
from metropilot.operation.feeding import FeedingEnergy
from metropilot.operation.gtfs import write_gtfs
from metropilot.railway import copy_input
from metropilot.units import J_PER_KWH, format_clock

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 10.4, 6.4
MW = 1e6
COLUMNS = {
    "journey": "INTEGER",
    "train": "INTEGER",
    "period": "VARCHAR",
    "direction": "VARCHAR",
    "origin": "VARCHAR",
    "destination": "VARCHAR",
    "departure": "VARCHAR",
    "departure_s": "INTEGER",
    "arrival_s": "INTEGER",
    "running_time_s": "INTEGER",
    "dwell_s": "INTEGER",
}


def day_rows(found: DayEnergy) -> list[dict[str, Any]]:
    """Timetable of a day, one row a trip; the dwell is that at its destination, times are from midnight."""
    rows = []
    count = found.day.operation.count
    for way, each in enumerate(found.day.timetable):
        trips = found.day.operation.trips[count * way :][:count]
        dwell_s = np.pad(each.departure_s[:, 1:] - each.arrival_s[:, :-1], ((0, 0), (0, 1)))
        for j, period in enumerate(each.period.tolist()):
            rows += [
                {
                    "journey": j + 1,
                    "train": int(found.links.train[way][j]) + 1,
                    "period": found.period_names[period] if found.period_names else "",
                    "direction": "backward" if way else "forward",
                    "origin": trip.section.origin.code,
                    "destination": trip.section.destination.code,
                    "departure": format_clock(float(each.departure_s[j, k])),
                    "departure_s": round(float(each.departure_s[j, k])),
                    "arrival_s": round(float(each.arrival_s[j, k])),
                    "running_time_s": int(each.running_time_s[j, k]),
                    "dwell_s": round(float(dwell_s[j, k])),
                }
                for k, trip in enumerate(trips)
            ]
    return rows


def write_day(
    folder: Path, found: DayEnergy, options: Mapping[str, Any], network: FeedingEnergy | None = None
) -> None:
    """Write `day.json`, `timetable.csv`, `timetable.parquet`, `gtfs.zip`, `run.toml` and pictures.

    Args:
        folder: Folder; created if missing.
        found: Energy of the day.
        options: Options of `metropilot line` that it was computed with, by field; files are copied.
        network: What a network makes of it; written too, with the picture `voltage`.

    Raises:
        InputError: The folder cannot be made or written.
    """
    from metropilot.evaluate import save_figure

    rows = day_rows(found)
    with fill_folder(folder) as scratch:
        write_json(scratch / "day.json", found.as_dict(network) | {"made_with": provenance()})
        with (scratch / "timetable.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(COLUMNS))
            writer.writeheader()
            writer.writerows(rows)
        (scratch / "timetable.parquet").write_bytes(encode_parquet(COLUMNS, rows))
        day = found.day
        write_gtfs(scratch / "gtfs.zip", day.operation.line, day.timetable, found.links, found.name)
        save_figure(day_figure(found), scratch / "trains")
        save_figure(day_power_figure(found), scratch / "power")
        if network is not None:
            save_figure(day_voltage_figure(found, network), scratch / "voltage")
        _write_run_toml(scratch, options)


def _write_run_toml(folder: Path, options: Mapping[str, Any]) -> None:
    import tomli_w

    told = {key: value for key, value in options.items() if value is not None and value is not False}
    for key in ("line", "trainset", "day", "feeding"):
        if key in told:
            told[key] = copy_input(folder, told[key], key)
    if "timetable" in told:
        told["timetable"] = "gtfs.zip"
        told.pop("service", None)
    words = ["metropilot", "line", told["line"]]
    for key, value in told.items():
        if key != "line":
            words += [
                f"--{key.removesuffix('_s').replace('_', '-')}",
                *([] if value is True else [str(value)]),
            ]
    head = f"# Compute it again in this folder: {shlex.join(words)}\n\n"
    table = {"line": told, "made_with": provenance()}
    (folder / "run.toml").write_text(head + tomli_w.dumps(table), encoding="utf-8")


def day_figure(found: DayEnergy) -> Figure:
    """Train graph of a day."""
    from metropilot.evaluate import BLUE, VERMILION, add_headline, house_style, new_panels

    stations = found.day.operation.line.stations
    km = np.array([each.position_m for each in stations]) / 1000.0
    with house_style():
        figure, (axes,) = new_panels(WIDTH_IN, HEIGHT_IN, (1.0,))
        for way, (each, colour) in enumerate(zip(found.day.timetable, (BLUE, VERMILION), strict=True)):
            place = np.repeat(km[::-1] if way else km, 2)[1:-1]
            axes.plot(each.stop_times_s.T / HOUR_S, place, color=colour, linewidth=0.5)
        axes.set_yticks(km, [each.code for each in stations])
        _set_clock(axes, found)
        add_headline(axes, _title(found), _below(found))
        return figure


def day_power_figure(found: DayEnergy) -> Figure:
    """Power of a day by minutes, and its energy by hours."""
    from metropilot.evaluate import (
        BLUE,
        GREY,
        VERMILION,
        add_headline,
        house_style,
        label_panel,
        new_panels,
    )

    power = found.power
    hours = (power.first_s + MINUTE_S * np.arange(power.supplied_w.shape[0])) / HOUR_S
    with house_style():
        figure, (minutes, bars) = new_panels(WIDTH_IN, HEIGHT_IN, (1.6, 1.0))
        minutes.plot(hours, power.supplied_w.sum(axis=1) / MW, color=BLUE, linewidth=0.7)
        minutes.fill_between(hours, -power.unused_w.sum(axis=1) / MW, color=VERMILION, alpha=0.5, linewidth=0)
        minutes.axhline(0.0, color="black", linewidth=0.5)
        minutes.set_ylabel("MW")
        bars.bar(hours[:: HOUR_S // MINUTE_S] + 0.5, power.hourly_kwh / 1000.0, width=0.85, color=GREY)
        bars.set_ylabel("MWh")
        label_panel(bars, "energy from the substations, hour by hour")
        _set_clock(bars, found)
        minutes.set_xlim(*bars.get_xlim())
        below = f"mean power of each minute, below zero what nobody receives; {_below(found)}"
        add_headline(minutes, _title(found), below)
        return figure


def day_voltage_figure(found: DayEnergy, network: FeedingEnergy) -> Figure:
    """Lowest and highest voltage at a train, and power of all substations, minute by minute."""
    from metropilot.evaluate import (
        BLUE,
        GREY,
        VERMILION,
        add_headline,
        house_style,
        label_panel,
        new_panels,
    )

    flow, feeding = network.flow, network.feeding
    minute = flow.loads.second // MINUTE_S
    count = -(-flow.rail_loss_w.size // MINUTE_S)
    extremes = np.full((2, count), np.nan)
    for row, pick in zip(extremes, (np.fmin, np.fmax), strict=True):
        pick.at(row, minute, flow.train_v)
    total_w = np.pad(flow.rectifier_w.sum(axis=1), (0, count * MINUTE_S - flow.rail_loss_w.size))
    by_minute = total_w.reshape(count, MINUTE_S) / MW
    hours = (found.day.timetable.span_s[0] + MINUTE_S * np.arange(count)) / HOUR_S
    told = network.as_dict()
    with house_style():
        figure, (volts, power) = new_panels(WIDTH_IN, HEIGHT_IN, (1.4, 1.0))
        volts.fill_between(hours, extremes[0], extremes[1], color=BLUE, alpha=0.6, linewidth=0)
        for limit_v in (feeding.max_v, feeding.squeezed_above_v, feeding.reduced_below_v):
            volts.axhline(limit_v, color=GREY, linewidth=0.5, linestyle="--")
        volts.set_ylabel("V")
        power.plot(hours, by_minute.max(axis=1), color=VERMILION, linewidth=0.6, label="highest second")
        power.plot(hours, by_minute.mean(axis=1), color=BLUE, linewidth=0.8, label="mean")
        power.set_ylabel("MW")
        label_panel(power, "all substations, by minutes")
        power.legend(loc="upper right")
        _set_clock(power, found)
        volts.set_xlim(*power.get_xlim())
        add_headline(
            volts,
            f"{_title(found)}, feeding {feeding.id}",
            f"{network.energy_kwh:.0f} kWh a day; trains at {told['lowest_v']:.0f} to "
            f"{told['highest_v']:.0f} V, lowest and highest of each minute",
        )
        return figure


def _set_clock(axes: Axes, found: DayEnergy) -> None:
    first_s, last_s = found.day.timetable.span_s
    axes.set_xlim(first_s / HOUR_S, last_s / HOUR_S)
    axes.set_xlabel("time of day, h")


def _title(found: DayEnergy) -> str:
    operation = found.day.operation
    trainset = operation.trainset
    journeys = found.day.timetable.journeys
    return (
        f"{operation.line.id}, {trainset.id} {trainset.load}, {journeys} journeys, {found.links.fleet} trains"
    )


def _below(found: DayEnergy) -> str:
    returned_kwh = found.balance.returned_j / J_PER_KWH
    return (
        f"{found.energy_kwh:.0f} kWh a day, {found.gap_percent:.2f} % above the floor, "
        f"{returned_kwh:.0f} kWh returned"
    )
