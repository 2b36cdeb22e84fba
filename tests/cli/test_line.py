"""`metropilot line`: table, JSON, folder, and one line for bad input."""

import csv
import json
from itertools import pairwise

import pytest

FIELDS = {
    "headway_s",
    "floor_kwh",
    "energy_kwh",
    "gap_percent",
    "cruise_kwh",
    "driving_only_kwh",
    "timetable_only_kwh",
    "feeding",
}


def test_the_command_prints_and_writes(typed, tmp_path):
    words = ("line", "yizhuang", "--headway", "300", "--zones", "4")
    said = typed(*words, "--optimise", "--time-window", "0", "--out", "out", "--json")
    assert said.code == 0, said.err
    told = json.loads(said.out)
    assert set(told) >= FIELDS
    assert told["feeding"] == {"zones": 4, "transfer_loss": 0.1}
    assert told["floor_kwh"] <= told["energy_kwh"] < told["driving_only_kwh"] < told["cruise_kwh"]
    assert told["timetable_only_kwh"] < told["cruise_kwh"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "line.json",
        "timetable.csv",
        *(f"{stem}.{kind}" for stem in ("trains", "power") for kind in ("svg", "png")),
    }
    written = json.loads((tmp_path / "out" / "line.json").read_text())
    assert {name: written[name] for name in told} == told
    with (tmp_path / "out" / "timetable.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 26
    for row, after in pairwise(rows[:13]):
        assert row["destination"] == after["origin"]
        assert int(row["arrival_s"]) == int(row["departure_s"]) + int(row["running_time_s"])
        assert int(after["departure_s"]) == int(row["arrival_s"]) + int(row["dwell_s"])
        assert 20 <= int(row["dwell_s"]) <= 40
    plain = typed(*words, "--time-window", "0", "--json")
    before = json.loads(plain.out)
    assert before["floor_kwh"] == told["floor_kwh"]
    assert before["energy_kwh"] >= told["energy_kwh"]
    said = typed(*words)
    assert "cruise and brake" in said.out
    assert "--optimise" in said.out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("yizhuang", "--zones", "0"), "--zones"),
        (("yizhuang", "--zones", "14"), "one for each section"),
        (("yizhuang", "--headway", "30"), "cannot follow each other"),
        (("yizhuang", "--dwell", "5"), "--dwell-window"),
        (("nowhere",), "nowhere"),
        (("yizhuang", "--trainset", "none"), "none"),
    ],
)
def test_bad_input_is_one_line(typed, words, told):
    said = typed("line", *words)
    assert said.code == 2
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert told in said.err
