"""Keys of trainsets, and the random ones: within their ranges, the same for ever, written and read back."""

import math
from dataclasses import fields

import numpy as np
import pytest

from metropilot.errors import InputError
from metropilot.railway import (
    TrainsetKey,
    drawn_trainset,
    load_trainset,
    parse_trainset,
    write_trainset,
)

DRAWN = [drawn_trainset(0, number) for number in range(1, 201)]


@pytest.mark.parametrize("load", ["least", "most"])
def test_every_drawn_trainset_is_within_its_ranges(load):
    for trainset in (one.with_load(load) for one in DRAWN):
        mass = trainset.effective_mass_kg
        assert 80e3 <= trainset.mass_kg <= 600e3
        assert 0.39 <= float(trainset.traction.at(0.0)) / mass <= 1.42
        assert 59.0 <= 3.6 * trainset.max_speed_mps <= 161.0
        assert 0.0 <= trainset.actuation.delay_s <= 1.0
        assert 0.0 <= trainset.actuation.lag_s <= 0.6
        full = float(trainset.electric_brake.at(0.0)) + trainset.friction_brake_n
        assert full >= trainset.service_deceleration_mps2 * mass * 0.99
        assert float(trainset.traction.at(trainset.max_speed_mps)) > 0.0


def test_drawn_trainsets_are_as_varied_as_announced():
    heavy = [one.with_load("most") for one in DRAWN]
    assert min(t.mass_kg for t in DRAWN) < 90e3
    assert max(t.mass_kg for t in heavy) > 550e3
    without_jerk = np.mean([math.isinf(t.actuation.jerk_limit_mps3) for t in DRAWN])
    unbounded = np.mean([math.isinf(t.max_acceleration_mps2) for t in DRAWN])
    assert 0.4 < without_jerk < 0.6
    assert 0.4 < unbounded < 0.6
    electric = np.array([float(t.electric_brake.at(0.0)) > 0 for t in DRAWN])
    friction = np.array([t.friction_brake_n > 0 for t in DRAWN])
    assert {(True, True), (True, False), (False, True)} == set(zip(electric, friction, strict=True))
    delay = np.array([t.actuation.delay_s for t in DRAWN])
    assert (delay == 0.0).any()
    assert delay.max() > 0.9


def test_a_drawn_trainset_is_written_and_read_back(tmp_path):
    for trainset in DRAWN[:20]:
        found = load_trainset(write_trainset(trainset, tmp_path / f"{trainset.id}.toml"))
        for field in fields(trainset):
            if field.name not in {"source", "extra", "unused"}:
                assert getattr(found, field.name) == getattr(trainset, field.name), field.name


def test_the_name_of_a_drawn_trainset_is_the_trainset():
    assert load_trainset("drawn-0-7") == drawn_trainset(0, 7) == DRAWN[6]
    assert load_trainset("drawn-0-7") != load_trainset("drawn-1-7")
    assert load_trainset("drawn-0-7:most").load == "most"


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("dkz32", TrainsetKey("dkz32")),
        ("dkz32:AW3", TrainsetKey("dkz32", None, "AW3")),
        ("dkz32@0.6,0.4", TrainsetKey("dkz32", (0.6, 0.4))),
        ("dkz32@0.6,0.4:AW3", TrainsetKey("dkz32", (0.6, 0.4), "AW3")),
        ("drawn-3-12@0,0:most", TrainsetKey("drawn-3-12", (0.0, 0.0), "most")),
        ("my/own.toml@1,0.5:full", TrainsetKey("my/own.toml", (1.0, 0.5), "full")),
        ("other:AW3", TrainsetKey("other:AW3")),
    ],
)
def test_keys(text, key):
    assert parse_trainset(text) == key
    assert str(key) == text


def test_a_declared_dead_time_replaces_the_own_one_and_nothing_else():
    own, late = load_trainset("dkz32:AW2"), load_trainset("dkz32@0.6,0.4:AW2")
    assert (late.actuation.delay_s, late.actuation.lag_s) == (0.6, 0.4)
    assert late.actuation.jerk_limit_mps3 == own.actuation.jerk_limit_mps3
    assert (late.load, late.mass_kg, late.traction) == (own.load, own.mass_kg, own.traction)
    assert late.id == "dkz32@0.6,0.4"


def test_a_load_given_twice_is_refused_where_it_differs():
    assert load_trainset("dkz32:AW2", "AW2").load == "AW2"
    with pytest.raises(InputError, match=r"load: the load is given twice: 'AW3' \(allowed: AW2, or none\)"):
        load_trainset("dkz32:AW2", "AW3")


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("dkz32@40,0", "dead time out of range.*dkz32@40,0.*0 to 5 s"),
        ("dkz32@0,40", "lag out of range"),
        ("dkz32@0.5", "not a dead time and a lag: 'dkz32@0.5'.*ID@DELAY,LAG, each 0 to 5 s"),
        ("dkz32@nan,0", "not a dead time and a lag"),
        ("dkz32@-1,0:AW2", "not a dead time and a lag"),
        ("dkz@0.5", "unknown trainset.*ID@DELAY,LAG"),
        ("drawn-1", "unknown trainset.*drawn-SEED-NUMBER"),
        ("drawn-0-1:AW0", "unknown load.*least, most"),
    ],
)
def test_a_key_that_names_nothing_is_one_line(key, words):
    with pytest.raises(InputError, match=words):
        load_trainset(key)
