"""One pair of worker processes for all tests of the engine: starting them takes seconds."""

import pytest

from aerodima.optimisation.studies.runs import open_run_engine


@pytest.fixture(scope="package")
def engine():
    with open_run_engine(2) as opened:
        yield opened
