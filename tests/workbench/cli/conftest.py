"""The program as a user calls it: `tests.commands`."""

import pytest

from tests import commands


@pytest.fixture(scope="session")
def call():
    """Runs `aerodima` with the given words; the result has exit_code, stdout and stderr."""
    return commands.call


@pytest.fixture(scope="session")
def refused():
    """Runs `aerodima` and returns the message of a user error."""
    return commands.refused


@pytest.fixture
def untouched(tmp_path):
    """A file that must keep its content."""
    path = tmp_path / "precious.parquet"
    path.write_text("precious")
    return path
