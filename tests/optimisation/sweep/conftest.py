"""One pair of worker processes for all tests of the engine: starting them takes seconds."""

import pytest

from aerodima.optimisation.sweep.study_engine import open_engine


@pytest.fixture(scope="package")
def engine():
    with open_engine(2) as opened:
        yield opened
