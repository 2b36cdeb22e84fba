"""Whatever is done to a file, one line comes out or something usable; what once broke one is replayed."""

from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fuzz.mutate import damaged
from tests.fuzz.targets import TARGETS, check

CORPUS = Path(__file__).with_name("corpus")
KEPT = sorted(path for path in CORPUS.glob("*/*") if path.is_file())
# beartype draws at random which items of a collection it checks.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")


@pytest.mark.parametrize("name", TARGETS)
def test_real_files_are_read(name):
    assert all(check(name, data) for data in TARGETS[name].seeds())


@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=40, suppress_health_check=list(HealthCheck))
@given(number=st.integers(0, 2**32 - 1), again=st.booleans())
def test_damaged_files_are_one_line(name, number, again):
    target, random = TARGETS[name], Random(number)
    data = damaged(random.choice(target.seeds()), target.kind, random)
    check(name, damaged(data, target.kind, random) if again else data)


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_once_broke_a_loader(path):
    check(path.parent.name, path.read_bytes())


def test_the_corpus_is_of_targets_that_there_are():
    assert len(KEPT) >= 10
    assert {path.parent.name for path in KEPT} <= set(TARGETS)
