"""The runs of sweeps: one run as a task and its flat row, engines that run many, and one that keeps their rows.

A run that kills its worker is a row with an error. Rows are kept on the disk, so that work can be stopped and go on, or
be widened.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

from aerodima.workbench import batch
from aerodima.workbench.batch.row_store import ProgressBar, ProgressLine, RowStore, content_key, on_stderr, silent
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.controllers.law_of_scenario import NO_SWING, find_swing
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import RunLog, software_versions

WORKER_LOST = "its worker process was lost"
"""Begins the error of a run whose worker died under it again and again."""

DRIVING = 0.9
"""Share of the commanded speed that a car must have reached when its turn begins."""


@dataclass(frozen=True)
class RunTask:
    """One run, small enough to send anywhere; files that it names must be there where it runs.

    Attributes:
        name: of the run within its study.
        scenario: name or path, as for `load_scenario`.
        settings: overrides, such as `car.tyre_friction=0.7`.
        signals: `all` also gives the impulses of the tail, at twice the price.
    """

    name: str
    scenario: str
    settings: tuple[str, ...] = ()
    signals: Literal["all", "outcome"] = "outcome"


def evaluate(task: RunTask) -> dict[str, Any]:
    """Runs a task; one row of outcome, metrics and provenance, without anything that differs from time to time.

    A run that cannot be made (impossible scenario, plant that does not load, solver that gives up, NaN) gives a row
    without outcome, with one line in `error`. Units are at the end of the names.
    """
    try:
        scenario = load_scenario(task.scenario, task.settings)
    except UserError as error:
        return failed_row(task, str(error))
    try:
        return _measured(task, scenario)
    except (UserError, ArithmeticError, RuntimeError, ValueError) as error:
        return failed_row(task, " ".join(str(error).split()) or type(error).__name__, scenario)


def tipped_before_turn(row: Mapping[Any, Any]) -> bool:
    """Whether a run flipped before its turn, so that it says nothing about the turn.

    A high car with its tail behind may tip over backwards while it gathers speed; it is slow, or lies, when the turn
    begins.
    """
    speed, commanded = row.get("speed_m_per_s"), row.get("commanded_speed_m_per_s")
    if row["outcome"] != "flipped" or speed is None or commanded is None:
        return False
    return float(speed) < DRIVING * float(commanded)


def failed_row(task: RunTask, error: str, scenario: Scenario | None = None) -> dict[str, Any]:
    """Row of a run that came to nothing; the columns of the metrics are missing in it."""
    return {"run": task.name, "outcome": None, "error": error, **_provenance(task, scenario)}


def _measured(task: RunTask, scenario: Scenario) -> dict[str, Any]:
    from aerodima.workbench.simulate.simulation import simulate

    return measured_row(task, scenario, simulate(scenario, record=task.signals, stop_when_certain=True))


def measured_row(task: RunTask, scenario: Scenario, run: RunLog) -> dict[str, Any]:
    """The row of a task whose scenario has been run, as `evaluate` gives it."""
    from aerodima.workbench.metrics.run_summary import summarise
    from aerodima.workbench.metrics.turn_course import turn_course
    from aerodima.workbench.stations.outcome_record import STOPPED

    summary = summarise(run, scenario.name)
    row = {
        "run": task.name,
        **summary.as_row(),
        **turn_course(run).as_row(),
        "stopped_at_flip_s": run.extra.get(STOPPED),
    }
    if task.signals == "all":
        row |= summary.impulses_row()
        if run.has_tail:
            from aerodima.workbench.metrics.tail_impulses import CAUSES, tail_yaw_impulses

            yaw = tail_yaw_impulses(run)
            row |= {f"{cause}_yaw_impulse_window_n_m_s": getattr(yaw, cause) for cause in CAUSES}
    return row | {"error": "", **_provenance(task, scenario)}


def _provenance(task: RunTask, scenario: Scenario | None) -> dict[str, Any]:
    resolved = None if scenario is None else json.dumps(scenario.resolved(), sort_keys=True)
    return {
        "scenario": task.scenario,
        "settings": " ".join(task.settings),
        "seed": None if scenario is None else scenario.seed,
        "scenario_sha256": None if resolved is None else hashlib.sha256(resolved.encode()).hexdigest(),
        **{f"version_{name}": version for name, version in sorted(software_versions().items())},
    }


Item = TypeVar("Item")
Result = TypeVar("Result")
Done = Callable[[int, Any], None]
"""Told the place of a finished item and its result, in the order in which they finish."""

WORKER_LOST_AGAIN = (
    f"{WORKER_LOST} again and again, also alone in the cluster (out of memory, or a crash in the solver)"
)


class RunEngine(Protocol):
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


class BatchRunEngine:
    """On an engine of the workbench; see `RunEngine`, and `open_run_engine` for one with workers."""

    def __init__(self, engine: batch.Engine) -> None:
        self._engine = engine
        self.startup = engine.startup

    @property
    def workers(self) -> int:
        """See `RunEngine`."""
        return self._engine.workers

    def rows(self, tasks: Sequence[RunTask], done: Done | None = None) -> list[dict[str, Any]]:
        """See `RunEngine`."""
        return self._engine.map(evaluate, tasks, done, lambda task: failed_row(task, WORKER_LOST_AGAIN))

    def call(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """See `RunEngine`."""
        return self._engine.map(function, items)


class SerialRunEngine(BatchRunEngine):
    """In this process, one after the other: for small work, and for tests."""

    def __init__(self) -> None:
        super().__init__(batch.SerialEngine())


@contextmanager
def open_run_engine(
    workers: int = 2,
    scheduler: str | None = None,
    *,
    progress: ProgressLine = on_stderr,
    record: str | Path | None = None,
    memory: float | None = None,
) -> Iterator[BatchRunEngine]:
    """`aerodima.workbench.batch.open_engine`, ready to simulate."""
    with batch.open_engine(
        workers,
        scheduler,
        progress=progress,
        record=record,
        memory=memory,
        module="aerodima.workbench.simulate.car_run",
    ) as engine:
        yield BatchRunEngine(engine)


class RememberingEngine:
    """Runs a task only if its store does not hold it yet; a `RunEngine`.

    Args:
        engine: where new tasks are run.
        store: open.
        progress: told lines of progress.
        stage: what is being run, for these lines; may be changed on the way.
    """

    def __init__(self, engine: RunEngine, store: RowStore, progress: ProgressLine = silent, stage: str = "") -> None:
        self._engine, self.store, self._progress = engine, store, progress
        self.stage = stage
        self.ran = 0
        self._whole: ProgressBar | None = None
        self._counted: set[str] = set()

    @property
    def workers(self) -> int:
        """See `RunEngine`."""
        return self._engine.workers

    @property
    def startup(self) -> float:
        """See `RunEngine`."""
        return self._engine.startup

    def expect(self, pieces: int) -> None:
        """Runs and remembered calls count towards about so many of the whole work from now on, in lines of progress."""
        self._whole = ProgressBar(self._progress, pieces)

    def _bar(self, keys: Sequence[str], missing: Mapping[str, Any]) -> ProgressBar:
        """Of the whole work, or where nobody knows that of this part; what is there already is counted once."""
        wanted = set(keys)
        if self._whole is None:
            return ProgressBar(self._progress, len(wanted), len(wanted) - len(missing))
        self._whole.skip(len(wanted - self._counted - missing.keys()))
        self._counted |= wanted
        return self._whole

    def rows(self, tasks: Sequence[RunTask], done: Done | None = None) -> list[dict[str, Any]]:
        """See `RunEngine`; a remembered row carries the name of this task, and `done` is told of new ones."""
        keys = [run_key(task) for task in tasks]
        known = self.store.rows
        missing = {key: task for key, task in zip(keys, tasks, strict=True) if key not in known}
        places = list(missing)
        bar = self._bar(keys, missing)

        def keep(place: int, row: dict[str, Any]) -> None:
            self.store.add(places[place], row)
            self.ran += 1
            bar.one_more(f"{self.stage} {row['outcome'] or 'failed':8}".lstrip())
            if done is not None:
                done(place, row)

        self._engine.rows(list(missing.values()), keep)
        return [known[key] | {"run": task.name} for key, task in zip(keys, tasks, strict=True)]

    def call(self, function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """See `RunEngine`; not remembered."""
        return self._engine.call(function, items)

    def call_once(self, function: Callable[[Item], Any], items: Sequence[Item], keys: Sequence[str]) -> list[Any]:
        """`call`, JSON-able, of items whose key the store does not hold yet; of the others what it holds."""
        known = self.store.rows
        missing = {key: item for key, item in zip(keys, items, strict=True) if key not in known}
        bar = self._bar(keys, missing)
        for key, result in zip(missing, self._engine.call(function, list(missing.values())), strict=True):
            self.store.add(key, {"result": result})
            if bar is self._whole:
                bar.one_more("reduced cars")
        return [known[key]["result"] for key in keys]

    def say(self, line: str) -> None:
        """A line of progress."""
        self._progress(line)


def run_key(task: RunTask) -> str:
    """The same for the same run, whatever it is called: of everything that determines its row, swing file included."""
    content = scenario_content(task.scenario, task.settings)
    return content_key(task.scenario, task.settings, task.signals, _versions(), content)


def scenario_content(name: str, settings: Sequence[str] = ()) -> list[Any]:
    """What the files behind a scenario with overrides hold, its swing among them: for keys of what is remembered."""
    try:
        scenario = load_scenario(name, settings)
        return [scenario.resolved(), _swing(scenario.controller.swing_file)]
    except UserError as error:
        return [str(error)]


@cache
def _versions() -> dict[str, str]:
    return software_versions()


def _swing(name: str) -> str:
    path = Path(name)
    return "" if name == NO_SWING else _swing_content(name, path.stat().st_mtime_ns if path.is_file() else 0)


@lru_cache
def _swing_content(name: str, _changed: int) -> str:
    return find_swing(name).model_dump_json()
