import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metropilot.errors import InputError
from metropilot.units import KINDS, pick, unit

EVERY_UNIT = [(kind, name) for kind, table in KINDS.items() for name in table]


@pytest.mark.parametrize(
    ("kind", "name", "value", "si"),
    [
        ("length", "km", 1.25, 1250.0),
        ("speed", "km/h", 36.0, 10.0),
        ("mass", "t", 194.295, 194295.0),
        ("force", "kN", 203.0, 203e3),
        ("power", "MW", 2.0, 2e6),
        ("time", "min", 2.0, 120.0),
        ("gradient", "%", 2.4, 24.0),
        ("gradient", "‰", 24.0, 24.0),
        ("share", "%", 88.0, 0.88),
        ("acceleration", "m/s²", 1.0, 1.0),
        ("force per speed", "kN/(km/h)", 1.0, 3600.0),
        ("force per speed squared", "kN/(km/h)^2", 1.0, 12960.0),
        ("specific force", "N/kN", 1000.0, 9.81),
        ("stiffness", "MN/m", 5.0, 5e6),
    ],
)
def test_known_conversions(kind, name, value, si):
    assert unit(name, kind).to_si(value) == pytest.approx(si, rel=1e-15)


def test_80_kmh_is_the_same_number_everywhere():
    assert unit("km/h", "speed").to_si(80.0) == 80 / 3.6


@pytest.mark.parametrize(
    ("name", "words"), [(None, "missing unit"), ("mph", "unknown unit"), (3, "must be text")]
)
def test_a_unit_must_be_given_and_known(name, words):
    with pytest.raises(InputError, match=words) as caught:
        unit(name, "speed", file="f.toml", field="limits.units.speed")
    assert "f.toml: limits.units.speed" in caught.value.line()
    assert "allowed: speed in m/s, km/h" in caught.value.line()


@pytest.mark.parametrize(("kind", "name"), EVERY_UNIT)
@given(value=st.floats(-1e9, 1e9))
def test_written_numbers_read_back_nearly_and_picked_ones_exactly(kind, name, value):
    of = KINDS[kind][name]
    assert math.isclose(of.to_si(of.from_si(value)), value, rel_tol=1e-15, abs_tol=1e-300)
    convert, chosen = pick(kind, [value], name)
    assert KINDS[kind][chosen].to_si(convert(value)) == value


def test_people_get_the_unit_they_read():
    convert, name = pick("speed", [50 / 3.6, 80 / 3.6], "km/h")
    assert (name, convert(80 / 3.6)) == ("km/h", 80.0)


def test_arrays_convert_like_numbers():
    np.testing.assert_array_equal(unit("km", "length").to_si(np.array([1.0, 2.5])), [1000.0, 2500.0])
