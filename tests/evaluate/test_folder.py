"""The folder of a run: complete, atomic, and enough to drive again to the same bits."""

import json
import tomllib
from dataclasses import replace

import pytest

from metropilot._io import fill_folder
from metropilot.errors import InputError
from metropilot.evaluate import RunSpec, kpis_of, optimum_of, run_from_toml, write_run
from metropilot.railway import load_line, write_line
from metropilot.sim import drive

FILES = ["explanation.json", "kpis.json", "profile.png", "profile.svg", "run.toml", "trajectory.csv"]


def write(folder, request):
    driven = drive(request.run(), request.make_driver())
    optimum = optimum_of(driven)
    write_run(folder, request, driven, kpis_of(driven, optimum), optimum)


def test_driven_again_to_the_same_bits(tmp_path, request_rj):
    disturbed = {
        "speed_noise_mps": 0.05,
        "mass_factor": 1.1,
        "delay_s": 0.3,
        "seed": 7,
        "restrictions": ["500-700@45", "900-1000@50@20"],
        "arrivals": ["130@20"],
    }
    request = RunSpec.from_values(request_rj.values() | disturbed)
    write(tmp_path / "one", request)
    again = run_from_toml(tmp_path / "one" / "run.toml")
    write(tmp_path / "two", again)
    assert sorted(p.name for p in (tmp_path / "one").iterdir()) == FILES
    for name in set(FILES) - {"kpis.json", "run.toml"}:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name
    asked = [tomllib.loads((tmp_path / n / "run.toml").read_text())["run"] for n in ("one", "two")]
    assert asked[0] == asked[1]
    one, two = (json.loads((tmp_path / n / "kpis.json").read_text()) for n in ("one", "two"))
    del one["decision_time_us_median"], two["decision_time_us_median"]
    assert one == two


def test_a_line_of_ones_own_travels_with_the_folder(tmp_path, request_rj):
    write_line(load_line("yizhuang"), tmp_path / "mine.toml")
    write(tmp_path / "out", replace(request_rj, line=str(tmp_path / "mine.toml")))
    (tmp_path / "mine.toml").unlink()
    again = run_from_toml(tmp_path / "out" / "run.toml")
    assert again.line == str(tmp_path / "out" / "line.toml")
    assert again.run().section.length_m == 1280


def test_run_toml_says_what_made_it(tmp_path, request_rj):
    write(tmp_path, request_rj)
    table = tomllib.loads((tmp_path / "run.toml").read_text())
    assert table["run"]["line"] == "yizhuang"
    assert {"metropilot", "python", "numpy", "clarabel"} <= set(table["made_with"])


def test_an_earlier_result_survives_a_failure(tmp_path):
    (tmp_path / "kpis.json").write_text("earlier")
    with pytest.raises(InputError, match="Is a directory"), fill_folder(tmp_path) as scratch:  # noqa: PT012 (half-way)
        (scratch / "kpis.json").write_text("half")
        scratch.write_text("a folder is no file")
    assert (tmp_path / "kpis.json").read_text() == "earlier"
    assert [p.name for p in tmp_path.iterdir()] == ["kpis.json"]


def test_files_of_others_stay(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with fill_folder(tmp_path) as scratch:
        (scratch / "kpis.json").write_text("new")
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "kpis.json").read_text() == "new"


def test_a_file_where_the_folder_should_be(tmp_path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(InputError, match="cannot write"), fill_folder(tmp_path / "out"):
        pass
