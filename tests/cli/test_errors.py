"""Bad input: exit code 2, one line that says what and what is allowed, never a traceback."""

import json
import os

import pytest

from metropilot.cli import app

RUN = ("drive", "yizhuang", "RJ", "WYJ", "--driver", "flat_out")
BAD = [
    (("drive", "yizhuang", "RJ", "XYZ"), "SJZ (Songjiazhuang), XC"),
    (("drive", "yizhuang", "RJ", "RJ"), "same station"),
    (("drive", "yizhuang", "Yizhuang", "RJ"), "YZQ"),
    (("drive", "yizhuang", "RJ"), "destination: missing"),
    (("drive",), "line: missing"),
    (("drive", "yizhung", "RJ", "WYJ"), "yizhuang"),
    (("drive", "nowhere.toml", "RJ", "WYJ"), "nowhere.toml"),
    ((*RUN, "--time", "nan"), "time"),
    ((*RUN, "--time", "-5"), "time"),
    ((*RUN, "--time", "abc"), "valid number"),
    ((*RUN, "--time", "10"), "minimum running time is"),
    ((*RUN, "--trainset", "dkz23"), "dkz32"),
    ((*RUN, "--load", "AW9"), "AW0, AW2, AW3"),
    ((*RUN[:-1], "flat-out"), "did you mean flat_out"),
    ((*RUN, "--set", "colour"), "NAME=VALUE"),
    ((*RUN, "--set", "colour=red"), "takes no options"),
    ((*RUN, "--mass-factor", "inf"), "0.5 to 2"),
    ((*RUN, "--dt", "0"), "0.01 to 1"),
    ((*RUN, "--restriction", "here"), "FROM-TO@KMH"),
    ((*RUN, "--restriction", "400-600@0.0001"), "5 to 400 km/h"),
    ((*RUN, "--restriction", "400-600@500"), "5 to 400 km/h"),
    ((*RUN, "--arrive", "90"), "S@T"),
    ((*RUN, "--seed", "-1"), "seed"),
    ((*RUN, "--from", "run.toml"), "at once"),
    (("drive", "--from", "nowhere/run.toml"), "cannot be read"),
    ((*RUN, "--nonsense"), "No such option"),
    (("drvie",), "Did you mean 'drive'"),
    (("compare", "yizhuang", "RJ", "WYJ", "--drivers", ","), "no driver given"),
    (("compare", "yizhuang", "RJ", "WYJ", "--drivers", "flat_out,fast"), "unknown driver"),
    (("compare", "yizhuang", "RJ", "WYJ", "--seeds", "0"), "seeds"),
    (("plan", "yizhuang", "RJ"), "both stations"),
    (("plan", "yizhuang", "RJ", "WYJ", "--time", "10"), "minimum running time is"),
    (("plan", "yizhuang", "RJ", "WYJ", "--jerk", "-1"), "jerk"),
    (("plan", "yizhuang", "--front"), "one section"),
    (("plan", "yizhuang", "--journey", "nowhere.toml"), "nowhere.toml"),
    (("show", "dkz"), "dkz32"),
    (("import", "nowhere.json"), "nowhere.json"),
]


@pytest.mark.parametrize(("arguments", "words"), BAD, ids=[" ".join(a) for a, _ in BAD])
def test_bad_input_is_one_line(metropilot, arguments, words):
    said = metropilot(*arguments)
    assert said.code == 2, said
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert said.err.startswith("metropilot: ")
    assert words in said.err


def test_the_same_as_json(metropilot):
    said = metropilot(*RUN, "--time", "10", "--json")
    error = json.loads(said.out)["error"]
    assert set(error) == {"message", "file", "field", "value", "unit", "allowed"}
    assert (error["field"], error["value"], error["unit"]) == ("time", 10.0, "s")
    assert said.code == 2


def test_usage_errors_as_json(metropilot):
    said = metropilot("drive", "--nonsense", "--json")
    assert "No such option" in json.loads(said.out)["error"]["message"]


def test_as_a_program(program):
    said = program(*RUN, "--time", "10")
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert "minimum running time is" in said.err


def test_objective_as_a_program(program):
    said = program(*RUN, "--objective", "cheap")
    assert said.code == 2
    assert "wheel, line" in said.err


def test_an_unwritable_folder(program, tmp_path):
    (tmp_path / "out").write_text("a file")
    said = program(*RUN, "--out", "out")
    assert said.code == 2
    assert said.err.count("\n") == 1
    assert "cannot write" in said.err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(program, tmp_path):
    (tmp_path / "out").mkdir(mode=0o500)
    assert program(*RUN, "--out", "out").code == 2


def test_the_unexpected_is_one_line_too(metropilot, monkeypatch):
    def broken(arguments):
        raise RuntimeError(f"broken\nby {arguments[0]}")

    monkeypatch.setattr(app, "_run", broken)
    said = metropilot("lines")
    assert said.code == 1
    assert (
        said.err
        == "metropilot: internal error: RuntimeError: broken by lines (METROPILOT_DEBUG=1 shows where)\n"
    )
    monkeypatch.setenv("METROPILOT_DEBUG", "1")
    with pytest.raises(RuntimeError):
        app.main(["lines"])


def test_interrupted(metropilot, monkeypatch):
    def stopped(arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "_run", stopped)
    assert metropilot("lines") == (130, "", "metropilot: interrupted\n")


def test_a_closed_pipe_is_no_error(program):
    done = program("show", "yizhuang", "--json")
    assert done.code == 0
