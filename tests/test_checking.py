"""The checks that all tests run under: no wrong type or shape gets through, whichever way it is checked."""

import importlib
import sys

import jaxtyping
import numpy as np
import pytest
from tests import checking

MODULE = '''
from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


def half(x: float) -> float:
    return x / 2 if x > 0 else "none"


def later(x: Later) -> int:
    return 1


def lengths(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return x + y if x[0] > 0 else x[1:]


def nested(x: dict[str, tuple[Float[np.ndarray, " n"], ...]]) -> int:
    return len(x)


def counting(n: int) -> Iterator[int]:
    yield from range(n)


class Thing:
    """Methods of every kind."""

    def plain(self, x: int, *rest: int, key: str = "a") -> int:
        return x + len(rest) + len(key)

    @classmethod
    def of_class(cls, x: int) -> int:
        return x

    @staticmethod
    def of_none(x: int) -> int:
        return x

    @property
    def wrong(self) -> int:
        return "text"


@dataclass(frozen=True)
class Plain:
    length_m: float


@dataclass(frozen=True)
class Arrays:
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]


class Later(NamedTuple):
    x: int
'''


@pytest.fixture(scope="module")
def checked_module(tmp_path_factory):
    """A module of the checked package's name, which the import hook therefore takes for one of its own."""
    folder = tmp_path_factory.mktemp("package")
    (folder / "checked_example.py").write_text(MODULE)
    import metropilot

    metropilot.__path__.append(str(folder))
    try:
        yield importlib.import_module("metropilot.checked_example")
    finally:
        metropilot.__path__.remove(str(folder))
        sys.modules.pop("metropilot.checked_example", None)


TWO, THREE = np.ones(2), np.ones(3)


@pytest.mark.parametrize(
    "call",
    [
        lambda m: m.half("2"),
        lambda m: m.half(-1.0),  # what it returns
        lambda m: m.lengths(TWO, THREE),
        lambda m: m.lengths(-TWO, -TWO),  # what it returns
        lambda m: m.lengths(TWO.astype(int), TWO),
        lambda m: m.nested({"a": (np.ones((2, 2)),)}),
        lambda m: m.counting("3"),
        lambda m: m.Thing().plain("1"),
        lambda m: m.Thing().plain(1, "2"),
        lambda m: m.Thing().plain(1, key=2),
        lambda m: m.Thing.of_class("1"),
        lambda m: m.Thing.of_none("1"),
        lambda m: m.Thing().wrong,
        lambda m: m.Plain("3"),
        lambda m: m.Arrays(TWO, THREE),
    ],
)
def test_a_wrong_type_or_shape_is_refused(checked_module, call):
    with pytest.raises(jaxtyping.TypeCheckError):
        call(checked_module)


def test_what_is_right_goes_through(checked_module):
    assert checked_module.half(2.0) == 1.0
    assert checked_module.lengths(TWO, TWO).shape == (2,)
    assert checked_module.nested({"a": (TWO,)}) == 1
    assert list(checked_module.counting(2)) == [0, 1]
    assert checked_module.Thing().plain(1, 2, key="abc") == 5
    assert checked_module.Thing.of_class(1) == checked_module.Thing().of_none(1) == 1
    assert checked_module.Plain(3.0).length_m == 3.0
    assert checked_module.Arrays(TWO, TWO).x is TWO


def test_calls_are_checked_from_time_to_time_when_there_are_very_many(checked_module):
    for _ in range(10 * checking.FIRST):
        checked_module.half(2.0)
    refused = 0
    for _ in range(10 * checking.EVERY):
        try:
            checked_module.half(-1.0)
        except jaxtyping.TypeCheckError:
            refused += 1
    assert refused == 10
    checking.begin_test()
    with pytest.raises(jaxtyping.TypeCheckError):
        checked_module.half(-1.0)


def test_a_type_that_is_named_before_it_is_there_is_not_checked(checked_module):
    """As under jaxtyping's own hook: annotations are read when the function is made."""
    assert checked_module.later(checked_module.Later(1)) == 1


def test_metropilot_itself_is_checked():
    from metropilot.planning import round_up_time

    with pytest.raises(jaxtyping.TypeCheckError):
        round_up_time("fast")
