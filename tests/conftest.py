"""Fixtures of the whole suite, and the durations of its tests.

The runs that many tests look at are made once.
"""

from pathlib import Path
from typing import Any

import pytest

from tests.durations import write_durations


@pytest.fixture(scope="session")
def standard_runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The published left turn at 3.33 m/s by tail: `none`, `held`, `swing` and `designed` ->
    RunLog.
    """
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.simulate.simulation import simulate

    folder: Path = tmp_path_factory.mktemp("standard_runs")
    return {
        mode: simulate(
            load_scenario(f"turn_{mode}", ["manoeuvre.speed=3.33"]), folder / f"turn_{mode}.parquet"
        )
        for mode in ("none", "held", "swing", "designed")
    }


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Stores how long each test took, with its fixtures: `out/tests/durations.csv`."""
    write_durations(terminalreporter.stats, config.rootpath / "out" / "tests" / "durations.csv")
