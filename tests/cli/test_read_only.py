"""Folders that may not be written: one line, exit code 2, and what was there stays, bit for bit."""

import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from metropilot.railway import load_line, write_line

PROGRAM = Path(__file__).with_name("obedient.py")
SECTION = ("yizhuang", "RJ", "WYJ", "--time", "110")
CAMPAIGN = """
name = "mine"
[matrix]
drivers = ["flat_out"]
sections = ["yizhuang RJ WYJ"]
loads = ["AW2"]
times = [1.2]
"""
RUN_CAMPAIGN = ("campaign", "mine.toml", "--workers", "1", "--out")
WRITERS = {
    "drive": ("drive", *SECTION, "--driver", "flat_out", "--out", "{}"),
    "compare": ("compare", *SECTION, "--drivers", "flat_out,manual", "--out", "{}"),
    "plan": ("plan", *SECTION, "--out", "{}"),
    "convoy": ("convoy", *SECTION, "--trainsets", "2", "--out", "{}"),
    "capacity": ("capacity", "yizhuang", "WYJ", "RC", "--counts", "1", "--out", "{}"),
    "line": ("line", "yizhuang", "--headway", "300", "--out", "{}"),
    "fit": ("fit", "drive/trajectory.csv", "--trainset", "dkz32", "--keep", "lag", "--out", "{}"),
    "import": ("import", "line.toml", "--force", "--out", "{}/line.toml"),
    "export": ("export", "ppo", "--to", "onnx", "--out", "{}/ppo.onnx"),
    "campaign": (*RUN_CAMPAIGN, "{}"),
    "leaderboard": (*RUN_CAMPAIGN, "driven", "--write-docs", "{}/page.md"),
}
LONG = {
    "learn": ("learn", "ppo", "--out", "{}"),
    "reproduce": ("reproduce", "cheng2023", "--out", "{}"),
}
"""Refused before they begin; what would be there is not made first."""
READ = ["drive", "--from", "drive/run.toml"]
# Commands run one after the other in two programs; some compile.


def tree(folder):
    """Every file below a folder with its bytes."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def lock(folder):
    """Take from everybody the right to write to a folder and all in it."""
    for path in (*folder.rglob("*"), folder):
        path.chmod(path.stat().st_mode & ~(stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH))


def unlock(folder):
    """Give it back, for those who tidy up."""
    for path in (folder, *folder.rglob("*")):
        path.chmod(path.stat().st_mode | stat.S_IWUSR)


def words(name, folder):
    """The command line of a writer."""
    return [word.format(folder) for word in (WRITERS | LONG)[name]]


def obeying(commands, work):
    """Run the commands as a user whom permissions bind."""
    told = {**os.environ, "METROPILOT_HOME": str(work / "home")}
    done = subprocess.run(
        [sys.executable, PROGRAM],
        input=json.dumps(commands),
        capture_output=True,
        text=True,
        check=False,
        cwd=work,
        env=told,
    )
    if done.stderr.startswith("rights cannot be given up"):
        pytest.skip(done.stderr)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Answer of each writer, and its folder before and after: over its own results, and anew."""
    work = tmp_path_factory.mktemp("work")
    (work / "mine.toml").write_text(CAMPAIGN)
    write_line(load_line("yizhuang"), work / "line.toml")
    for said in obeying([words(name, name) for name in WRITERS], work):
        assert said["code"] in {0, 1}, said
    before = {name: tree(work / name) for name in WRITERS}
    assert all(before.values())
    (work / "empty").mkdir()
    asked = [(name, name) for name in WRITERS] + [(name, "empty/new") for name in WRITERS | LONG]
    locked = [work / name for name in (*WRITERS, "empty")]
    for folder in locked:
        lock(folder)
    try:
        said = obeying([words(*pair) for pair in asked] + [READ], work)
    finally:
        for folder in locked:
            unlock(folder)
    assert said.pop() == {"code": 1, "err": ""}, "reading needs no right to write (1: flat out is too early)"
    after = {name: tree(work / name) for name in WRITERS}
    assert not tree(work / "empty")
    return dict(zip(asked, said, strict=True)), before, after


@pytest.mark.parametrize("name", WRITERS)
def test_a_locked_folder_keeps_what_was_there(answers, name):
    said, before, after = answers
    assert after[name] == before[name]
    one_line(said[name, name])


@pytest.mark.parametrize("name", [*WRITERS, *LONG])
def test_a_folder_that_cannot_be_made_is_one_line(answers, name):
    said, _, _ = answers
    one_line(said[name, "empty/new"])


def one_line(said):
    assert said["code"] == 2, said
    assert said["err"].count("\n") == 1, said
    assert said["err"].startswith("metropilot: "), said
    assert "Permission denied" in said["err"], said
