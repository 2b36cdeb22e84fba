"""A line short enough to be planned many times."""

from dataclasses import replace
from functools import cache

from metropilot.railway import load_line, load_trainset

TRAINSET = load_trainset("dkz32", "AW2")


@cache
def short_line(stations):
    """The first stations of Yizhuang."""
    line = load_line("yizhuang")
    return replace(
        line,
        stations=line.stations[:stations],
        planned_forward_s=line.planned_forward_s[: stations - 1],
        planned_backward_s=line.planned_backward_s[: stations - 1],
        dwell_s=line.dwell_s[: stations - 2],
    )
