"""An engine that remembers on the disk what it has run, so that work can be stopped and go on, or be widened."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from aerodima.optimisation.sweep.study_engine import Done, Engine
from aerodima.optimisation.sweep.study_task import RunTask
from aerodima.workbench.batch.progress import Progress
from aerodima.workbench.batch.row_store import RowStore, content_key
from aerodima.workbench.batch.worker_record import Say
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.law_of_scenario import NO_SWING, find_swing
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import software_versions


class RememberingEngine:
    """Runs a task only if its store does not hold it yet; an `Engine`.

    Args:
        engine: where new tasks are run.
        store: open.
        say: told lines of progress.
        stage: what is being run, for these lines; may be changed on the way.
    """

    def __init__(self, engine: Engine, store: RowStore, say: Say | None = None, stage: str = "") -> None:
        self._engine, self.store, self._say = engine, store, say or (lambda _line: None)
        self.stage = stage
        self.ran = 0

    @property
    def workers(self) -> int:
        """See `Engine`."""
        return self._engine.workers

    @property
    def startup(self) -> float:
        """See `Engine`."""
        return self._engine.startup

    def rows(self, tasks: Sequence[RunTask], done: Done | None = None) -> list[dict[str, Any]]:
        """See `Engine`; the row of a remembered task carries the name of this one, and `done` is told of new ones."""
        keys = [run_key(task) for task in tasks]
        known = self.store.rows
        missing = {key: task for key, task in zip(keys, tasks, strict=True) if key not in known}
        places = list(missing)
        progress = Progress(self._say, len(set(keys)), len(set(keys)) - len(missing))

        def keep(place: int, row: dict[str, Any]) -> None:
            self.store.add(places[place], row)
            self.ran += 1
            progress.one_more(f"{self.stage} {row['outcome'] or 'failed':8}".lstrip())
            if done is not None:
                done(place, row)

        self._engine.rows(list(missing.values()), keep)
        return [known[key] | {"run": task.name} for key, task in zip(keys, tasks, strict=True)]

    def call(self, function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """See `Engine`; not remembered."""
        return self._engine.call(function, items)


def run_key(task: RunTask) -> str:
    """The same for the same run, whatever it is called: of everything that determines its row, swing file included."""
    try:
        scenario = load_scenario(task.scenario, list(task.settings))
        content = [scenario.resolved(), _swing(scenario.controller.swing_file)]
    except UserError as error:
        content = [str(error)]
    return content_key(task.scenario, task.settings, task.signals, _versions(), content)


@cache
def _versions() -> dict[str, str]:
    return software_versions()


def _swing(name: str) -> str:
    path = Path(name)
    return "" if name == NO_SWING else _swing_content(name, path.stat().st_mtime_ns if path.is_file() else 0)


@lru_cache
def _swing_content(name: str, _changed: int) -> str:
    return find_swing(name).model_dump_json()
