"""Bad input: exit code 2, one line that says what and what is allowed, never a traceback."""

import gc
import inspect
import json
import os
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import get_args

import pytest
from tests.railway import samples

from metropilot.cli import app, catalogue

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
    ((*RUN, "--time", "abc"), "--time: not a number: 'abc' (allowed: a number without its unit, e.g. 1.5)"),
    ((*RUN, "--time", "101s"), "--time: not a number: '101s'"),
    ((*RUN, "--seed", "1.5"), "--seed: not a whole number: '1.5'"),
    (("line", "yizhuang", "--scatter", "500"), "--scatter: out of range: '500' (allowed: 0 to 300)"),
    (
        ("line", "yizhuang", "--headway", "9" * 400),
        f"--headway: out of range: {'9' * 150} ... {'9' * 40} s (all",
    ),
    (("runs", "--most", "0"), "--most: out of range: '0' (allowed: >= 1)"),
    ((*RUN, "--trainset", "dkz32:"), "--trainset: unknown load: 'dkz32:' (allowed: AW0, AW2, AW3)"),
    (("compare", "yizhuang", "RJ", "WYJ", "--drivers", "pid:tuned"), "--drivers: not an option of a driver"),
    (
        ("compare", "yizhuang", "RJ", "WYJ", "--drivers", "learned"),
        "--set policy=PATH or learned:policy=PATH",
    ),
    (("reproduce", "chen2023a", "--reference", "optimal"), "--reference: the study has none: 'optimal'"),
    (("show", "nowhere.toml"), "nowhere.toml: cannot be read (No such file or directory)"),
    (("show", "."), ".: no run in the folder (allowed: the folder of a run"),
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
    ((*RUN, "--trainset", "dkz32:AW2", "--load", "AW3"), "--load: the load is given twice"),
    ((*RUN, "--trainset", "dkz32@nan,0"), "--trainset: not a dead time and a lag"),
    (
        ("drive", "--from", "run.toml", "--out", "a", "--time", "9", "--set", "a=1"),
        "file, without --time, --set:",
    ),
    (
        ("convoy", "--from", "run.json", "--link-loss", "0.1"),
        "the run is that of the file, without --link-loss",
    ),
    (("drive", "--from", "nowhere/run.toml"), "cannot be read"),
    (("convoy", "--from", "nowhere/run.json"), "cannot be read"),
    (("convoy", "yizhuang", "--from", "run.json"), "at once"),
    (("convoy", "yizhuang", "RJ"), "LINE ORIGIN DESTINATION, or --from RUN.JSON"),
    ((*RUN, "--nonsense"), "No such option"),
    (("drvie",), "Did you mean 'drive'"),
    (("compare", "yizhuang", "RJ", "WYJ", "--drivers", ","), "no driver given"),
    (("compare", "yizhuang", "RJ", "WYJ", "--drivers", "flat_out,fast"), "unknown driver"),
    (("compare", "yizhuang", "RJ", "WYJ", "--seeds", "0"), "seeds"),
    (("compare", "yizhuang", "RJ", "WYJ", "--drivers", "fast"), "--drivers: unknown driver"),
    (("compare", "yizhuang", "RJ", "WYJ", "--drivers", "pid:kp=nan"), "--drivers kp: out of range"),
    (("compare", "yizhuang", "RJ", "WYJ", "--drivers", "pid:fast=1"), "--drivers: unknown option of pid"),
    (("convoy", "yizhuang", "RJ", "WYJ", "--mass-factor", "1", "--mass-factors", "1,1.1"), "--mass-factor: "),
    (("line", "yizhuang", "--runs", "3"), "--runs: needs a driver: 3 (allowed: --driver ID)"),
    (("runs", "--folder", "nowhere"), "--folder: no runs in it: 'nowhere'"),
    (("export", "ppoo"), "no such driver or run, did you mean ppo?: 'ppoo' (allowed: "),
    ((*RUN, "--out", ""), "--out: empty: ''"),
    ((*RUN, "--out="), "--out: empty: ''"),
    (("plan", "yizhuang", "RJ"), "both stations"),
    (("plan", "yizhuang", "RJ", "WYJ", "--time", "10"), "minimum running time is"),
    (("plan", "yizhuang", "RJ", "WYJ", "--jerk", "-1"), "jerk"),
    (("plan", "yizhuang", "--front"), "one section"),
    (("plan", "yizhuang", "RJ", "WYJ", "--front", "--time", "101"), "--time: no time beside --front"),
    (("plan", "yizhuang", "--journey", "a.toml", "--time", "9"), "--time: no time beside --journey"),
    (("plan", "yizhuang", "RJ", "WYJ", "--journey", "a.toml"), "origin: not beside --journey"),
    (("plan", "yizhuang", "--journey", "a.toml", "--stopping"), "--stopping: not beside --journey"),
    (("plan", "yizhuang", "RJ", "WYJ", "--time", "90", "--jerk", "0.2"), "--jerk: no plan keeps this jerk"),
    (("plan", "yizhuang", "SJZ", "XHM", "--stopping", "--time", "400", "--jerk", "0.01"), "--jerk: no plan"),
    (("plan", "yizhuang", "--time", "100"), "--time: YZHC cannot be reached before 1734.1 s: 100.0 s"),
    (("plan", "yizhuang", "--time", "1e9"), "--time: running time out of range, minimum running time is 17"),
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


NUMERIC_BASE = {
    "drive": RUN[1:],
    "compare": ("yizhuang", "RJ", "WYJ", "--drivers", "flat_out"),
    "convoy": ("yizhuang", "RJ", "WYJ", "--head", "flat_out"),
    "plan": RUN[1:4],
    "campaign": ("example",),
    "capacity": ("yizhuang", "WYJ", "RC", "--counts", "1"),
    "line": ("yizhuang",),
    "learn": ("ppo",),
    "reproduce": ("chen2023a",),
    "serve": (),
    "runs": (),
}
"""What a command needs beside the option that is tried; a comparison's run has the options of a drive."""
ALLOWED = {("headwind", "-1"), ("adhesion", "inf")}


def options_of(command):
    """Every option of a command as it is written, without dashes, and its type."""
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        hint, *more = get_args(parameter.annotation) or (parameter.annotation,)
        declared = [word for option in more for word in getattr(option, "param_decls", None) or ()]
        yield (*declared, parameter.name)[0].removeprefix("--").replace("-", "_"), hint


NUMERIC = [
    pytest.param(name, option, value, id=f"{name} --{option.replace('_', '-')}={value}")
    for name, (module, _) in app.COMMANDS.items()
    for option, hint in options_of(getattr(import_module(module), f"{name}_command"))
    if {hint, *get_args(hint)} & {int, float}
    for value in ("nan", "-1", *(("inf",) if hint is not int else ()))
    if (option, value) not in ALLOWED and (name != "compare" or option == "seeds")
]


@pytest.mark.parametrize(("name", "option", "value"), NUMERIC)
def test_a_number_that_is_none_is_refused_by_its_option(
    metropilot, tmp_path, monkeypatch, name, option, value
):
    monkeypatch.chdir(tmp_path)
    written = f"--{option.replace('_', '-')}"
    said = metropilot(name, *NUMERIC_BASE[name], f"{written}={value}")
    assert said.code == 2, said
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert written in said.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--delay", "100"), "--delay: out of range: 100.0 s (allowed: 0 to 5 s)"),
        (("--lag", "9"), "--lag: "),
        (("--headwind", "99"), "--headwind: "),
        (("--speed-noise", "2"), "--speed-noise: "),
        (("--resistance-factor", "7"), "--resistance-factor: "),
        (("--adhesion", "0"), "--adhesion: "),
        (("--restriction", "400-300@40"), "--restriction: "),
        (("--arrive", "x"), "--arrive: "),
        (("--arrive", "1e9@30"), "--arrive: running time out of range"),
        (("--time", "1e9"), "--time: running time out of range"),
        (("--time", "83.3"), "is 83.33 s: 83.3 s (allowed: 83.33 to 2499 s)"),
    ],
)
def test_a_complaint_names_the_option_as_it_was_written(metropilot, arguments, words):
    said = metropilot(*RUN, *arguments)
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert words in said.err


def test_the_stated_minimum_is_enough(metropilot):
    from metropilot.evaluate import RunSpec

    RunSpec("yizhuang", "RJ", "WYJ", 83.33).run()
    assert metropilot("plan", "yizhuang", "RJ", "WYJ", "--time", "83.33").code == 0
    assert "allowed: 83.33 to" in metropilot("plan", "yizhuang", "RJ", "WYJ", "--time", "83.3").err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--head", "nobody"), "--head: unknown driver"),
        (("--driver", "nobody"), "--driver: unknown follower"),
        (("--delay", "9"), "--delay: out of range"),
        (("--trainsets", "1"), "--trainsets: "),
        (("--mass-factors", "1,9"), "--mass-factors: "),
        (("--uncouple-at", "-1"), "--uncouple-at: "),
        (("--head-emergency", "-1"), "--head-emergency: "),
        (("--apart", "30"), "--apart: needs a place of uncoupling (allowed: --uncouple-at M)"),
        (("--uncouple-at", "900", "--apart", "3"), "--apart: no wider than the gap while coupled"),
        (("--behind", "dkz32:AW9"), "--behind: unknown load: 'dkz32:AW9' (allowed: AW0, AW2, AW3)"),
        (("--time", "1e9"), "minimum running time of the convoy"),
    ],
)
def test_a_convoys_complaints_name_its_own_options(metropilot, arguments, words):
    said = metropilot("convoy", "yizhuang", "RJ", "WYJ", *arguments)
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert words in said.err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("delay_s = 100", "run.delay_s: out of range"),
        ("time_s = 1e9", "run.time_s: running time out of range"),
        ("dt_s = 9", "run.dt_s: "),
        ('arrivals = ["x"]', "run.arrivals: "),
        ('restrictions = ["x"]', "run.restrictions: "),
        ("seed = -1", "run.seed: "),
    ],
)
def test_a_complaint_about_a_run_file_names_file_and_key(metropilot, tmp_path, text, words):
    path = tmp_path / "run.toml"
    path.write_text(f'[run]\nline = "yizhuang"\norigin = "RJ"\ndestination = "WYJ"\n{text}\n')
    said = metropilot("drive", "--from", path)
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert f"{path}: {words}" in said.err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", 'no object "run"'),
        ('{"run": {}}', 'no "head"'),
        ("{", "not a run.json of a convoy ("),
        ('{"run": {"head": {HEAD}, "gap_m": 0}}', "run.gap_m: out of range: 0.0 m (allowed: 0.5 to 2000 m)"),
        ('{"run": {"head": {HEAD}, "gap": 8}}', "run.gap: unknown key"),
        ('{"run": {"head": {HEAD, "lag_s": 9}}}', "run.head.lag_s: out of range"),
        ('{"run": {"head": {HEAD}, "link": {"loss": 2}}}', "run.link.loss: out of range"),
        ('{"run": {"head": {HEAD}, "link": 3}}', "run.link: wrong kind of value: '3' (allowed: a table)"),
        ('{"run": {"head": {HEAD}, "disturbances": 5}}', "run.disturbances: wrong kind of value: '5'"),
        ('{"run": {"head": {HEAD}, "disturbances": [3]}}', "run.disturbances.0: wrong kind of value: '3'"),
        ('{"run": {"head": {HEAD}, "disturbances": [{"delay_s": 9}]}}', "run.disturbances.0.delay_s: out of"),
        ('{"run": {"head": {HEAD}, "follower": "follow"}}', "run.follower: unknown follower"),
        ('{"run": {"head": {HEAD, "time_s": 10}}}', "run.head.time_s: minimum running time of the convoy is"),
    ],
)
def test_a_complaint_about_a_convoy_file_names_file_and_key(metropilot, tmp_path, text, words):
    path = tmp_path / "run.json"
    path.write_text(text.replace("HEAD", '"line": "yizhuang", "origin": "RJ", "destination": "WYJ"'))
    said = metropilot("convoy", "--from", path)
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert said.err.startswith(f"metropilot: {path}: ")
    assert words in said.err


def test_platforms_that_are_too_short_are_refused_before_anything_is_computed(metropilot, monkeypatch):
    monkeypatch.setattr("metropilot.convoy.capacity.convoy_members", None)
    said = metropilot("capacity", "yizhuang", "--platform", "50", "--counts", "2")
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert "--platform: shorter than a trainset: 50.0 m" in said.err


def test_too_few_steps_are_refused_with_the_least_there_are(metropilot, tmp_path):
    said = metropilot("learn", "ppo", "--steps", "10", "--out", tmp_path / "mine")
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert "--steps: too few for 8 evaluations" in said.err
    assert "262144 or more" in said.err
    assert not (tmp_path / "mine").exists()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (
            ("line", "--headway", "180"),
            "line: minimum running time of A-B is without end: the trainset stalls",
        ),
        (("capacity",), "the trainset stalls at 794 m, where gradient and curve take 1.380 N/kg"),
        (("plan", "A", "B", "--front"), "the trainset stalls at 794 m"),
    ],
    ids=["line", "capacity", "front"],
)
def test_a_climb_on_which_the_trainset_stalls_is_said_to_be_one(metropilot, tmp_path, command, words):
    text = samples.LINE.replace("[400, 10]", "[400, 140]")
    table = text[text.index("[timetable]") : text.index("[movement_authority]")]
    (tmp_path / "steep.toml").write_text(text.replace(table, ""))
    code, _, err = metropilot(command[0], tmp_path / "steep.toml", *command[1:])
    assert code == 2
    assert err.count("\n") == 1
    assert words in err


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


@pytest.mark.parametrize("command", [RUN, ("compare", "yizhuang", "RJ", "WYJ", "--drivers", "flat_out")])
def test_a_folder_with_another_kind_of_result(metropilot, tmp_path, command):
    (tmp_path / "day.json").write_text("{}")
    said = metropilot(*command, "--out", tmp_path)
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert "out: the folder holds results of another kind: 'day.json' (allowed: another folder)" in said.err
    assert [path.name for path in tmp_path.iterdir()] == ["day.json"]


def test_a_folder_without_runs_gets_no_index(metropilot, tmp_path):
    said = metropilot("runs", "--folder", tmp_path)
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert "--folder: no runs in it" in said.err
    assert not list(tmp_path.iterdir())


def test_a_file_for_the_console_names_its_option(metropilot, tmp_path):
    (tmp_path / "data").write_text("a file")
    assert "--data: cannot write to the folder" in metropilot("serve", "--data", tmp_path / "data").err


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
    def interrupt(arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "_run", interrupt)
    assert metropilot("lines") == (130, "", "metropilot: interrupted\n")


def test_interrupted_inside_a_command(metropilot, monkeypatch):
    def interrupt() -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(catalogue, "lines_command", interrupt)
    assert metropilot("lines") == (130, "", "metropilot: interrupted\n")


def test_interrupted_where_python_drops_it(metropilot, monkeypatch):
    def interrupt(phase, info):
        gc.callbacks.remove(interrupt)
        raise KeyboardInterrupt

    def collect() -> int:
        gc.callbacks.append(interrupt)
        gc.collect()
        for _ in range(500):
            time.sleep(0.01)
        return 0

    monkeypatch.setattr(catalogue, "lines_command", collect)
    assert metropilot("lines") == (130, "", "metropilot: interrupted\n")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device")
@pytest.mark.parametrize(
    "arguments", [("lines",), ("lines", "--json"), ("show", "dkz32", "--json"), ("nothing", "--json")]
)
def test_output_that_cannot_be_written_is_one_line(arguments):
    command = [Path(sys.executable).with_name("metropilot"), *arguments]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == (2 if "nothing" in arguments else 1)
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("metropilot: ")
    assert "internal" not in done.stderr


def test_the_help_states_ranges_of_whole_numbers_too(metropilot):
    said = " ".join(metropilot("line", "--help").out.replace("│", " ").split())
    assert "10 to 7200 s" in said
    assert "9223372036854775807" not in " ".join(metropilot("drive", "--help").out.split())


def test_a_closed_pipe_is_no_error(program):
    done = program("show", "yizhuang", "--json")
    assert done.code == 0
