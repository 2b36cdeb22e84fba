"""Packages use each other through their doors: names that an ``__init__`` offers, and nothing behind it."""

import ast
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src" / "metropilot"
# Doors of their own: one a paper, and the environments of the extra ``rl``, whose import registers their ids.
INNER = {f"studies.{path.parent.name}" for path in SOURCE.glob("studies/*/study.py")} | {"env.adapters"}
LAZY = sorted(p.parent.relative_to(SOURCE).as_posix() for p in SOURCE.rglob("__init__.pyi"))


def imported_modules(tree):
    """Line and module of every import of metropilot in a syntax tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "metropilot":
            yield node.lineno, node.module
        elif isinstance(node, ast.Import):
            yield from ((node.lineno, a.name) for a in node.names if a.name.split(".")[0] == "metropilot")


def python_blocks(page):
    """Line and syntax tree of every Python block of a page."""
    for block in re.finditer(r"^```python\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL):
        yield page[: block.start()].count("\n") + 1, ast.parse(block[1])


def trees():
    """Path, package, first line and syntax tree of everything that must use doors."""
    for path in sorted(SOURCE.rglob("*.py")):
        parts = path.relative_to(SOURCE).parts
        yield path, parts[0] if len(parts) > 1 else None, 0, ast.parse(path.read_text())
    for folder in ("examples", "benchmarks", "tools"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            yield path, None, 0, ast.parse(path.read_text())
    # The tests of a package may look behind its own door.
    for path in sorted((ROOT / "tests").rglob("*.py")):
        yield path, path.relative_to(ROOT / "tests").parts[0], 0, ast.parse(path.read_text())
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        for line, tree in python_blocks(path.read_text()):
            yield path, None, line, tree


def test_nothing_imports_the_inside_of_another_package():
    behind = []
    for path, own, first, tree in trees():
        for line, module in imported_modules(tree):
            package, *inside = module.split(".")[1:] or [""]
            # The command line offers a program and no names: it has no door.
            if (
                inside
                and package not in {own, "cli"}
                and (SOURCE / package).is_dir()
                and f"{package}.{'.'.join(inside)}" not in INNER
            ):
                behind.append(f"{path.relative_to(ROOT)}:{first + line}: {module}")
    assert behind == []


def test_a_public_name_belongs_to_one_package():
    packages = sorted(path.parent.name for path in SOURCE.glob("*/__init__.py"))
    owners = {}
    for package in packages:
        for name in getattr(importlib.import_module(f"metropilot.{package}"), "__all__", ()):
            owners.setdefault(name, []).append(package)
    assert {name: found for name, found in owners.items() if len(found) > 1} == {}


@pytest.mark.parametrize("package", LAZY)
def test_a_door_offers_what_its_stub_lists(package):
    stub = ast.parse((SOURCE / package / "__init__.pyi").read_text())
    listed = [(node.module, alias) for node in stub.body for alias in node.names]
    assert [alias.name for _, alias in listed if alias.asname != alias.name] == [], "types need `A as A`"
    door = importlib.import_module(f"metropilot.{package.replace('/', '.')}")
    assert door.__all__ == dir(door) == sorted(alias.name for _, alias in listed)
    for module, alias in listed:
        home = importlib.import_module(f"{door.__name__}.{module}")
        assert getattr(door, alias.name) is getattr(home, alias.name)
    with pytest.raises(AttributeError, match="attribute cars"):
        _ = door.cars
