"""One server for every test that leaves nothing behind that matters."""

import pytest
from tests.web.program import Server


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    """One server for every test that leaves nothing behind that matters."""
    made = Server(tmp_path_factory.mktemp("console"))
    yield made
    made.close()
