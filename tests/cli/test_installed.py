"""Objects that installed packages add to the registries by entry points."""

import json
import os
import sys

import pytest

from metropilot._registry import Registry, RegistryRow
from metropilot.convoy import FOLLOWERS
from metropilot.drivers import DRIVERS
from metropilot.env import TASKS
from metropilot.errors import InputError
from metropilot.learn import RECIPES
from metropilot.studies import STUDIES

OWN = '''
from metropilot.sim import AbstractDriver


class Half(AbstractDriver):
    """Half traction to 10 m/s, then coasting."""

    id = "half"

    def init(self, run):
        return None

    def act(self, memory, observation):
        return (0.5 if observation.speed_mps < 10.0 else 0.0), memory
'''
POINTS = """[metropilot.drivers]
half = own_package:Half
pid = own_package:Half
nowhere = no_such_module:Half
third = own_package:Half
"""
SHIPPED = {"pid": RegistryRow("metropilot.drivers.pid:Pid", "PID", "Cheng23")}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Install a package with a driver, as pip would, in a folder on the path."""
    (tmp_path / "own_package.py").write_text(OWN, encoding="utf-8")
    info = tmp_path / "own_package-0.1.dist-info"
    info.mkdir()
    (info / "entry_points.txt").write_text(POINTS, encoding="utf-8")
    said = "Metadata-Version: 2.1\nName: own-package\nVersion: 0.1\n"
    (info / "METADATA").write_text(said, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("own_package", None)


def test_a_package_adds_what_the_own_rows_lack(package):
    registry = Registry("driver", SHIPPED, group="metropilot.drivers")
    assert registry.ids() == ("pid", "half")
    assert registry.row("pid") is SHIPPED["pid"], "a package cannot replace what is shipped"
    row = registry.row("half")
    assert (row.target.id, row.summary, row.source) == (
        "half",
        "Half traction to 10 m/s, then coasting",
        "own-package",
    )
    assert registry.get("half") is row.target


def test_what_is_shipped_imports_no_other_package(package):
    registry = Registry("driver", SHIPPED, group="metropilot.drivers")
    assert registry.get("pid").id == "pid"
    assert "own_package" not in sys.modules


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere", "no_such_module:Half: ModuleNotFoundError: No module named 'no_such_module'"),
        ("third", "own_package:Half has the id half"),
    ],
)
def test_a_package_that_cannot_be_used_is_named_when_asked_for(package, name, words):
    registry = Registry("driver", group="metropilot.drivers")
    assert name not in registry.ids()
    with pytest.raises(InputError) as refused:
        registry.get(name)
    assert words in str(refused.value)


def test_an_installed_driver_drives_from_the_command_line(package, program):
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(package), *sys.path])}
    listed = {row["id"]: row for row in json.loads(program("drivers", "--json", env=env).out)}
    assert listed["half"]["source"] == "own-package"
    said = program("drive", "yizhuang", "RJ", "WYJ", "--driver", "half", "--json", env=env)
    assert (said.code, json.loads(said.out)["outcome"]) == (1, "overshot"), said


def test_the_groups_that_the_docs_name():
    groups = {registry.group for registry in (DRIVERS, FOLLOWERS, STUDIES, TASKS, RECIPES)}
    named = {f"metropilot.{name}" for name in ("drivers", "followers", "studies", "tasks", "recipes")}
    assert groups == named
