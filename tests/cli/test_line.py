"""`metropilot line`: table, JSON, folder, and one line for bad input."""

import csv
import json
import re
import shlex
import shutil
import tomllib
from importlib import resources
from itertools import pairwise

import duckdb
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
TWO = """
kind = "line"
id = "two"
name = "Two stations"
stations.unit = "m"
stations.list = [{ code = "A", name = "Alpha", position = 0 }, { code = "B", name = "Beta", position = 1200 }]
speed_limits = { units = { from = "m", speed = "km/h" }, values = [[-200, 60]] }
gradients = { units = { from = "m", gradient = "permil" }, values = [[-200, 0]] }
"""


def test_the_command_prints_and_writes(typed, tmp_path):
    words = ("line", "yizhuang", "--headway", "300", "--zones", "4")
    fed = (*words, "--feeding", "yizhuang")
    said = typed(*fed, "--optimise", "--time-window", "0", "--out", "out", "--json")
    assert said.code == 0, said.err
    told = json.loads(said.out)
    assert set(told) >= FIELDS
    network = told["feeding"].pop("network")
    assert told["feeding"] == {"zones": 4, "transfer_loss": 0.1}
    assert network["id"] == "yizhuang"
    assert abs(network["balance"]) < 1e-9
    assert network["energy_kwh"] > told["energy_kwh"]
    assert sum(each["supplied_kwh"] for each in network["substations"]) == pytest.approx(
        network["energy_kwh"]
    )
    assert 500.0 < network["lowest_v"] < 850.0 < network["highest_v"] < 900.0
    assert told["floor_kwh"] <= told["energy_kwh"] < told["driving_only_kwh"] < told["cruise_kwh"]
    assert told["timetable_only_kwh"] < told["cruise_kwh"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "line.json",
        "timetable.csv",
        *(f"{stem}.{kind}" for stem in ("trains", "power", "voltage") for kind in ("svg", "png")),
    }
    written = json.loads((tmp_path / "out" / "line.json").read_text())
    assert written["feeding"].pop("network") == network
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
    # with dwells that may change more trains can meet
    assert before["all_received_floor_kwh"] == told["all_received_floor_kwh"] <= told["floor_kwh"]
    assert told["floor_kwh"] <= before["floor_kwh"] <= before["energy_kwh"]
    assert before["energy_kwh"] >= told["energy_kwh"]
    assert before["feeding"] == told["feeding"]
    said = typed(*fed)
    assert "cruise and brake" in said.out
    assert "peak of all substations" in " ".join(said.out.split())
    assert "--optimise" in said.out


def test_a_short_line_and_a_short_dwell_need_no_other_option(typed):
    said = typed("line", "lu2023", "--dwell", "5", "--json")
    assert said.code == 0, said.err
    told = json.loads(said.out)
    assert told["feeding"]["zones"] == 1
    # values that hold anyway, as `run.toml` has them
    usual = ("--dwell-window", "5", "--time-window", "4", "--seed", "0", "--reserve", "0.1")
    assert json.loads(typed("line", "lu2023", "--dwell", "5", *usual, "--json").out) == told
    assert typed("line", "lu2023", "--dwell-window", "0", "--time-window", "0").code == 0


def test_a_reserve_is_that_of_a_line_without_planned_times(typed, tmp_path):
    (tmp_path / "two.toml").write_text(TWO)
    found = [
        json.loads(typed("line", "two.toml", "--reserve", each, "--json").out) for each in ("0.1", "0.3")
    ]
    assert found[1]["energy_kwh"] < found[0]["energy_kwh"]
    said = typed("line", "two.toml", "--timetable", "x.zip", "--reserve", "0.3")
    assert said.code == 2
    assert "--reserve: the running times are given" in said.err


def feed_weakly(folder):
    """Write a line with a substation that gives what one train at a time draws; return the command."""
    text = (resources.files("metropilot.railway") / "catalogue/feedings/yizhuang.toml").read_text()
    text = re.sub(r"(?s)list = \[.*?\n\]", 'list = [{ name = "A", position = 0 }]', text, count=1)
    text = text.replace('line = "yizhuang"', 'line = "two"').replace("resistance = 10", "resistance = 20")
    (folder / "mine.toml").write_text(text)
    (folder / "two.toml").write_text(TWO)
    return ("line", "two.toml", "--feeding", "mine.toml", "--headway", "110")


def test_a_dash_is_a_load_that_the_network_cannot_carry(typed, tmp_path):
    fed = feed_weakly(tmp_path)
    told = json.loads(typed(*fed, "--json").out)["feeding"]["network"]
    assert told["driving_only_kwh"] is None
    said = " ".join(typed(*fed).out.split())
    assert "optimal driving – and" in said
    assert "–: the network cannot carry that load." in said


def test_an_hour_that_the_network_cannot_carry_leaves_the_result_without_disturbance(typed, tmp_path):
    fed = feed_weakly(tmp_path)
    plain = json.loads(typed(*fed, "--json").out)
    said = typed(*fed, "--scatter", "30", "--driver", "eitoe", "--out", "out", "--json")
    assert said.code == 0, said.err
    told = json.loads(said.out)
    assert told["scattered"] == [{"seconds": 30.0, "energy_kwh": None, "deviation_kwh": None}]
    assert told["driver"]["plain_kwh"] > plain["driving_only_kwh"]
    assert told["driver"]["mean_late_s"] < 5.0
    assert json.loads((tmp_path / "out" / "line.json").read_text())["scattered"] == told["scattered"]
    assert told | {"scattered": [], "driver": None} == plain
    said = " ".join(typed(*fed, "--scatter", "30").out.split())
    assert "scatter by 30 s: – kWh with optimal driving, standard deviation –." in said
    assert "–: the network cannot carry the load of that hour." in said


def test_a_day_of_one_journey_is_written(typed, tmp_path):
    (tmp_path / "two.toml").write_text(TWO)
    (tmp_path / "day.toml").write_text(
        'kind = "day"\nid = "one"\nname = "One journey"\nline = "two"\n[periods]\nunits = { headway = "s" }\n'
        'list = [{ name = "only", from = "08:00", to = "08:01", headway = 600 }]\n'
    )
    said = typed("line", "two.toml", "--day", "day.toml", "--out", "out", "--json")
    assert said.code == 0, said.err
    assert json.loads(said.out)["journeys"] == {"forward": 1, "backward": 0}
    with (tmp_path / "out" / "timetable.csv").open() as file:
        assert [row["departure"] for row in csv.DictReader(file)] == ["08:00:00"]


def test_the_text_says_which_timetable_takes_what_on_the_network(typed):
    words = ("line", "yizhuang", "--headway", "600", "--dwell-window", "0", "--time-window", "0")
    fed = (*words, "--feeding", "yizhuang", "--optimise")
    told = json.loads(typed(*fed, "--json").out)["feeding"]["network"]
    said = " ".join(typed(*fed).out.split())
    assert f"optimal driving {told['driving_only_kwh']:.1f} and {told['zones_timetable_kwh']:.1f}." in said
    assert f"{told['energy_kwh']:.1f} kWh with the timetable sought on the network" in said
    assert told["energy_kwh"] < told["zones_timetable_kwh"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("yizhuang", "--zones", "0"), "--zones"),
        (("yizhuang", "--zones", "14"), "one for each section"),
        (("yizhuang", "--headway", "30"), "trains disturb one another at station"),
        (("yizhuang", "--dwell", "5", "--dwell-window", "6"), "--dwell-window"),
        (("yizhuang", "--sharp"), "where each section is a zone"),
        (("nowhere",), "nowhere"),
        (("yizhuang", "--trainset", "none"), "none"),
        (("yizhuang", "--feeding", "none"), "unknown feeding"),
        (("yizhuang", "--scatter", "nan"), "--scatter: out of range: 'nan' (allowed: 0 to 300)"),
        (
            ("yizhuang", "--driver", "eitoe", "--runs", "101"),
            "--runs: out of range: '101' (allowed: 1 to 100)",
        ),
        (("yizhuang", "--day", "none"), "--day: unknown day"),
        (
            ("lu2023", "--zones", "1", "--day", "yizhuang"),
            "a day of another line: 'yizhuang' (allowed: lu2023)",
        ),
        (
            ("yizhuang", "--day", "yizhuang", "--timetable", "x.zip"),
            "--timetable: a day and a timetable at once",
        ),
        (("yizhuang", "--timetable", "x.zip"), "x.zip: timetable: cannot be read"),
        (("yizhuang", "--day", "yizhuang", "--headway", "90"), "--headway: a day has its own headways"),
        (("yizhuang", "--timetable", "x.zip", "--dwell", "40"), "--dwell: a timetable that is given has its"),
        (("yizhuang", "--timetable", "x.zip", "--dwell-window", "5"), "--dwell-window: a timetable that is"),
        (("yizhuang", "--timetable", "x.zip", "--time-window", "2"), "--time-window: a timetable that is"),
        (("yizhuang", "--timetable", "x.zip", "--optimise"), "--optimise: a timetable that is given"),
        (("yizhuang", "--day", "yizhuang", "--driver", "nobody"), "--driver: unknown driver"),
        (("yizhuang", "--driver", "nobody"), "--driver: unknown driver"),
        (("yizhuang", "--scatter", "-1"), "--scatter"),
        (("yizhuang", "--service", "x"), "--service: needs a timetable"),
        (
            ("yizhuang", "--day", "yizhuang", "--turnround", "1500"),
            "trains.fleet: the timetable needs more trains: 23",
        ),
        (("lu2023", "--zones", "1", "--feeding", "yizhuang"), "a feeding of another line: 'yizhuang'"),
        (
            ("yizhuang", "--time-window", "9"),
            "--time-window: needs a search of dwells and running times: 9 s",
        ),
        (
            ("yizhuang", "--dwell-window", "9"),
            "--dwell-window: needs a search of dwells and running times: 9 s",
        ),
        (("yizhuang", "--day", "yizhuang", "--time-window", "9"), "--time-window: needs a search"),
        (("yizhuang", "--seed", "7"), "--seed: nothing is drawn at random: 7 (allowed: --optimise, "),
        (("yizhuang", "--timetable", "x.zip", "--seed", "7"), "--seed: nothing is drawn at random"),
        (("yizhuang", "--reserve", "0.3"), "--reserve: the running times are given: 0.3 (allowed: a line "),
        (("yizhuang", "--reserve", "0", "--optimise"), "--reserve: the running times are given: 0.0"),
    ],
)
def test_bad_input_is_one_line(typed, words, told):
    said = typed("line", *words)
    assert said.code == 2
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert told in said.err


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("position = 22728", "position = 22729", "substations[10].position"),
        ("resistance = 10", "resistance = -10", "substations.resistance: out of range: -10 mohm"),
        ("resistance = 10", "resistance = 900", "the network cannot carry the load: "),
    ],
)
def test_a_bad_feeding_is_one_line(typed, tmp_path, old, new, told):
    text = (resources.files("metropilot.railway") / "catalogue/feedings/yizhuang.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace(old, new))
    said = typed("line", "yizhuang", "--feeding", "mine.toml")
    assert said.code == 2
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert told in said.err


def test_a_feeding_is_shown_and_not_imported(typed, tmp_path):
    text = (resources.files("metropilot.railway") / "catalogue/feedings/yizhuang.toml").read_text()
    (tmp_path / "mine.toml").write_text(text)
    said = typed("show", "mine.toml")
    assert said.code == 0
    assert "trains draw 6000 A" in " ".join(said.out.split())
    told = json.loads(typed("show", "mine.toml", "--json").out)
    assert told["kind"] == "feeding"
    assert told["substations"][1]["position_m"] == 2631.0
    said = typed("import", "mine.toml", "--out", "other.toml")
    assert said.code == 2
    assert said.err.count("\n") == 1
    assert not (tmp_path / "other.toml").exists()


def test_a_day_is_printed_written_and_computed_again(typed, tmp_path):
    text = (resources.files("metropilot.railway") / "catalogue/days/yizhuang.toml").read_text()
    (tmp_path / "mine.toml").write_text(text)
    words = ("line", "yizhuang", "--day", "mine.toml", "--feeding", "yizhuang", "--load", "AW2")
    said = typed(*words, "--out", "out", "--json")
    assert said.code == 0, said.err
    told = json.loads(said.out)
    assert told["journeys"] == {"forward": 162, "backward": 162}
    assert told["floor_kwh"] < told["energy_kwh"] < told["driving_only_kwh"] < told["cruise_kwh"]
    assert told["feeding"]["network"]["energy_kwh"] > told["energy_kwh"]
    assert abs(told["feeding"]["network"]["balance"]) < 1e-9
    out = tmp_path / "out"
    assert {path.name for path in out.iterdir()} == {
        *("day.json", "day.toml", "run.toml", "timetable.csv", "timetable.parquet", "gtfs.zip"),
        *(f"{stem}.{kind}" for stem in ("trains", "power", "voltage") for kind in ("svg", "png")),
    }
    with (out / "timetable.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 324 * 13
    stored = duckdb.sql(f"SELECT * FROM '{out}/timetable.parquet'").fetchall()
    assert [tuple(map(str, row)) for row in stored] == [tuple(row.values()) for row in rows]
    assert len({row["train"] for row in rows}) == told["fleet"] <= 23
    command, *_ = (out / "run.toml").read_text().splitlines()
    run = tomllib.loads((out / "run.toml").read_text())["line"]
    assert run["day"] == "day.toml"
    for name in ("day.toml", "gtfs.zip"):
        shutil.copy(out / name, tmp_path)
    again = typed(*shlex.split(command.partition(": metropilot ")[2]), "--json")
    assert json.loads(again.out) == told
    given = json.loads(typed("line", "yizhuang", "--timetable", "gtfs.zip", "--load", "AW2", "--json").out)
    assert given["journeys"] == told["journeys"]
    assert given["floor_kwh"] == pytest.approx(told["floor_kwh"], rel=1e-9)
    assert given["fleet"] == told["fleet"]
    assert told["energy_kwh"] <= given["energy_kwh"] < told["driving_only_kwh"]


def test_a_day_is_shown_and_not_imported(typed, tmp_path):
    text = (resources.files("metropilot.railway") / "catalogue/days/yizhuang.toml").read_text()
    (tmp_path / "mine.toml").write_text(text)
    assert "morning peak" in typed("show", "mine.toml").out
    assert json.loads(typed("show", "mine.toml", "--json").out)["periods"][1]["headway_s"] == 240
    said = typed("import", "mine.toml", "--out", "other.toml")
    assert (said.code, said.err.count("\n")) == (2, 1)
