"""`metropilot capacity`: table, JSON, folder, and one line for bad input."""

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
        "capacity.png",
        "capacity.svg",
    }
    back = typed("capacity", "yizhuang", "RC", "WYJ", "--trainset", "cheng2023", "--counts", "1")
    assert back.code == 0
    assert "trainsets/h" in back.out
    for bad in (("--counts", "two"), ("--platform", "20"), ("--dwell", "900"), ("--reserve", "-1")):
        refused = typed(*words, *bad)
        assert refused.code == 2
        assert refused.err.count("\n") == 1
    assert typed("capacity", "yizhuang", "WYJ").code == 2
