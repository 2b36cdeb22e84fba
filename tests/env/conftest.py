"""One task of each kind that tests need, made once a process."""

import functools

import pytest

from metropilot.env import make_task


@pytest.fixture(scope="session")
def tasks():
    return functools.cache(make_task)
