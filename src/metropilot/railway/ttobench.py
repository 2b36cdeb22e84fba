"""TTOBench JSON: tracks, trains and journeys."""

from __future__ import annotations

from metropilot.railway.journey import Journey
from metropilot.railway.line import Line
from metropilot.railway.node import Node
from metropilot.railway.trainset import Trainset


def read_ttobench(root: Node, stem: str) -> Line | Trainset | Journey:
    raise NotImplementedError
