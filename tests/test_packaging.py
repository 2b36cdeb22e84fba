"""The public doors: what importing costs, and that `__all__` is what the documentation lists."""

import ast
import importlib
import pkgutil
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import metropilot
from metropilot.convoy import FOLLOWERS
from metropilot.drivers import DRIVERS
from metropilot.env import TASKS
from metropilot.learn import RECIPES
from metropilot.studies import STUDIES

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(module.name for module in pkgutil.iter_modules(metropilot.__path__) if module.ispkg)
HEAVY = ("jax", "jaxlib", "matplotlib", "plotly", "scipy")


def heavy_modules_after(code: str) -> set[str]:
    """Run code in a fresh interpreter and return the heavy libraries it has imported."""
    report = f"import sys\nprint('\\nHEAVY', *(name for name in {HEAVY!r} if name in sys.modules))"
    script = f"try:\n    {code}\nexcept SystemExit:\n    pass\n{report}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.rpartition("HEAVY")[2].split())


@pytest.mark.parametrize("code", ["import metropilot", "import metropilot.railway"])
def test_light_doors_import_nothing_heavy(code):
    assert heavy_modules_after(code) == set()


def test_help_does_not_import_jax():
    code = "import sys; sys.argv = ['metropilot', '--help']; from metropilot.cli import main; main()"
    assert not heavy_modules_after(code) & {"jax", "jaxlib"}


@pytest.mark.parametrize("arguments", [(), ("--followers",), ("--json",)])
def test_listing_drivers_imports_none_of_them(arguments):
    code = (
        f"import sys; sys.argv = ['metropilot', 'drivers', *{arguments!r}]\n"
        "from metropilot.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "import metropilot.drivers, metropilot.convoy.drivers\n"
        "files = {m for m in sys.modules if 'drivers.' in m}\n"
        "assert files <= {'metropilot.drivers.registry', 'metropilot.convoy.drivers.base'}, files\n"
        "assert 'jax' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("registry", [DRIVERS, FOLLOWERS, TASKS, STUDIES, RECIPES], ids=lambda r: r.kind)
def test_every_row_of_a_registry_can_be_imported(registry):
    for name, row in registry.rows().items():
        assert row.summary
        assert getattr(registry.get(name), "id", name) == name


def test_the_probe_sees_heavy_imports():
    assert heavy_modules_after("import jax") >= {"jax", "jaxlib"}


def test_root_is_lazy_and_knows_its_packages():
    assert set(PACKAGES) <= set(dir(metropilot))
    assert metropilot.railway is importlib.import_module("metropilot.railway")
    with pytest.raises(AttributeError, match="has no attribute 'cars'"):
        _ = metropilot.cars


def test_version_is_the_projects():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert metropilot.__version__ == project["version"]


def documented_names(package: str) -> list[str]:
    """Return the names that docs/api.md lists under a package's heading."""
    page = (ROOT / "docs" / "api.md").read_text()
    _, found, rest = page.partition(f"\n## metropilot.{package}\n")
    assert found, f"docs/api.md has no section for metropilot.{package}: run `make api`"
    return re.findall(r"^- `(\w+)`", rest.partition("\n## ")[0], flags=re.MULTILINE)


@pytest.mark.parametrize("package", PACKAGES)
def test_public_door_is_what_is_documented(package):
    door = importlib.import_module(f"metropilot.{package}").__all__
    missing = [name for name in door if not hasattr(importlib.import_module(f"metropilot.{package}"), name)]
    assert missing == [], "`__all__` names what is not there"
    assert sorted(door) == sorted(documented_names(package)), "docs/api.md is stale: run `make api`"


def test_a_class_name_means_one_thing():
    homes = {}
    for path in (ROOT / "src" / "metropilot").rglob("*.py"):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(path.relative_to(ROOT).as_posix())
    assert {name: paths for name, paths in homes.items() if len(paths) > 1} == {}


def test_constraints_are_exact_versions_without_addresses():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    pattern = r'[a-z0-9-]+==[0-9][\w.!+]*( ; python_version (==|>=) "3\.\d+")?'
    assert [pin for pin in pins if not re.fullmatch(pattern, pin)] == []
    assert len(pins) > 40
