"""Every example in README.md and docs/ runs: Python blocks and `metropilot` command lines, in page order.

One page is one test with one namespace and one empty working folder. HTML comments steer it:
`<!-- test: skip -->` before a block leaves that block out, `<!-- test: exit 2 -->` says that its commands end
with that code.
"""

import re
import shlex
import subprocess
import sys
from dataclasses import dataclass, fields
from pathlib import Path

import pytest
from tests import commands
from tools import driver_page, site_nav

from metropilot.convoy import ConvoyKpis, MemberKpis
from metropilot.evaluate import Kpis
from metropilot.sim import COLUMNS
from metropilot.studies import STUDIES

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(
    r"(?:<!-- test: (?P<directive>skip|exit \d+) -->\n+)?"
    r"^```(?P<language>python|console|sh|bash)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Block:
    """One example of a page."""

    language: str
    text: str
    line: int
    directive: str

    @property
    def commands(self) -> list[list[str]]:
        """The `metropilot` command lines of a shell block, continuation lines joined, prompts removed."""
        joined = self.text.replace("\\\n", " ")
        lines = (line.removeprefix("$ ") for line in joined.splitlines())
        return [shlex.split(line, comments=True) for line in lines if line.startswith("metropilot ")]


def blocks_of(text: str) -> list[Block]:
    """Return the runnable blocks of a page in order."""
    found = []
    for match in BLOCK.finditer(text):
        line = text.count("\n", 0, match.start("text"))
        found.append(Block(match["language"], match["text"], line, match["directive"] or ""))
    return [block for block in found if block.directive != "skip"]


def pages() -> list:
    """Return every page that has something to run."""
    rows = []
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = path.read_text()
        if any(block.language == "python" or block.commands for block in blocks_of(text)):
            rows.append(pytest.param(path, id=path.relative_to(ROOT).as_posix()))
    return rows


def run_program(command: list[str], cwd: Path) -> tuple[int, str, str]:
    """Output of a line with the command of this environment, started as a user does."""
    program = Path(sys.executable).with_name(command[0])
    done = subprocess.run([program, *command[1:]], capture_output=True, text=True, check=False, cwd=cwd)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("page", pages())
def test_examples_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # a study of the reader's is not one of the package in the tests that follow
    monkeypatch.setattr(STUDIES, "_rows", dict(STUDIES.rows()))
    namespace = {"__name__": "__example__"}
    for block in blocks_of(page.read_text()):
        if block.language == "python":
            exec(compile("\n" * block.line + block.text, str(page), "exec"), namespace)
        for command in block.commands:
            code = int(block.directive.removeprefix("exit ") or 0)
            first = page.name == "README.md"  # by a program each; a start takes longer than most commands
            said = run_program(command, tmp_path) if first else commands.run(*command[1:], cwd=tmp_path)
            found, out, err = said
            whole = f"{shlex.join(command)}\n{out[-2000:]}\n{err[-2000:]}"
            assert found == code, whole
            assert "Traceback" not in err, whole


def test_blocks_are_found_with_their_directives():
    page = (
        "<!-- test: exit 2 -->\n```console\n$ metropilot drive a \\\n  b  # why\nanswer\n```\n\n"
        "<!-- test: skip -->\n```python\nraise ValueError\n```\n\n```python\nx = 1\n```\n"
    )
    shell, python = blocks_of(page)
    assert shell.commands == [["metropilot", "drive", "a", "b"]]
    assert shell.directive == "exit 2"
    assert python.text == "x = 1\n"
    assert python.commands == []


def test_every_driver_is_on_its_page():
    text = (ROOT / "docs/drivers.md").read_text()
    assert driver_page.page(text) == text, "python tools/driver_page.py"


def test_the_results_of_the_readme_are_those_of_the_leaderboard():
    def rows(page):
        cells = [line.strip("|").split("|") for line in page.splitlines() if line.startswith("| `")]
        return [[cell.strip() for cell in row] for row in cells]

    header, nominal = "| driver | runs |", (ROOT / "docs/leaderboard.md").read_text()
    table = nominal[nominal.index(header) :].partition("\n\n")[0]
    names = [cell.strip() for cell in table.splitlines()[0].replace("\\|", "").strip("|").split("|")]
    columns = ("on time", "gap median %", "worst %", "jerk: worst m/s³", "intervened")
    board = {row[0]: [row[names.index(name)] for name in columns] for row in rows(table)}
    shown = rows((ROOT / "README.md").read_text())
    assert len(shown) == 6
    for driver, _, *values in shown:
        assert values == board[driver]


def test_every_key_figure_is_on_its_page():
    text = (ROOT / "docs/kpis.md").read_text()
    run, _, convoy = text.partition("## A convoy")
    rows = set(re.findall(r"^\| `(\w+)` \|", run, re.MULTILINE))
    assert rows == {field.name for field in fields(Kpis)}
    named = set(re.findall(r"`(\w+)`", text))
    assert {field.name for field in fields(ConvoyKpis)} <= set(re.findall(r"`(\w+)`", convoy))
    assert {field.name for field in fields(MemberKpis)} <= named


def test_every_page_and_decision_is_in_its_index():
    for folder, pattern in (("docs", "*.md"), ("docs/decisions", "0*.md")):
        index = (ROOT / folder / "index.md").read_text()
        pages = {path.name for path in (ROOT / folder).glob(pattern)} - {"index.md"}
        assert pages <= set(re.findall(r"\]\(([\w-]+\.md)\)", index)), folder


def test_every_column_and_file_is_on_the_page_of_formats():
    named = set(re.findall(r"`(\w+)`", (ROOT / "docs/formats.md").read_text()))
    assert set(COLUMNS) <= named


def test_the_navigation_has_every_page_once():
    pages = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")]
    found = [page for section in site_nav.navigation(pages) for rows in section.values() for page in rows]
    assert sorted(found) == sorted(pages)
    assert found[:2] == ["index.md", "tutorial.md"]
    assert site_nav.navigation(["index.md", "new.md"])[-1] == {"More": ["new.md"]}


def test_a_page_names_commits_of_this_history():
    """A table that was measured at a commit that was never landed cannot be measured again."""

    def git(*words):
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)

    if git("rev-parse", "--is-shallow-repository").stdout.strip() != "false":
        pytest.skip("no history here")
    history = git("rev-list", "HEAD").stdout.split()
    gone = [
        f"{path.relative_to(ROOT)}: {commit}"
        for path in sorted((ROOT / "docs").rglob("*.md"))
        for commit in sorted(set(re.findall(r"\bcommit:? ([0-9a-f]{7,40})\b(?!-dirty|\+)", path.read_text())))
        if not any(each.startswith(commit) for each in history)
    ]
    assert not gone
