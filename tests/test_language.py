"""Habits of the house that a reader meets on every page: docstrings state, arrays have one type."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src" / "metropilot"
RIDDLE = re.compile(r"(What|How|Whether|That|Where|Why|Who|Whoever|Whatever)\b")


def test_a_docstring_begins_with_a_noun_phrase_or_an_imperative():
    found = []
    folders = (SOURCES, *(ROOT / name for name in ("benchmarks", "examples", "tests", "tools")))
    for path in (path for folder in folders for path in folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module):
                text = ast.get_docstring(node) or ""
                if RIDDLE.match(text):
                    found.append(f"{path.relative_to(ROOT)}: {text.splitlines()[0]}")
    assert RIDDLE.match("What a policy sees.")
    assert found == []


def test_arrays_have_one_alias():
    aliases = [
        path.relative_to(SOURCES).as_posix()
        for path in SOURCES.rglob("*.py")
        if re.search(r"^Array(: TypeAlias)? = Any", path.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert aliases == ["_typing.py"]
