"""A live run stepped by hand: what it says to news it cannot meet."""

import re

import pytest

from metropilot.errors import InputError, SolverError
from metropilot.evaluate import RunSpec
from metropilot.planning import PlanOptions, optimal_plan
from metropilot.railway import Restriction, load_line, load_trainset
from metropilot.web.errors import Refused
from metropilot.web.live.engine import COLUMNS, HAND_S, Engine
from metropilot.web.pages.frame import clock

ROW = {name: k for k, name in enumerate(COLUMNS)}
TAKE, GIVE = ({"kind": "lever", "share": share, "holder": "one"} for share in (1.0, None))

WHERE = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101.0}


def told_at(time_s, scheduled_s):
    """Answer of a run to a new running time, and its arrival."""
    engine = Engine(RunSpec("yizhuang", "RJ", "WYJ", time_s=101.0))
    while engine.time_s < time_s:
        engine.advance()
    words = engine.apply({"kind": "arrival", "scheduled_time_s": scheduled_s})
    while not engine.over:
        engine.advance()
    return words, engine.time_s


def test_a_time_that_can_be_met_is_met():
    words, arrived_s = told_at(20.0, 125.0)
    assert words == "new arrival time, later: after 125 s"
    assert arrived_s == pytest.approx(125.0, abs=1.0)


@pytest.mark.parametrize(("at_s", "scheduled_s"), [(40.0, 80.0), (95.0, 125.0)], ids=["sooner", "braking"])
def test_where_a_time_cannot_be_met_it_says_which_can(at_s, scheduled_s):
    words, arrived_s = told_at(at_s, scheduled_s)
    said = float(re.search(r"; (?:earliest|latest) possible arrival from here: after (\d+\.\d) s$", words)[1])
    assert abs(said - scheduled_s) > 3.0
    assert arrived_s == pytest.approx(said, abs=2.0)


def test_where_no_plan_is_found_it_says_so_and_drives_on(monkeypatch):
    def none(*_):
        raise SolverError("the plan's solver stopped: NumericalError")

    monkeypatch.setattr("metropilot.web.live.engine.optimal_plan", none)
    words, arrived_s = told_at(20.0, 125.0)
    assert words.endswith("after 125 s; no plan from here meets it")
    assert arrived_s > 0


def until(engine, time_s):
    """Step a run; its last row."""
    row = []
    while engine.time_s < time_s and not engine.over:
        row = engine.advance()
    return row


def planned_j(time_s, position_m, *restrictions):
    """Energy of the optimal plan from departure up to a position, found without a live run."""
    section = load_line("yizhuang").section("RJ", "WYJ")
    for restriction in restrictions:
        section = section.with_restriction(restriction)
    plan = optimal_plan(section, load_trainset("dkz32"), time_s, PlanOptions(late_w=500.0))
    used_j = 0.0
    for k, force_n in enumerate(plan.traction_n):
        start, end = plan.position_m[k], plan.position_m[k + 1]
        if position_m <= start:
            break
        used_j += force_n * (min(position_m, end) - start)
    return used_j


def position_and_plan(row):
    """Position of a run, and the energy of the reference plan there by its row."""
    return row[ROW["position_m"]], row[ROW["plan_energy_wheel_j"]]


def test_a_run_is_compared_with_the_plan_from_departure_whatever_the_lever_did():
    engine = Engine(RunSpec("yizhuang", "RJ", "WYJ", time_s=101.0))
    at_m, planned = position_and_plan(until(engine, 45.0))
    assert planned == pytest.approx(planned_j(101.0, at_m), rel=1e-3)
    before = engine.scene()["reference"]
    engine.apply(TAKE)
    at_m, planned = position_and_plan(until(engine, 51.0))
    assert planned == pytest.approx(planned_j(101.0, at_m), rel=1e-3)
    engine.apply(GIVE)
    assert engine.scene()["reference"] == before
    at_m, planned = position_and_plan(row := until(engine, 60.0))
    assert planned == pytest.approx(planned_j(101.0, at_m), rel=1e-3)
    assert row[ROW["energy_wheel_j"]] > 1.05 * planned, "full power for 6 s shows"
    row = until(engine, 300.0)
    assert row[ROW["plan_energy_wheel_j"]] == pytest.approx(planned_j(101.0, 1e9), rel=1e-3)


def test_a_run_is_compared_with_the_plan_for_what_is_in_force():
    engine = Engine(RunSpec("yizhuang", "RJ", "WYJ", time_s=101.0))
    until(engine, 20.0)
    engine.apply({"kind": "arrival", "scheduled_time_s": 125.0})
    at_m, planned = position_and_plan(until(engine, 40.0))
    assert planned == pytest.approx(planned_j(125.0, at_m), rel=1e-3)
    restriction = Restriction(900.0, 1000.0, 8.0)
    engine.apply({"kind": "restriction", "from_m": 900.0, "to_m": 1000.0, "limit_mps": 8.0})
    at_m, planned = position_and_plan(until(engine, 300.0))
    assert planned == pytest.approx(planned_j(125.0, at_m, restriction), rel=1e-3)
    assert engine.scene()["reference"]["running_time_s"] == pytest.approx(125.0, abs=0.1)


@pytest.mark.parametrize(
    ("from_m", "to_m", "kmh", "words"),
    [
        (900.0, 9000.0, 40.0, "ends beyond the stop"),
        (5000.0, 9000.0, 40.0, "begins beyond the stop"),
        (900.0, 1000.0, 80.0, "no effect"),
        (900.0, 1000.0, 2.0, "5 to 400 km/h"),
    ],
)
def test_a_restriction_is_checked_on_the_way_as_before_departure(from_m, to_m, kmh, words):
    engine = Engine(RunSpec("yizhuang", "RJ", "WYJ", time_s=101.0))
    with pytest.raises(InputError, match=words) as refused:
        engine.apply({"kind": "restriction", "from_m": from_m, "to_m": to_m, "limit_mps": kmh / 3.6})
    with pytest.raises(InputError, match=words) as before:
        RunSpec.from_values(WHERE | {"restrictions": [f"{from_m}-{to_m}@{kmh}"]}).run()
    told = re.sub("^(restriction|limit_mps):", "restrictions:", str(refused.value))  # a request has a list
    assert told == str(before.value)
    assert engine.rollout.section.restrictions == ()
    assert engine.news == []


def test_news_that_the_request_brings_is_in_force_when_it_is_told():
    request = RunSpec.from_values(WHERE | {"arrivals": ["125@20"]})
    engine = Engine(request)
    at_m, planned = position_and_plan(until(engine, 19.0))
    assert planned == pytest.approx(planned_j(101.0, at_m), rel=1e-3)
    assert engine.pop_updates() == []
    at_m, planned = position_and_plan(until(engine, 40.0))
    assert planned == pytest.approx(planned_j(125.0, at_m), rel=1e-3)
    assert engine.pop_updates() == ["new arrival time, later: after 125 s"]


def test_a_plan_that_is_drawn_keeps_its_times():
    engine = Engine(RunSpec("yizhuang", "RJ", "WYJ", time_s=101.0))
    before = engine.scene()["plan"]
    until(engine, 20.0)
    engine.apply(TAKE)
    assert engine.scene()["plan"] == before
    until(engine, 22.0)
    engine.apply(GIVE)
    again = engine.scene()["plan"]
    assert again["time_s"][0] == pytest.approx(engine.time_s, abs=1e-3)
    assert again["time_s"][-1] == pytest.approx(101.0, abs=0.2)


def test_the_lever_has_one_holder(monkeypatch):
    engine = Engine(RunSpec("yizhuang", "RJ", "WYJ", time_s=101.0))
    until(engine, 10.0)
    other = {**TAKE, "share": -1.0, "holder": "two"}
    assert engine.apply(TAKE) == "the lever is taken by hand by one"
    for refused in (other, {**GIVE, "holder": "two"}, {**TAKE, "holder": "two"}):
        assert not engine.holds(refused)
        with pytest.raises(Refused, match=r"held by one since 10\.2 s"):
            engine.apply(refused)
    assert engine.rollout.by_hand == 1.0
    assert engine.apply({**other, "take_over": True}) == "the lever is taken over from one by two"
    assert engine.lever() == {"holder": "two", "since_s": engine.time_s}
    with pytest.raises(Refused, match="held by two"):
        engine.apply(GIVE)
    late = engine.renewed + HAND_S
    monkeypatch.setattr("metropilot.web.live.engine.monotonic", lambda: late - 0.1)
    assert not engine.lever_expired()
    monkeypatch.setattr("metropilot.web.live.engine.monotonic", lambda: late + 0.1)
    assert engine.lever_expired()
    assert engine.apply({**GIVE, "take_over": True}) == "the lever is returned to the driver"
    assert engine.lever() is None


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [(0.0, "0:00.0"), (59.94, "0:59.9"), (59.96, "1:00.0"), (2399.97, "40:00.0"), (61.25, "1:01.2")],
)
def test_minutes_and_seconds_are_rounded_before_they_are_parted(seconds, shown):
    assert clock(seconds) == shown
