"""`metropilot learn` and what is done with its runs: tiny ones, each a program as a user starts it.

The first compiles; the others take its programs from the cache that all tests share.
"""

import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from metropilot.env import TASKS
from metropilot.policy import load_policy, shipped_policy

PROGRAM = Path(sys.executable).with_name("metropilot")
LEARN = (
    *("learn", "ppo", "--steps", "20480", "--set", "environments=32", "--set", "rollout=32"),
    *("--set", "minibatches=4", "--set", "evaluations=20", "--set", "hidden=8,8", "--seed", "3"),
)
EVALUATIONS = 20
STEPS = EVALUATIONS * 32 * 32


def answer(said, code=0):
    assert said.code == code, said
    assert said.err == ""
    return json.loads(said.out)


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """The folder of a run that was never interrupted, and what learning it said."""
    folder = tmp_path_factory.mktemp("learned")
    command = [PROGRAM, *LEARN, "--out", "mine"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return folder / "mine", done.stdout


def test_learning_says_how_it_goes(run_folder):
    folder, said = run_folder
    lines = said.splitlines()
    assert lines[0].startswith("ppo: ppo on drive_both, seed 3, in ")
    rows = [line.split() for line in lines if re.match(r"\s+[\d ]+\d\s", line)]
    assert len(rows) == EVALUATIONS
    assert lines[EVALUATIONS + 1].split("  ")[-1].strip() == "0:00"
    assert "drives that arrive safely and on time" in said
    assert f"--driver learned --set policy={folder}" in said


def test_a_run_can_be_shown_driven_and_exported(run_folder, metropilot, typed, tmp_path):
    folder, _ = run_folder
    record = answer(metropilot("show", folder, "--json"))
    assert (record["kind"], record["status"], record["steps"]) == ("learning run", "done", STEPS)
    assert record["command"].startswith("metropilot learn ppo --budget quick --steps 20480 --seed 3 --set")
    assert record["config"]["hidden"] == [8, 8]
    assert 0.0 <= record["kpis"]["safe_share"] <= 1.0
    policy = folder / "policy.safetensors"
    shown = answer(metropilot("show", policy, "--json"))
    assert shown["network"]["hidden"] == [8, 8]
    assert shown["perception"]["features"][0] == "position"
    assert "training" in metropilot("show", policy).out
    assert "settings" in metropilot("show", folder).out
    run = ("yizhuang", "RJ", "WYJ", "--time", "110", "--ideal")
    kpis = json.loads(typed("drive", *run, "--driver", f"learned:policy={folder}", "--json").out)
    again = json.loads(typed("drive", *run, "--driver", "learned", "--set", f"policy={policy}", "--json").out)
    assert kpis["energy_wheel_kwh"] == again["energy_wheel_kwh"] > 0
    found = answer(metropilot("export", folder, "--to", "onnx", "--out", tmp_path / "mine.onnx", "--json"))
    assert found["parity"] < 1e-5
    assert found["latency_us_median"] > 0
    assert metropilot("export", policy, "--out", tmp_path / "again.onnx").code == 0
    assert (tmp_path / "mine.onnx").read_bytes() == (tmp_path / "again.onnx").read_bytes()


def test_an_onnx_file_says_what_its_numbers_mean(run_folder, metropilot, tmp_path):
    import onnx

    path = tmp_path / "mine.onnx"
    assert metropilot("export", run_folder[0], "--out", path).code == 0
    told = {item.key: json.loads(item.value) for item in onnx.load(path).metadata_props}
    assert told["perception"]["period_s"] == 0.5
    assert told["algorithm"] == "ppo"


def stop_run(folder, command, how):
    """Start learning, and stop it by a signal after its first evaluation; what it said."""
    pipe = subprocess.PIPE
    # A suite that a shell runs in the background ignores Ctrl-C, and its children would inherit that;
    # it is said here and not in the child, where it would need a fork beside JAX's threads.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen([PROGRAM, *command], cwd=folder, stdout=pipe, stderr=pipe, text=True)
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        for line in process.stdout:
            if re.match(r"\s+[\d ]+\d\s+\d", line):
                break
        process.send_signal(how)
        _, err = process.communicate(timeout=120)
    finally:
        process.kill()
    return process.returncode, err


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_interrupted_twice_it_learns_the_same(run_folder, metropilot, program, tmp_path):
    code, err = stop_run(tmp_path, [*LEARN, "--out", "mine"], signal.SIGINT)
    assert code == 130
    assert err.startswith("metropilot: compiling"), "while nothing else is to be seen"
    again = shlex.split(err.strip().partition("resume with: ")[2])
    assert again[:3] == ["metropilot", "learn", "--resume"]
    assert answer(metropilot("show", tmp_path / "mine", "--json"))["status"] == "interrupted"
    code, _ = stop_run(tmp_path, again[1:], signal.SIGKILL)
    assert code == -signal.SIGKILL
    shown = answer(metropilot("show", tmp_path / "mine", "--json"))
    assert shown["status"] == "interrupted"
    assert 0 < shown["steps"] < STEPS
    assert "Resume with: metropilot learn --resume" in metropilot("show", tmp_path / "mine").out
    done = answer(program(*again[1:], "--json"))
    assert (done["status"], done["steps"]) == ("done", STEPS)
    ours, theirs = (load_policy(f / "policy.safetensors")[0] for f in (tmp_path / "mine", run_folder[0]))
    for name, value in theirs.params.items():
        assert (ours.params[name] == value).all(), name
    assert answer(metropilot("learn", "--resume", tmp_path / "mine", "--json")) == done


def test_runs_are_listed_with_what_became_of_them(metropilot, tmp_path, monkeypatch):
    from metropilot.learn import PPOConfig, RunStore

    monkeypatch.setenv("METROPILOT_HOME", str(tmp_path))
    assert "No runs in" in metropilot("runs").out
    store = RunStore(tmp_path / "runs")
    record = store.create(PPOConfig(), "drive", 4, {"name": "drive"}, driver="ppo_scaled")
    store.update(record, status="done", kpis={"safe_share": 1.0, "gap_percent": 2.5}, steps=1000)
    dead = store.create(PPOConfig(), "drive_jerk", 5, {"name": "drive_jerk"}, driver="ppo")
    rows = answer(metropilot("runs", "--json"))
    assert {row["id"]: row["status"] for row in rows} == {record.id: "done", dead.id: "interrupted"}
    assert [row["seed"] for row in answer(metropilot("runs", "jerk", "--json"))] == [5]
    text = metropilot("runs").out
    assert "ppo_scaled" in text
    assert "2.50" in text
    assert answer(metropilot("show", record.id, "--json"))["id"] == record.id
    assert metropilot("learn", "--resume", record.id, "--seed", "1").code == 2
    assert metropilot("learn", "--resume", record.id).code == 0


def test_a_run_drives_by_its_id(metropilot, tmp_path, monkeypatch):
    monkeypatch.setenv("METROPILOT_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    name = "ppo-20260101-120000-ab12"
    (tmp_path / "runs" / name).mkdir(parents=True)
    shutil.copyfile(shipped_policy("ppo"), tmp_path / "runs" / name / "policy.safetensors")
    section = ("yizhuang", "RJ", "WYJ", "--time", "110")
    said = answer(metropilot("drive", *section, "--driver", "ppo", "--json"))
    again = ("--driver", "learned", "--set", f"policy={name}", "--out", "driven", "--json")
    learned = answer(metropilot("drive", *section, *again))
    assert learned["energy_wheel_kwh"] == said["energy_wheel_kwh"]
    told = tmp_path / "mine.toml"
    text = (tmp_path / "driven" / "run.toml").read_text()
    told.write_text(text.replace('policy = "policy.safetensors"', f'policy = "{name}"'))
    assert name in told.read_text()
    from_toml = answer(metropilot("drive", "--from", told, "--json"))
    assert from_toml["energy_wheel_kwh"] == said["energy_wheel_kwh"]
    rows = answer(metropilot("compare", *section, "--drivers", f"ppo,learned:policy={name}", "--json"))
    first, second = (row["kpis"]["energy_wheel_kwh"]["mean"] for row in rows["drivers"])
    assert first == second
    refused = metropilot("drive", *section, "--driver", "learned", "--set", "policy=another")
    assert (refused.code, refused.err.count("\n")) == (2, 1)


def test_tasks_are_the_registry(metropilot):
    rows = answer(metropilot("tasks", "--json"))
    assert [row["id"] for row in rows] == list(TASKS)
    assert "ppo_scaled" in next(row["drivers"] for row in rows if row["id"] == "drive_both")
    assert "drive_jerk" in metropilot("tasks").out


ABOARD = ("--to", "c", "--line", "yizhuang", "--out", "aboard")
BAD = [
    (("learn",), "driver: missing (allowed: ppo, ppo_scaled"),
    (("learn", "pp0"), "did you mean ppo"),
    (("learn", "ppo", "--set", "entrpy=1"), "entrpy: unknown key, did you mean entropy? (allowed: steps, "),
    (("learn", "ppo", "--set", "foo=1"), "foo: unknown key (allowed: steps, "),
    (("learn", "ppo", "--set", "entropy"), "KEY=VALUE"),
    (("learn", "ppo", "--set", "hidden=wide"), "a whole number, or a list of such"),
    (("learn", "ppo", "--set", "gamma=2"), "gamma: out of range"),
    (("learn", "ppo", "--steps", "0"), "steps: out of range"),
    (("learn", "ppo", "--task", "driv"), "did you mean drive"),
    (
        ("learn", "ppo", "--sections", "RJ-WYJ"),
        "sections: sections of no line: 'RJ-WYJ' (allowed",
    ),
    (("learn", "ppo", "--line", "yizhuang", "--sections", "RJ"), "allowed: ORIGIN-DESTINATION"),
    (("learn", "ppo", "--line", "nowhere.toml"), "nowhere.toml: cannot be read"),
    (
        ("learn", "eitop", "--line", "yizhuang"),
        "task: the task has sections and trainsets of its own",
    ),
    (("learn", "generalist", "--task", "drive"), "demonstrations exist only for random sections"),
    (("learn", "ppo", "--budget", "huge"), "allowed: quick, paper"),
    (("learn", "--resume", "nowhere"), "no such run"),
    (("learn", "--resume", "."), "not the folder of a learning run"),
    (("export", "optimal"), "the driver has no policy of its own"),
    (("export", "nowhere"), "no such driver or run"),
    (("export", "nowhere.safetensors"), "No such file"),
    (("export", "learned"), "the driver has no policy of its own"),
    (("export", "optimal", "--to", "pickle"), "allowed: onnx, c, wasm"),
    (("export", "ppo", "--line", "yizhuang"), "only of --to c"),
    (("export", "ppo", "--to", "c", "--out", "x"), "--to c needs --line"),
    (("export", "ppo", "--to", "c", "--line", "yizhuang"), "--to c needs --out"),
    (("export", "ppo", *ABOARD, "--number", "half"), "allowed: double, float"),
    (("export", "ppo", *ABOARD, "--sections", "RJ"), "allowed: ORIGIN-DESTINATION"),
    (("export", "ppo", *ABOARD, "--sections", "RJ-NOWHERE"), "NOWHERE"),
    (("export", "ppo", *ABOARD, "--sections", "RJ-WYJ,RJ-WYJ"), "allowed: each section once"),
    *(
        (("export", name, *ABOARD), "plans or searches as it drives, which has no form in C")
        for name in ("optimal", "mpc")
    ),
]


@pytest.mark.parametrize(("arguments", "words"), BAD, ids=[" ".join(a) for a, _ in BAD])
def test_bad_input_is_one_line(metropilot, arguments, words, tmp_path, monkeypatch):
    monkeypatch.setenv("METROPILOT_HOME", str(tmp_path))
    said = metropilot(*arguments)
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1), said
    assert words in said.err


def test_a_folder_that_holds_a_run_is_not_written_over(run_folder, program):
    said = program(*LEARN, "--out", run_folder[0])
    assert said.code == 2
    assert "holds a run already" in said.err


def test_a_resumed_run_stays_on_its_line(run_folder, metropilot):
    said = metropilot("learn", "--resume", run_folder[0], "--line", "yizhuang")
    assert said.code == 2
    assert "line: a resumed run keeps its settings: 'yizhuang'" in said.err


def test_a_driver_is_learned_on_a_line_of_ones_own(metropilot, program, tmp_path):
    from metropilot.railway import document_text

    line = tmp_path / "mine.toml"
    line.write_text(document_text("line", "yizhuang"), encoding="utf-8")
    there = ("--line", line, "--sections", "CQN-JHL", "--trainset", "dkz32@0.5,0.3", "--load", "AW2")
    done = answer(program(*LEARN, *there, "--out", tmp_path / "there", "--json"))
    about = {"line": "line.toml", "sections": "CQN-JHL", "trainset": "dkz32@0.5,0.3", "load": "AW2"}
    assert (done["status"], done["about"]) == ("done", about | {"name": "drive_both"})
    assert f"--line {line} --sections CQN-JHL --trainset dkz32@0.5,0.3 --load AW2 --budget" in done["command"]
    line.unlink()
    assert answer(metropilot("learn", "--resume", tmp_path / "there", "--json")) == done
    _, told = load_policy(tmp_path / "there" / "policy.safetensors")
    assert told["task"] == done["about"]


def test_examples_name_what_there_is():
    from metropilot.learn import recipe

    for line in import_module("metropilot.cli.learn").EXAMPLES["learn"]:
        words = shlex.split(line)
        if "--resume" not in words:
            assert recipe(words[2])
