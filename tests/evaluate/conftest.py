"""Drivers that do one simple thing, and a run to do it on."""

import pytest

from metropilot.evaluate import RunSpec
from metropilot.sim import AbstractDriver


class Scripted(AbstractDriver):
    """Gives the command that a function of the observation says."""

    id = "scripted"
    summary = "does what a test says"
    source = "test"

    def __init__(self, command):
        self.command = command
        self.seen = []

    def init(self, run):
        return None

    def act(self, memory, observation):
        self.seen.append(observation)
        return self.command(observation), memory


@pytest.fixture
def scripted():
    return Scripted


@pytest.fixture
def request_rj():
    """Rongjing to Wanyuanjie in 101 s with the driver that needs no plan."""
    return RunSpec("yizhuang", "RJ", "WYJ", 101.0, driver="flat_out")
