"""Short simulated runs to replay: a turn that begins after 0.6 s, 0.9 s long."""

import pytest

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view.offscreen import check_renderer

SHORT = {"speed": 1.0, "turn_start": 0.6, "speed_ramp": 0.4, "turn_hold": 0.1, "duration": 0.9}
"""At 2.5 m/s2: harder, up to the tyres' friction, the short car lifts its front wheels."""


@pytest.fixture(scope="session")
def short_runs(tmp_path_factory):
    """Tail mode `none` and `swing` -> log; the tail does not swing yet, the car turns too
    slowly.
    """
    folder = tmp_path_factory.mktemp("short_runs")
    settings = [f"manoeuvre.{key}={value}" for key, value in SHORT.items()]
    return {
        mode: simulate(load_scenario(f"turn_{mode}", settings), folder / f"{mode}.parquet")
        for mode in ("none", "swing")
    }


@pytest.fixture
def tailed(short_runs):
    return short_runs["swing"]


@pytest.fixture
def tailless(short_runs):
    return short_runs["none"]


@pytest.fixture(scope="session")
def renderer():
    """Skips where Drake's VTK finds no OpenGL through EGL; `.ci/run` installs it."""
    try:
        check_renderer()
    except UserError as error:
        pytest.skip(str(error))
