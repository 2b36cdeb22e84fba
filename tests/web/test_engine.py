"""A live run stepped by hand: what it says to news it cannot meet."""

import re

import pytest

from metropilot.errors import SolverError
from metropilot.evaluate import Request
from metropilot.web.live.engine import Engine


def told_at(time_s, scheduled_s):
    """What a run says to a new running time, and when it then arrives."""
    engine = Engine(Request("yizhuang", "RJ", "WYJ", time_s=101.0))
    while engine.time_s < time_s:
        engine.advance()
    words = engine.apply({"kind": "arrival", "scheduled_time_s": scheduled_s})
    while not engine.over:
        engine.advance()
    return words, engine.time_s


def test_a_time_that_can_be_met_is_met():
    words, arrived_s = told_at(20.0, 125.0)
    assert words == "told to arrive later: after 125 s"
    assert arrived_s == pytest.approx(125.0, abs=1.0)


@pytest.mark.parametrize(("at_s", "scheduled_s"), [(40.0, 80.0), (89.0, 125.0)], ids=["sooner", "braking"])
def test_where_a_time_cannot_be_met_it_says_which_can(at_s, scheduled_s):
    words, arrived_s = told_at(at_s, scheduled_s)
    said = float(re.search(r"; from here it can be there after (\d+\.\d) s$", words)[1])
    assert abs(said - scheduled_s) > 3.0
    assert arrived_s == pytest.approx(said, abs=2.0)


def test_where_no_plan_is_found_it_says_so_and_drives_on(monkeypatch):
    def none(*_):
        raise SolverError("the plan's solver stopped: NumericalError")

    monkeypatch.setattr("metropilot.web.live.engine.optimal_plan", none)
    words, arrived_s = told_at(20.0, 125.0)
    assert words.endswith("after 125 s; no plan from here is found for that")
    assert arrived_s > 0
