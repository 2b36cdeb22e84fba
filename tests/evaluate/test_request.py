"""A user's request: parsed, resolved, refused in one line."""

from dataclasses import replace

import pytest

from metropilot.errors import Infeasible, InputError
from metropilot.evaluate import RunSpec, run_from_toml
from metropilot.evaluate.run_spec import parse_arrival, parse_restriction
from metropilot.planning import minimum_running_time
from metropilot.sim import TimetableUpdate


def change_values(spec, **values):
    """The run with some of its plain values changed."""
    return RunSpec.from_values(spec.values() | values)


def test_time_defaults_to_the_plan():
    assert RunSpec("yizhuang", "rongjing", "wanyuan", driver="flat_out").run().scheduled_time_s == 101.0


def test_too_little_time_names_the_minimum(request_rj):
    with pytest.raises(Infeasible, match=r"minimum running time is \d+\.\d\d s"):
        replace(request_rj, time_s=10.0).run()


@pytest.mark.parametrize("time_s", [-5.0, 0.0, float("nan"), float("inf")])
def test_bad_times(request_rj, time_s):
    with pytest.raises(InputError, match="time"):
        replace(request_rj, time_s=time_s).run()


@pytest.mark.parametrize(
    "change",
    [
        {"mass_factor": float("nan")},
        {"mass_factor": -1.0},
        {"delay_s": -0.1},
        {"dt_s": 0.0},
        {"speed_noise_mps": 9.0},
    ],
)
def test_bad_scenarios(request_rj, change):
    with pytest.raises(InputError):
        change_values(request_rj, **change).run()


def test_a_restriction_makes_late_but_not_impossible(request_rj):
    run = change_values(request_rj, restrictions=("400-600@36",)).run()
    assert minimum_running_time(run.section, run.trainset) > run.scheduled_time_s


@pytest.mark.parametrize("seed", [-1, 10**400])
def test_bad_seed(request_rj, seed):
    """An integer that is too large for a float is refused as any other."""
    with pytest.raises(InputError, match="seed: out of range"):
        replace(request_rj, seed=seed)


def test_the_nearest_driver_is_named(request_rj):
    with pytest.raises(InputError, match="did you mean flat_out"):
        replace(request_rj, driver="flatout").make_driver()


def test_an_option_the_driver_does_not_take(request_rj):
    with pytest.raises(InputError, match="takes no options"):
        replace(request_rj, options={"colour": 1}).make_driver()
    with pytest.raises(InputError, match="did you mean patience_s"):
        replace(request_rj, driver="optimal", options={"patience": 1}).make_driver()
    with pytest.raises(InputError, match="a number"):
        replace(request_rj, driver="optimal", options={"patience_s": "long"}).make_driver()


def test_options_reach_the_driver(request_rj):
    driver = replace(request_rj, driver="optimal", options={"patience_s": 6}).make_driver()
    assert driver.options.patience_s == 6.0


def test_restrictions(request_rj):
    known = parse_restriction("400-600@36")
    assert (known.from_m, known.to_m, known.limit_mps) == (400, 600, 10)
    assert parse_restriction("400-600@36@30.5") == TimetableUpdate(30.5, restriction=known)
    asked = change_values(request_rj, restrictions=("400-600@36", "700-800@54@20"))
    assert [r.from_m for r in asked.section().restrictions] == [400]
    assert [n.at_s for n in asked.run().disturbance.updates] == [20]


@pytest.mark.parametrize(
    "text",
    [
        *("", "400", "400-600", "600-400@40", "400-600@0", "400-600@-5", "a-b@c", "5000-6000@40"),
        *("400-600@nan", "400-600@0.0001", "400-600@4.9", "400-600@500", "400-600@401@30", "400-1500@40"),
        *("400-600@80", "400-600@120@30"),
    ],
)
def test_bad_restrictions(request_rj, text):
    with pytest.raises(InputError, match="restriction"):
        change_values(request_rj, restrictions=(text,)).run()


def test_a_restriction_beside_another_is_held_to_the_lines_own_limit(request_rj):
    twice = change_values(request_rj, restrictions=("400-600@36", "400-600@36@20", "300-700@50")).run()
    assert [r.limit_mps for r in twice.section.restrictions] == [pytest.approx(10), pytest.approx(50 / 3.6)]
    assert len(twice.disturbance.updates) == 1
    with pytest.raises(InputError, match=r"no effect.*5 to below 80 km/h"):
        change_values(request_rj, restrictions=("400-600@36", "400-600@80@20")).run()


def test_arrivals():
    news = parse_arrival("116@30")
    assert (news.scheduled_time_s, news.at_s) == (116, 30)


@pytest.mark.parametrize("text", ["", "116", "20@30", "x@3", "-5@3"])
def test_bad_arrivals(text):
    with pytest.raises(InputError, match="arrive"):
        parse_arrival(text)


def test_resolved(request_rj):
    resolved = replace(request_rj, origin="rongjing", time_s=None, trainset="dkz32:AW2").resolve()
    assert (resolved.origin, resolved.time_s, resolved.trainset, resolved.load) == (
        "RJ",
        101.0,
        "dkz32",
        "AW2",
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no table"),
        ("[run", "not a run.toml"),
        ("run = 3", "no table"),
        ('[run]\nline = "yizhuang"\norigin = "RJ"', "destination"),
        ('[run]\nlime = "yizhuang"', "did you mean line"),
        ('[run]\nseed = "a"', "whole number"),
        ("[run]\nrestrictions = [1]", "list of texts"),
        ("[run]\ntime_s = true", "a number"),
    ],
)
def test_bad_run_files(tmp_path, text, words):
    path = tmp_path / "run.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        run_from_toml(path)


def test_no_run_file(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        run_from_toml(tmp_path / "run.toml")
