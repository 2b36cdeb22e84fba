"""`metropilot capacity`: table, JSON, folder, and one line for bad input."""

import csv
import json


def test_the_command_prints_writes_and_refuses(typed, tmp_path):
    words = ("capacity", "yizhuang", "WYJ", "RC", "--trainset", "cheng2023", "--counts", "1,2")
    said = typed(*words, "--platform", "120", "--out", "out", "--json")
    assert said.code == 0
    told = json.loads(said.out)
    written = json.loads((tmp_path / "out" / "capacity.json").read_text())
    assert told["rows"] == written["rows"]
    assert len(told["rows"]) == 8
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "capacity.json",
        "headways.csv",
        *(f"{stem}.{kind}" for stem in ("capacity", "moving_block") for kind in ("svg", "png")),
    }
    with (tmp_path / "out" / "headways.csv").open() as file:
        lines = list(csv.DictReader(file))
    block = next(row for row in told["rows"] if (row["count"], row["guard"]) == (2, "moving_block"))
    listed = [float(line["headway_s"]) for line in lines if (line["count"], line["platform_m"]) == ("2", "")]
    assert listed == [place["headway_s"] for place in block["places"]]
    assert max(listed) == block["headway_s"]
    assert [line["kind"] for line in lines[:3]] == ["section", "station", "section"]
    one = ("capacity", "yizhuang", "RC", "WYJ", "--trainset", "cheng2023", "--counts", "1")
    back = typed(*one, "--blocks", "2", "--places")
    assert back.code == 0
    assert "trainsets/h" in back.out
    assert back.out.count("binds") == 2
    fresh, late = (json.loads(typed(*one, "--age", age, "--json").out)["rows"][0] for age in ("0.36", "2.4"))
    assert abs(late["headway_s"] - fresh["headway_s"] - 2.04) < 1e-6
    for bad in (
        ("--counts", "two"),
        ("--platform", "20"),
        ("--dwell", "900"),
        ("--reserve", "-1"),
        ("--age", "-1"),
    ):
        refused = typed(*words, *bad)
        assert refused.code == 2
        assert refused.err.count("\n") == 1
    assert typed("capacity", "yizhuang", "WYJ").code == 2
