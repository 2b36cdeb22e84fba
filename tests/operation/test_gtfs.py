"""Timetables of a day as GTFS: written, read again without a change, and one line for a bad feed."""

import csv
import io
import zipfile
from itertools import pairwise

import numpy as np
import pytest
from tests.operation.test_day import operation, part

from metropilot.errors import InputError
from metropilot.operation import DayTimetable, link_trains, read_gtfs, repeat_timetables, write_gtfs
from metropilot.railway import load_line

LINE = operation().line


def late_day():
    """Trains that run past midnight."""
    return repeat_timetables([part(84000, 86000), part(86000, 88000, 250, 61.0)])


def write(path, timetable=None):
    timetable = timetable or late_day()
    write_gtfs(path, LINE, timetable, link_trains(timetable, 120, 900), "late")
    return timetable


def same(one: DayTimetable, two: DayTimetable):
    """True if departures and running times are the same."""
    return all(
        np.array_equal(a.departure_s, b.departure_s) and np.array_equal(a.running_time_s, b.running_time_s)
        for a, b in zip(one, two, strict=True)
    )


@pytest.mark.parametrize("name", ["feed", "feed.zip"])
def test_a_timetable_reads_back_as_it_was(tmp_path, name):
    timetable = write(tmp_path / name)
    found = read_gtfs(tmp_path / name, LINE)
    assert same(found, timetable)
    again = "again" + name.removeprefix("feed")
    write(tmp_path / again, found)
    if name.endswith("zip"):
        assert (tmp_path / again).read_bytes() == (tmp_path / name).read_bytes()


def rows_of(folder, table):
    with (folder / f"{table}.txt").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_feed_has_what_the_specification_requires(tmp_path):
    timetable = write(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{each}.txt" for each in ("agency", "routes", "stops", "calendar", "trips", "stop_times")
    }
    (agency,), (route,) = rows_of(tmp_path, "agency"), rows_of(tmp_path, "routes")
    assert all(agency[key] for key in ("agency_id", "agency_name", "agency_url", "agency_timezone"))
    assert (route["route_type"], route["agency_id"]) == ("1", agency["agency_id"])
    (calendar,) = rows_of(tmp_path, "calendar")
    assert calendar["start_date"] <= calendar["end_date"]
    stops, trips, times = (rows_of(tmp_path, each) for each in ("stops", "trips", "stop_times"))
    ids = {row["stop_id"] for row in stops}
    assert len(ids) == len(stops) == 4
    for before, after, station in zip(stops, stops[1:], LINE.stations[1:], strict=False):
        metres = 111_195.0 * (float(after["stop_lat"]) - float(before["stop_lat"]))
        index = LINE.stations.index(station)
        assert metres == pytest.approx(station.position_m - LINE.stations[index - 1].position_m, abs=0.1)
    assert len({row["trip_id"] for row in trips}) == len(trips) == timetable.journeys
    assert {row["route_id"] for row in trips} == {route["route_id"]}
    assert {row["service_id"] for row in trips} == {calendar["service_id"]}
    assert {row["stop_id"] for row in times} == ids
    assert any(row["arrival_time"] > "24:00:00" for row in times)
    # the trips of a block do not overlap
    spans: dict[str, list[tuple[str, str]]] = {}
    for trip in trips:
        own = [row for row in times if row["trip_id"] == trip["trip_id"]]
        assert [int(row["stop_sequence"]) for row in own] == [1, 2, 3, 4]
        assert own[0]["arrival_time"] == own[0]["departure_time"]
        assert own[-1]["arrival_time"] == own[-1]["departure_time"]
        spans.setdefault(trip["block_id"], []).append((own[0]["departure_time"], own[-1]["arrival_time"]))
    for each in spans.values():
        each.sort()
        assert all(a[1] < b[0] for a, b in pairwise(each))


def edit(folder, table, change):
    """Write a table again, its rows changed."""
    rows = change(rows_of(folder, table))
    with (folder / f"{table}.txt").open("w", encoding="utf-8-sig", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def test_a_feed_of_somebody_else_is_read(tmp_path):
    timetable = write(tmp_path)
    own = {each.code: each for each in LINE.stations}

    def platforms(rows):
        parents = [
            {**row, "stop_id": f"P{k}", "stop_name": own[row["stop_id"]].name.upper(), "parent_station": ""}
            for k, row in enumerate(rows)
        ]
        children = [
            {**row, "stop_id": f"1-{row['stop_id']}", "stop_name": "platform", "parent_station": f"P{k}"}
            for k, row in enumerate(rows)
        ]
        other = {**rows[0], "stop_id": "X", "stop_name": "elsewhere", "parent_station": ""}
        return [*children, *parents, other]

    def elsewhere(rows):
        strangers = [
            {**rows[0], "trip_id": "bus", "stop_id": stop, "stop_sequence": k}
            for k, stop in enumerate(("X", "1-XC"))
        ]
        # rows in any order
        return [*({**row, "stop_id": f"1-{row['stop_id']}"} for row in rows[::-1]), *strangers]

    edit(tmp_path, "stops", platforms)
    edit(tmp_path, "stop_times", elsewhere)
    edit(tmp_path, "trips", lambda rows: [*rows, {**rows[0], "trip_id": "bus", "service_id": "sunday"}])
    assert same(read_gtfs(tmp_path, LINE), timetable)


def test_one_of_several_services_is_read(tmp_path):
    timetable = write(tmp_path)
    half = timetable.forward.period.size // 2
    sunday = {f"F{k + 1:04d}" for k in range(half)} | {"B0001"}

    def split(rows):
        return [{**row, "service_id": "sunday" if row["trip_id"] in sunday else "work"} for row in rows]

    edit(tmp_path, "trips", split)
    found = read_gtfs(tmp_path, LINE, "sunday")
    assert [each.period.size for each in found] == [half, 1]
    with pytest.raises(InputError, match=r"service: several services \(allowed: sunday, work\)"):
        read_gtfs(tmp_path, LINE)
    with pytest.raises(InputError, match=r"service: unknown service: 'monday' \(allowed: sunday, work\)"):
        read_gtfs(tmp_path, LINE, "monday")


@pytest.mark.parametrize("name", ["feed", "feed.zip"])
def test_a_trip_with_a_headway_departs_again_and_again(tmp_path, name):
    timetable = write(tmp_path / "feed")
    (tmp_path / "feed" / "frequencies.txt").write_text(
        "trip_id,start_time,end_time,headway_secs,exact_times\r\n"
        "F0002,06:00:00,06:15:00,300,0\r\nF0002,06:15:00,06:40:01,500,1\r\n"
    )
    if name.endswith("zip"):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            for path in (tmp_path / "feed").iterdir():
                archive.write(path, path.name)
    found = read_gtfs(tmp_path / name, LINE)
    starts_s = [21600 + each for each in (0, 300, 600, 900, 1400, 1900, 2400)]
    assert found.forward.departure_s[:7, 0].tolist() == starts_s
    rest_s = np.delete(timetable.forward.departure_s[:, 0], 1)
    assert found.forward.departure_s[7:, 0].tolist() == rest_s.tolist(), "in place of its own departure"
    steps_s = np.diff(timetable.forward.departure_s[1])
    assert (np.diff(found.forward.departure_s[:7], axis=1) == steps_s).all()
    np.testing.assert_array_equal(found.backward.departure_s, timetable.backward.departure_s)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("F0001,06:00:00,07:00:00,0", "line 2, headway_secs: not a headway: '0'"),
        ("F0001,06:00:00,07:00:00,x", "line 2, headway_secs: not a headway: 'x'"),
        ("F0001,7 h,07:00:00,60", "line 2, start_time: not a time: '7 h'"),
        ("F0001,07:00:00,06:00:00,60", "line 2, end_time: not after the start: '06:00:00'"),
        ("F001,06:00:00,07:00:00,60", "line 2, trip_id: unknown trip: 'F001'"),
    ],
)
def test_a_bad_frequency_gets_one_line(tmp_path, row, words):
    write(tmp_path)
    text = f"trip_id,start_time,end_time,headway_secs\r\n{row}\r\n"
    (tmp_path / "frequencies.txt").write_text(text)
    with pytest.raises(InputError, match=f"frequencies.txt {words}"):
        read_gtfs(tmp_path, LINE)


def replace_row(row, **values):
    def change(rows):
        rows[row] |= values
        return rows

    return change


@pytest.mark.parametrize(
    ("table", "change", "words"),
    [
        (
            "stop_times",
            replace_row(1, arrival_time="7h"),
            "stop_times.txt line 3, arrival_time: not a time: '7h'",
        ),
        ("stop_times", replace_row(1, arrival_time=""), "stop_times.txt line 3, arrival_time: not a time"),
        ("stop_times", replace_row(1, departure_time="00:00:00"), "departure_time: before the arrival"),
        ("stop_times", replace_row(1, arrival_time="01:00:00"), "trip F0001, XC, arrival_time: too early"),
        ("stop_times", replace_row(0, trip_id="none"), "unknown trip: 'none'"),
        ("stop_times", replace_row(0, stop_sequence="one"), "stop_sequence: not a number: 'one'"),
        (
            "stop_times",
            replace_row(1, stop_sequence="1"),
            "trip F0001, XC, stop_sequence: used twice: '1'",
        ),
        (
            "stop_times",
            replace_row(0, stop_id="nowhere"),
            "trip F0001, stop_id: stop off the line: 'nowhere'",
        ),
        (
            "stop_times",
            lambda rows: rows[1:],
            "trip F0001, stop_id: does not serve the whole line in order: 'SJZ'",
        ),
        ("stop_times", lambda rows: [r for r in rows if r["trip_id"] < "F"], "no trip forward"),
        (
            "trips",
            lambda rows: [{"trip_id": row["trip_id"]} for row in rows],
            "trips.txt has no column service_id",
        ),
    ],
)
def test_a_bad_feed_gets_one_line(tmp_path, table, change, words):
    write(tmp_path)
    edit(tmp_path, table, change)
    with pytest.raises(InputError) as error:
        read_gtfs(tmp_path, LINE)
    line = error.value.line()
    assert words in line
    assert str(tmp_path) in line
    assert "(allowed: " in line
    assert "\n" not in line


def test_a_damaged_table_gets_one_line_or_is_read(tmp_path):
    write(tmp_path)
    random = np.random.default_rng(1)
    whole = {name: (tmp_path / name).read_bytes() for name in ("stops.txt", "trips.txt", "stop_times.txt")}
    outcomes = set()
    (tmp_path / "trips.txt").write_bytes(b"trip_id,service\rid\r\nx,y\r\n")
    with pytest.raises(InputError, match=r"trips\.txt: not CSV"):
        read_gtfs(tmp_path, LINE)
    for _ in range(150):
        name = str(random.choice(list(whole)))
        data = bytearray(whole[name])
        at = int(random.integers(len(data)))
        if random.random() < 0.5:
            data[at] = int(random.integers(256))
        else:
            del data[at : at + int(random.integers(1, 40))]
        for each, text in whole.items():
            (tmp_path / each).write_bytes(bytes(data) if each == name else text)
        try:
            read_gtfs(tmp_path, LINE)
            outcomes.add("read")
        except InputError as error:
            outcomes.add("refused on one line" if "\n" not in error.line() else error.line())
    assert outcomes == {"read", "refused on one line"}


def test_a_file_that_is_no_feed_gets_one_line(tmp_path):
    path = tmp_path / "feed.zip"
    with pytest.raises(InputError, match="cannot be read"):
        read_gtfs(path, LINE)
    path.write_bytes(b"no zip")
    with pytest.raises(InputError, match=r"cannot be read \(File is not a zip file\)"):
        read_gtfs(path, LINE)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("stops.txt", "stop_id\r\nA\r\n")
    path.write_bytes(buffer.getvalue())
    with pytest.raises(InputError, match=r"has no trips\.txt"):
        read_gtfs(path, LINE)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("stops.txt", b"stop_id\r\n\xff\r\n")
    with pytest.raises(InputError, match=r"stops\.txt is not UTF-8"):
        read_gtfs(path, LINE)
    write(path)
    broken = bytearray(path.read_bytes())
    broken[len(broken) * 3 // 4] ^= 0xFF
    path.write_bytes(bytes(broken))
    with pytest.raises(InputError):
        read_gtfs(path, LINE)
    with pytest.raises(InputError, match="cannot be read"):
        read_gtfs(tmp_path / "nowhere", LINE)


def test_a_feed_of_another_line_has_no_trips_of_this_one(tmp_path):
    write(tmp_path)
    with pytest.raises(InputError, match="no trip forward on lu2023"):
        read_gtfs(tmp_path, load_line("lu2023"))
