"""Packages use each other through their doors: names that an ``__init__`` lists, and nothing behind it."""

import ast
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src" / "metropilot"
# Doors of their own: one a paper, and the environments of the extra ``rl``, whose import registers their ids.
INNER = {f"studies.{path.parent.name}" for path in SOURCE.glob("studies/*/study.py")} | {"env.adapters"}
LAZY = sorted(p.parent.name for p in SOURCE.glob("*/__init__.py") if "lazy_door(" in p.read_text())


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
def test_a_lazy_door_lists_its_names_once_each_way(package):
    tree = ast.parse((SOURCE / package / "__init__.py").read_text())
    typed = {
        (node.module.removeprefix(f"metropilot.{package}."), alias.name)
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    call = next(
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "lazy_door"
    )
    homes = ast.literal_eval(call.args[1])
    assert {(module, name) for module, names in homes.items() for name in names} == typed
    door = importlib.import_module(f"metropilot.{package}")
    assert sorted(door.__all__) == sorted(name for _, name in typed) == dir(door)
    modules = {path.stem for path in (SOURCE / package).iterdir()}
    assert not modules & set(door.__all__), "a module of the same name would hide it"
    with pytest.raises(AttributeError, match="has no attribute 'cars'"):
        _ = door.cars
