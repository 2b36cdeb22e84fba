"""Limits and stations that are dragged in the drawing of a line."""

import tomllib
from copy import deepcopy
from pathlib import Path

import pytest

from metropilot.railway import parse_document, toml_text
from metropilot.web.pages.handles import line_handles, move_handle

FILE = Path(__file__).parents[2] / "src/metropilot/railway/catalogue/lines/yizhuang.toml"


@pytest.fixture
def document():
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


def test_every_limit_and_station_has_handles(document):
    found = line_handles(document, 22728.0)
    kinds = [each["kind"] for each in found]
    assert (kinds.count("speed"), kinds.count("from"), kinds.count("station")) == (34, 33, 14)
    level = found[3]
    assert (level["kind"], level["row"], level["from_m"], level["to_m"]) == ("speed", 3, 1090.0, 2511.0)
    assert level["kmh"] == pytest.approx(80.0)
    begin = next(each for each in found if each["kind"] == "from" and each["row"] == 3)
    assert (begin["least_m"], begin["most_m"]) == (521.0, 2510.0)


@pytest.mark.parametrize(
    ("kind", "row", "value", "place"),
    [
        ("speed", 3, 65.0, ("speed_limits", "values", 3, 1)),
        ("from", 3, 1200.0, ("speed_limits", "values", 3, 0)),
        ("station", 3, 6300.0, ("stations", "list", 3, "position")),
    ],
)
def test_a_handle_moves_one_value_and_the_line_stays_valid(document, kind, row, value, place):
    before = deepcopy(document)
    move_handle(document, kind, row, value)
    block, table, at, column = place
    assert document[block][table][at][column] == value
    before[block][table][at][column] = value
    assert document == before
    assert parse_document(toml_text(document), None).stations


def test_the_document_keeps_its_units(document):
    document["speed_limits"]["units"] = {"from": "km", "speed": "m/s"}
    document["speed_limits"]["values"] = [[0.0, 10.0], [1.5, 20.0]]
    document["stations"] = {
        "unit": "km",
        "list": [{"code": "A", "name": "A", "position": 0}, {"code": "B", "name": "B", "position": 3}],
    }
    found = line_handles(document, 3000.0)
    assert [each["from_m"] for each in found] == [0.0, 1500.0, 1500.0, 0.0, 3000.0]
    move_handle(document, "speed", 1, 90.0)
    move_handle(document, "from", 1, 1250.0)
    move_handle(document, "station", 1, 2990.0)
    assert document["speed_limits"]["values"][1] == [1.25, 25]
    assert document["stations"]["list"][1]["position"] == 2.99


@pytest.mark.parametrize(("kind", "row"), [("speed", 99), ("station", -1), ("curve", 0)])
def test_what_is_not_there_is_passed_over(document, kind, row):
    before = deepcopy(document)
    move_handle(document, kind, row, 60.0)
    assert document == before
