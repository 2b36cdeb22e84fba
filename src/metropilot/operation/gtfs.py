"""Timetables of a day as GTFS: agency, routes, stops, calendar, trips and stop times.

Specification: https://gtfs.org/documentation/schedule/reference/. A line has no geographical coordinates, so
stops are placed on a meridian, at their true distances.
"""

from __future__ import annotations

import csv
import io
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from metropilot._io import MAX_TEXT_BYTES, atomic_write, fill_folder, read_text
from metropilot.errors import InputError
from metropilot.operation.day import DayTimetable, Journeys, TrainLinks
from metropilot.railway import Line, Station
from metropilot.units import format_clock, parse_clock

SERVICE = "day"
CALENDAR = "20260101", "20261231"
WEEK = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")
FIRST_LATITUDE, LONGITUDE, METRES_PER_DEGREE = 10.0, 10.0, 111_195.0
"""Where the line is drawn: a validator refuses what is near the origin."""
SUBWAY = 1
ZIP_DATE = (1980, 1, 1, 0, 0, 0)
"""Date of the files in a zip file: the same timetable gives the same bytes."""
NEEDED = {
    "stops": ("stop_id",),
    "trips": ("trip_id", "service_id"),
    "stop_times": ("trip_id", "arrival_time", "departure_time", "stop_id", "stop_sequence"),
    "frequencies": ("trip_id", "start_time", "end_time", "headway_secs"),
}
OPTIONAL = "frequencies"


def write_gtfs(path: Path, line: Line, timetable: DayTimetable, links: TrainLinks, name: str = "") -> None:
    """Write the timetable of a day as a GTFS feed, departures in whole seconds.

    Args:
        path: A folder, or a file ending in ``.zip``.
        line: Its line.
        timetable: Timetable.
        links: Trains; a train is a block.
        name: Name of the day.

    Raises:
        InputError: It cannot be written.
    """
    tables = {f"{stem}.txt": _text(rows) for stem, rows in _tables(line, timetable, links, name).items()}
    if path.suffix.lower() != ".zip":
        with fill_folder(path) as scratch:
            for file, text in tables.items():
                (scratch / file).write_text(text, encoding="utf-8")
        return

    def write(partial: Path) -> None:
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            for file, text in tables.items():
                archive.writestr(zipfile.ZipInfo(file, ZIP_DATE), text, zipfile.ZIP_DEFLATED)

    atomic_write(path, write)


def _text(rows: Sequence[Mapping[str, object]]) -> str:
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]), lineterminator="\r\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()


def _tables(
    line: Line, timetable: DayTimetable, links: TrainLinks, name: str
) -> dict[str, Sequence[Mapping[str, object]]]:
    first_m = line.stations[0].position_m
    stops = []
    for each in line.stations:
        latitude = FIRST_LATITUDE + (each.position_m - first_m) / METRES_PER_DEGREE
        place = {"stop_lat": f"{latitude:.7f}", "stop_lon": f"{LONGITUDE:.7f}"}
        stops.append({"stop_id": each.code, "stop_name": each.name, **place})
    trips, stop_times = [], []
    for way, journeys in enumerate(timetable):
        stations = line.stations[::-1] if way else line.stations
        for j, (departure_s, arrival_s) in enumerate(
            zip(journeys.departure_s, journeys.arrival_s, strict=True)
        ):
            trip = f"{'FB'[way]}{j + 1:04d}"
            trips.append(
                {
                    "route_id": line.id,
                    "service_id": SERVICE,
                    "trip_id": trip,
                    "trip_headsign": stations[-1].name,
                    "direction_id": way,
                    "block_id": f"T{int(links.train[way][j]) + 1:03d}",
                }
            )
            # a train arrives at its first station, and departs from its last, when it is there
            arrives_s, leaves_s = [departure_s[0], *arrival_s], [*departure_s, arrival_s[-1]]
            stop_times += [
                {
                    "trip_id": trip,
                    "arrival_time": format_clock(float(arrives)),
                    "departure_time": format_clock(float(leaves)),
                    "stop_id": station.code,
                    "stop_sequence": k + 1,
                    "shape_dist_traveled": f"{abs(station.position_m - stations[0].position_m):g}",
                }
                for k, (station, arrives, leaves) in enumerate(
                    zip(stations, arrives_s, leaves_s, strict=True)
                )
            ]
    agency = {
        "agency_id": "metropilot",
        "agency_name": "metropilot",
        "agency_url": "https://example.org",
        "agency_timezone": "Etc/UTC",
    }
    route = {
        "route_id": line.id,
        "agency_id": "metropilot",
        "route_short_name": line.id,
        "route_long_name": line.name,
        "route_desc": name,
        "route_type": SUBWAY,
    }
    week = dict.fromkeys(WEEK, 1)
    calendar = {"service_id": SERVICE, **week, "start_date": CALENDAR[0], "end_date": CALENDAR[1]}
    return {
        "agency": [agency],
        "routes": [route],
        "stops": stops,
        "calendar": [calendar],
        "trips": trips,
        "stop_times": stop_times,
    }


class _Call(NamedTuple):
    """A stop of a trip: its number, its station, its times."""

    sequence: int
    station: Station
    arrival_s: int
    departure_s: int


def read_gtfs(path: Path, line: Line, service: str | None = None) -> DayTimetable:
    """Read the timetable of a day from a GTFS feed: the trips that stop at all stations of a line.

    Stops are stations by their id, code or name, or by those of their parent. Trips that stop at no more
    than one of them are those of other lines. A trip of ``frequencies.txt`` departs every headway from its
    start until before its end.

    Args:
        path: A folder, or a file ending in ``.zip``.
        line: The line.
        service: Its ``service_id``, where the feed has several.

    Raises:
        InputError: The feed cannot be read, or a trip of the line is none that serves all of it.
    """
    tables = {stem: _read_table(path, stem) for stem in NEEDED}
    stations = _stations_of_stops(line, tables["stops"])
    services = {row["trip_id"]: row["service_id"] for row in tables["trips"]}
    known = ", ".join(sorted(set(services.values())))
    if service is not None and service not in services.values():
        raise InputError("unknown service", file=path, field="service", value=service, allowed=known)
    starts_s = _frequent_starts(path, tables["frequencies"], services)
    mine, strange = _calls(path, tables["stop_times"], stations, services, service)
    found = sorted({services[trip] for trip in mine})
    if len(found) > 1:
        raise InputError("several services", file=path, field="service", allowed=", ".join(found))
    ways: tuple[list[tuple[list[int], list[int]]], ...] = ([], [])
    for trip, each in mine.items():
        if trip in strange:
            raise _bad(
                path, f"trip {trip}", "stop_id", "stop off the line", strange[trip], f"stations of {line.id}"
            )
        way, (departure_s, arrival_s) = _journey_times(path, line, trip, each)
        for start_s in starts_s.get(trip, departure_s[:1]):
            later_s = start_s - departure_s[0]
            ways[way].append(([s + later_s for s in departure_s], [s + later_s for s in arrival_s]))
    for way, each in zip(("forward", "backward"), ways, strict=True):
        if not each:
            words = f"trips of both directions; services are {known}"
            raise InputError(f"no trip {way} on {line.id}", file=path, allowed=words)
    return DayTimetable(*(_journeys(each) for each in ways))


def _calls(
    path: Path,
    rows: Sequence[Mapping[str, str]],
    stations: Mapping[str, Station],
    services: Mapping[str, str],
    service: str | None,
) -> tuple[dict[str, list[_Call]], dict[str, str]]:
    """Stops in their order of the trips with several at stations, and a stop off the line of each trip."""
    calls: dict[str, list[_Call]] = {}
    strange: dict[str, str] = {}
    for number, row in enumerate(rows, start=2):
        trip, station = row["trip_id"], stations.get(row["stop_id"])
        _check_trip(path, f"stop_times.txt line {number}", trip, services)
        if service is not None and services[trip] != service:
            continue
        if station is None:
            strange[trip] = row["stop_id"]
            continue
        calls.setdefault(trip, []).append(_call(path, number, row, station))
    by_number = attrgetter("sequence")
    mine = {trip: sorted(each, key=by_number) for trip, each in calls.items() if len(each) > 1}
    return mine, strange


def _frequent_starts(
    path: Path, rows: Sequence[Mapping[str, str]], services: Mapping[str, str]
) -> dict[str, list[int]]:
    """First departures of the trips that run every headway."""
    found: dict[str, list[int]] = {}
    for number, row in enumerate(rows, start=2):
        where = f"frequencies.txt line {number}"
        _check_trip(path, where, row["trip_id"], services)
        from_s, to_s = (
            parse_clock(row[name], file=path, field=f"{where}, {name}") for name in ("start_time", "end_time")
        )
        headway = row["headway_secs"]
        if not (headway.isascii() and headway.isdigit() and int(headway)):
            raise _bad(path, where, "headway_secs", "not a headway", headway, "whole seconds, at least 1")
        if to_s <= from_s:
            allowed = f"after {row['start_time']}"
            raise _bad(path, where, "end_time", "not after the start", row["end_time"], allowed)
        found.setdefault(row["trip_id"], []).extend(range(from_s, to_s, int(headway)))
    return found


def _check_trip(path: Path, where: str, trip: str, services: Mapping[str, str]) -> None:
    if trip not in services:
        raise _bad(path, where, "trip_id", "unknown trip", trip, "one of trips.txt")


def _journeys(times: list[tuple[list[int], list[int]]]) -> Journeys:
    times.sort()
    departure_s, arrival_s = (np.array(each) for each in zip(*times, strict=True))
    none = np.zeros_like(departure_s)
    return Journeys(departure_s.astype(float), arrival_s - departure_s, none, none[:, 0])


def _journey_times(
    path: Path, line: Line, trip: str, calls: list[_Call]
) -> tuple[int, tuple[list[int], list[int]]]:
    """Direction, departures and arrivals of a trip that serves all stations."""
    for before, after in pairwise(calls):
        if after.sequence == before.sequence:
            where = f"trip {trip}, {after.station.code}"
            raise _bad(
                path, where, "stop_sequence", "used twice", str(after.sequence), "one number for each stop"
            )
    codes = [each.station.code for each in calls]
    whole = [each.code for each in line.stations]
    if codes not in (whole, whole[::-1]):
        missing = next((code for code in whole if code not in codes), codes[0])
        raise _bad(
            path,
            f"trip {trip}",
            "stop_id",
            "does not serve the whole line in order",
            missing,
            "every station once",
        )
    for before, after in pairwise(calls):
        if after.arrival_s <= before.departure_s:
            allowed = f"after {format_clock(before.departure_s)}"
            raise _bad(
                path,
                f"trip {trip}, {after.station.code}",
                "arrival_time",
                "too early",
                format_clock(after.arrival_s),
                allowed,
            )
    return int(codes != whole), (
        [each.departure_s for each in calls[:-1]],
        [each.arrival_s for each in calls[1:]],
    )


def _call(path: Path, number: int, row: Mapping[str, str], station: Station) -> _Call:
    where = f"stop_times.txt line {number}"
    try:
        sequence = int(row["stop_sequence"])
    except ValueError:
        raise _bad(
            path, where, "stop_sequence", "not a number", row["stop_sequence"], "a whole number"
        ) from None
    arrival_s, departure_s = (
        parse_clock(row[name], file=path, field=f"{where}, {name}")
        for name in ("arrival_time", "departure_time")
    )
    if departure_s < arrival_s:
        allowed = f"{row['arrival_time']} or later"
        raise _bad(path, where, "departure_time", "before the arrival", row["departure_time"], allowed)
    return _Call(sequence, station, arrival_s, departure_s)


def _bad(path: Path, where: str, field: str, message: str, value: str, allowed: str) -> InputError:
    return InputError(message, file=path, field=f"{where}, {field}", value=value, allowed=allowed)


def _stations_of_stops(line: Line, stops: Sequence[Mapping[str, str]]) -> dict[str, Station]:
    """Station of every stop that is one of the line, by its id."""
    by_code = {each.code: each for each in line.stations}
    by_name = {
        name.casefold(): each
        for each in line.stations
        for name in (each.name, each.pinyin, each.local_name, each.code)
        if name
    }
    own = {}
    for row in stops:
        found = by_code.get(row["stop_id"]) or by_name.get(row.get("stop_code", "").casefold())
        own[row["stop_id"]] = found or by_name.get(row.get("stop_name", "").strip().casefold())
    every = {row["stop_id"]: own[row["stop_id"]] or own.get(row.get("parent_station", "")) for row in stops}
    return {key: station for key, station in every.items() if station is not None}


def _read_table(path: Path, stem: str) -> list[dict[str, str]]:
    name, zipped = f"{stem}.txt", path.suffix.lower() == ".zip"
    if stem == OPTIONAL and not (_is_zipped(path, name) if zipped else (path / name).exists()):
        return []
    text = _read_zip(path, name) if zipped else read_text(path / name, "timetable")
    reader = csv.DictReader(io.StringIO(text.removeprefix("\ufeff")), skipinitialspace=True)
    rows = []
    try:
        columns = [each.strip() for each in reader.fieldnames or ()]
        reader.fieldnames = columns
        for column in NEEDED[stem]:
            if column not in columns:
                raise InputError(f"{name} has no column {column}", file=path, allowed=", ".join(NEEDED[stem]))
        for row in reader:
            if None in row or any(row[column] is None for column in NEEDED[stem]):
                where = f"{name} line {reader.line_num}"
                raise InputError("wrong number of cells", file=path, field=where, allowed=f"{len(columns)}")
            rows.append({key: (value or "").strip() for key, value in row.items()})
    except csv.Error as error:
        raise InputError(f"not CSV ({error})", file=path, field=name, allowed="a GTFS table") from None
    return rows


def _is_zipped(path: Path, name: str) -> bool:
    with zipfile.ZipFile(path) as archive:
        return name in archive.namelist()


def _read_zip(path: Path, name: str) -> str:
    try:
        with zipfile.ZipFile(path) as archive, archive.open(name) as file:
            data = file.read(MAX_TEXT_BYTES + 1)
    except KeyError:
        raise InputError(f"has no {name}", file=path, field="timetable", allowed="a GTFS feed") from None
    except (OSError, EOFError, zlib.error, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        words = f"cannot be read ({reason})"
        raise InputError(words, file=path, field="timetable", allowed="a GTFS feed, zipped") from None
    if len(data) > MAX_TEXT_BYTES:
        raise InputError(f"{name} is too large", file=path, allowed=f"at most {MAX_TEXT_BYTES} bytes")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{name} is not UTF-8 text", file=path, field="timetable", allowed="UTF-8") from None
