"""Fixtures of the whole suite, and the durations of its tests.

The runs that many tests look at are made once.
"""

import fcntl
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.durations import write_durations


class StandardRuns(Mapping[str, Any]):
    """The published left turn at 3.33 m/s: `none`, `held`, `swing` and `designed` -> RunLog.

    A run is made when it is first asked for, by one process of the suite for all.
    """

    _MODES = ("none", "held", "swing", "designed")

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._logs: dict[str, Any] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._MODES)

    def __len__(self) -> int:
        return len(self._MODES)

    def __getitem__(self, mode: str) -> Any:
        if mode not in self._logs:
            self._logs[mode] = self._made(mode)
        return self._logs[mode]

    def _made(self, mode: str) -> Any:
        from aerodima.workbench.batch.simulation import simulate
        from aerodima.workbench.logs.schema import read_run_log
        from aerodima.workbench.scenario.scenario import load_scenario

        path = self._folder / f"turn_{mode}.parquet"
        with (self._folder / f"{mode}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                simulate(load_scenario(f"turn_{mode}", ["manoeuvre.speed=3.33"]), path)
        return read_run_log(path)


@pytest.fixture(scope="session")
def standard_runs(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> StandardRuns:
    """See `StandardRuns`; the processes of one suite share a folder."""
    folder = tmp_path_factory.getbasetemp()
    if worker_id != "master":
        folder = folder.parent
    folder = folder / "standard_runs"
    folder.mkdir(exist_ok=True)
    return StandardRuns(folder)


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Stores how long each test took, with its fixtures: `out/tests/durations.csv`."""
    write_durations(terminalreporter.stats, config.rootpath / "out" / "tests" / "durations.csv")
