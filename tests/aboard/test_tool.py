"""`tools/aboard.py` writes the page from what it kept, and says at which commit each part was measured."""

import importlib.util
import json
from pathlib import Path

import pytest

PATH = Path(__file__).resolve().parents[2] / "tools" / "aboard.py"
BUILD = {
    "median_us": 50.0,
    "p999_us": 90.0,
    "worst_us": 700.0,
    "least_worst_us": 120.0,
    "beyond_wanted": 3,
    "least_beyond_wanted": 0,
    "real_time": True,
    "wall_p999_us": 100.0,
    "wall_worst_us": 4000.0,
    "object_bytes": 297781,
    "stack_bytes": 7800,
    "builds": {"clang": True, "gcc": False},
    "sanitized": True,
}
ANALYSIS = {
    "clang --analyze": {"version": "14.0.6", "seconds": 12.0, "said": []},
    "cppcheck": {"version": "2.10", "seconds": 300.0, "said": None},
    "another": {"version": "1", "seconds": 3.0, "said": ["nofile:0:0: information: of itself", "a.c:3: odd"]},
}


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("aboard_tool", PATH)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def keep(folder, name, values, commit="abc", load="0.5"):
    about = {"machine": "one", "date": "2026-11-25", "commit": commit, "versions": "jax 1", "load": load}
    (folder / f"{name}.json").write_text(json.dumps({"circumstances": about, "values": values}))


def test_the_page_says_what_was_measured_and_when(tool, tmp_path):
    keep(tmp_path, "build-generalist-dkz32@0.4,0.2-double", BUILD)
    keep(tmp_path, "analyse-pid-dkz32-double", ANALYSIS, load="2.5")
    text = tool.page(tmp_path)
    assert (
        "| `generalist` | dkz32@0.4,0.2 | double | 298 kB | 7.8 kB | 50 µs | 90 µs | 700 µs; 3 | 120 µs; 0 |"
        in text
    )
    assert "| clang | clean |" in text
    assert "| `pid`: clang --analyze, 14.0.6 | nothing in 12.0 s of processor time | nothing |" in text
    assert "| `pid`: cppcheck, 2.10 | no end in 300.0 s of processor time | nothing |" in text
    assert "| `pid`: another, 1 | 1 lines in 3.0 s of processor time | nothing |" in text
    assert "load: 0.5 to 2.5; date: 2026-11-25; commit: abc; versions: jax 1." in text
    assert "another commit" not in text
    assert "steps timed at a real-time priority" in text
    keep(tmp_path, "build-pid-dkz32-double", BUILD | {"real_time": False})
    assert "at a real-time priority" not in tool.page(tmp_path)


def test_the_page_names_parts_of_another_commit(tool, tmp_path):
    for name in ("build-pid-dkz32-double", "build-eitoe-dkz32-double"):
        keep(tmp_path, name, BUILD)
    keep(tmp_path, "analyse-pid-dkz32-double", ANALYSIS, commit="old+")
    text = tool.page(tmp_path)
    assert "commit: abc;" in text
    assert "**Parts of another commit**: old+: analyse-pid-dkz32-double." in text


def test_a_part_that_does_not_say_its_commit_is_refused(tool, tmp_path):
    with pytest.raises(SystemExit, match="nothing was measured"):
        tool.page(tmp_path)
    (tmp_path / "build-pid-dkz32-double.json").write_text(json.dumps(BUILD))
    with pytest.raises(SystemExit, match=r"build-pid-dkz32-double.json: does not say at which commit"):
        tool.page(tmp_path)


def test_the_stack_is_that_of_the_deepest_way(tool):
    report = "a.c:1:1:helper.constprop.0\t8\tstatic\na.c:2:1:decide\t900\tstatic\n"
    report += "a.c:3:1:pid_supervise\t400\tstatic\na.c:4:1:pid_step\t32\tstatic\n"
    assert tool.stack_bytes(report, "pid") == 940
