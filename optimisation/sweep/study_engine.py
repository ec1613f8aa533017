"""Runs of sweeps on the workbench's engine: a run that kills its worker is a row with an error."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, TypeVar

from aerodima.optimisation.sweep.study_task import WORKER_LOST, RunTask, evaluate, failed_row
from aerodima.workbench import batch
from aerodima.workbench.errors import UserError

Item = TypeVar("Item")
Result = TypeVar("Result")
Done = Callable[[int, Any], None]
"""Told the place of a finished item and its result, in the order in which they finish."""

WORKER_LOST_AGAIN = (
    f"{WORKER_LOST} again and again, also alone in the cluster (out of memory, or a crash in the solver)"
)


class SweepError(UserError):
    """A sweep cannot go on: a folder in use, a damaged or full one, a study that is none."""


class Engine(Protocol):
    """Runs work; results come in the order of the items."""

    @property
    def workers(self) -> int:
        """How many pieces of work are done at a time."""

    @property
    def startup(self) -> float:
        """Time from the opening until the workers were ready to simulate, s."""

    def rows(self, tasks: Sequence[RunTask], done: Done | None = None) -> list[dict[str, Any]]:
        """`evaluate` of each task; a task that kills its worker gives a row with an error."""

    def call(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """`function` (of a module) of each item; raises what it raises, and UserError when it kills its worker."""


class RunEngine:
    """On an engine of the workbench; see `Engine`, and `open_engine` for one with workers."""

    def __init__(self, engine: batch.Engine) -> None:
        self._engine = engine
        self.startup = engine.startup

    @property
    def workers(self) -> int:
        """See `Engine`."""
        return self._engine.workers

    def rows(self, tasks: Sequence[RunTask], done: Done | None = None) -> list[dict[str, Any]]:
        """See `Engine`."""
        return self._engine.map(evaluate, tasks, done, lambda task: failed_row(task, WORKER_LOST_AGAIN))

    def call(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """See `Engine`."""
        return self._engine.map(function, items)


class SerialEngine(RunEngine):
    """In this process, one after the other: for small work, and for tests."""

    def __init__(self) -> None:
        super().__init__(batch.SerialEngine())


@contextmanager
def open_engine(
    workers: int = 2,
    scheduler: str | None = None,
    *,
    say: Callable[[str], None] | None = None,
    record: Path | None = None,
    memory: float | None = None,
) -> Iterator[RunEngine]:
    """`aerodima.workbench.batch.open_engine`, ready to simulate."""
    with batch.open_engine(
        workers, scheduler, say=say, record=record, memory=memory, module="aerodima.workbench.simulate.car_run"
    ) as engine:
        yield RunEngine(engine)
