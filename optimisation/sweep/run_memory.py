"""An engine that remembers on the disk what it has run: a leaderboard can be stopped and go on, or be widened."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

from aerodima.optimisation.sweep.study_engine import Done, Engine
from aerodima.optimisation.sweep.study_store import ResultStore
from aerodima.optimisation.sweep.study_task import RunTask
from aerodima.workbench.controllers.law_of_scenario import find_swing

Say = Callable[[str], None]


class RememberingEngine:
    """Runs a task only if its store does not hold it yet; an `Engine`.

    Args:
        engine: where new tasks are run.
        store: open; its identity covers everything that a task does not name (versions, defaults).
        say: told lines of progress.
        stage: what is being run, for these lines; may be changed on the way.
    """

    def __init__(self, engine: Engine, store: ResultStore, say: Say, stage: str = "runs") -> None:
        self._engine, self._store, self._say = engine, store, say
        self._known = store.rows()
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
        """See `Engine`; the row of a remembered task carries the name of this one."""
        keys = [task_key(task) for task in tasks]
        missing = {key: task for key, task in zip(keys, tasks, strict=True) if key not in self._known}
        places = list(missing)

        def keep(place: int, row: dict[str, Any]) -> None:
            self._known[places[place]] = row
            self._store.add(places[place], row)
            self.ran += 1
            if self.ran % 20 == 0:
                self._say(f"{self.stage}: {self.ran} runs made")

        try:
            self._engine.rows(list(missing.values()), keep)
        finally:
            self._store.flush()
        rows = [self._known[key] | {"run": task.name} for key, task in zip(keys, tasks, strict=True)]
        for place, row in enumerate(rows):
            if done is not None:
                done(place, row)
        return rows

    def call(self, function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """See `Engine`; not remembered."""
        return self._engine.call(function, items)


def task_key(task: RunTask) -> int:
    """Place of a task in the store: the same for the same run, whatever it is called; another swing is another run."""
    text = json.dumps([task.scenario, list(task.settings), task.signals])
    played = [s.partition("=")[2] for s in task.settings if s.startswith("controller.swing_file=")]
    text += "".join(_content(path) for path in played if path != "none")
    return int(hashlib.sha256(text.encode()).hexdigest()[:13], 16)


@cache
def _content(path_or_name: str) -> str:
    return hashlib.sha256(find_swing(path_or_name).model_dump_json().encode()).hexdigest()
