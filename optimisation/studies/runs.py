"""Runs of the car and of the rigs as tasks with flat rows: many of them on an engine, each made
once.

A run that kills its worker gives a row with an error. Rows are kept on the disk, so that work can
be stopped and go on, or be extended.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

import pandas as pd

from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import (
    ProgressBar,
    ProgressLine,
    Row,
    RowStore,
    content_key,
    no_progress,
    print_resume_hint,
)
from aerodima.workbench.control.swing_library import NO_SWING, find_swing
from aerodima.workbench.control.user_law import in_words, load_law
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.file_reading import Facts, Settings
from aerodima.workbench.core.yaml_files import checked, read_yaml
from aerodima.workbench.logs.schema import RunLog, software_versions
from aerodima.workbench.scenario.rig_scenario import RigScenario
from aerodima.workbench.scenario.scenario import Scenario, default_values

FINE_STEP = 0.0005
"""Step of the plant at which claims are made, s; a fourth of that of ordinary runs."""
WORKER_LOST = (
    "its worker process was lost again and again, also alone in the cluster (out of memory, or "
    "a crash in the solver)"
)
"""Error of a run whose worker died under it."""
RUN_ERRORS = (UserError, ArithmeticError, RuntimeError, ValueError)
"""Errors of a run that cannot be made; a law of the user's may raise anything."""
Item = TypeVar("Item")
TEXT_COLUMNS = frozenset(
    [
        "axis",
        "block",
        "direction",
        "error",
        "kind",
        "log",
        "member",
        "outcome",
        "run",
        "scenario",
        "scenario_sha256",
        "settings",
        "signals",
        "tail",
        "tail_mode",
        "touched",
    ]
)
"""Columns that are text even where no row has one."""


@dataclass(frozen=True)
class RunTask:
    """One run, small enough to send anywhere; files that it names must be there where it runs.

    Attributes:
        name: name of the run within its study.
        scenario: name or path of the scenario, as for `load_any_scenario`.
        settings: overrides of the scenario, such as `car.tyre_friction=0.7`.
        signals: `outcome`, or `all`, which also gives the impulses of the tail, at twice the price.
        log: file in which the log of the run is kept, in place of one that is there.
        law: `FILE:CLASS` of the law that drives the tail instead of the scenario's, as `load_law`
            takes it.
    """

    name: str
    scenario: str
    settings: Settings = ()
    signals: Literal["all", "outcome"] = "outcome"
    log: str = ""
    law: str = ""


def load_any_scenario(name_or_path: str, settings: Sequence[str] = ()) -> Scenario | RigScenario:
    """Loads a scenario of the car or of a rig, by its path or by the name of one that ships;
    ScenarioError as `load`.
    """
    path = Path(name_or_path)
    if path.is_file():
        is_rig = read_yaml(path).get("schema") == RigScenario.model_fields["schema_"].default
    else:
        is_rig = name_or_path in RigScenario.names()
    return (RigScenario if is_rig else Scenario).load(name_or_path, settings)


def step_settings(step: float) -> Settings:
    """Returns the settings for a step of the plant, s."""
    return (f"simulation.step={step!r}", f"simulation.log_rate={min(500.0, 1.0 / step):g}")


def evaluate(task: RunTask) -> Row:
    """Runs a task and returns one row of outcome, metrics and provenance, without anything that
    differs from time to time.

    A run that cannot be made (impossible scenario, plant that does not load, solver that gives up,
    NaN, any error in a law of the task) gives a row without outcome, with one line in `error`.
    Units are at the end of the names.
    """
    try:
        scenario = load_any_scenario(task.scenario, task.settings)
    except UserError as error:
        return failed_row(task, str(error))
    try:
        return _measured(task, scenario)
    except Exception as error:
        if task.law:
            return failed_row(task, in_words(error), scenario)
        if not isinstance(error, RUN_ERRORS):
            raise
        words = " ".join(str(error).split()) or type(error).__name__
        return failed_row(task, words, scenario)


def is_clean(row: Facts) -> bool:
    """Tells whether the row of a run shows clean survival."""
    return row["outcome"] == "survived" and bool(row["clean"])


def failed_row(task: RunTask, error: str, scenario: Scenario | RigScenario | None = None) -> Row:
    """Makes the row of a run without outcome; the columns of the metrics are missing in it."""
    return {"run": task.name, "outcome": None, "error": error, **_provenance(task, scenario)}


def _measured(task: RunTask, scenario: Scenario | RigScenario) -> Row:
    from aerodima.workbench.batch.simulation import simulate

    log = task.log or None
    if isinstance(scenario, RigScenario):
        run = simulate(scenario, log, force=True)
    else:
        law = load_law(task.law, scenario) if task.law else None
        record = "all" if log else task.signals
        run = simulate(scenario, log, record=record, stop_when_certain=True, law=law, force=True)
    return measured_row(task, scenario, run)


def measured_row(task: RunTask, scenario: Scenario | RigScenario, run: RunLog) -> Row:
    """Makes the row of a task whose scenario has been run, as `evaluate` does."""
    last = {"error": "", **_provenance(task, scenario)}
    if isinstance(scenario, RigScenario):
        facts = {name: run.extra[name] for name in ("tail", "axis", "wind_speed_m_per_s")}
        facts["angle_rad"] = scenario.experiment.angle
        truth = {f"true_{name}": value for name, value in run.extra["truth"].items()}
        row = {"run": task.name, "outcome": "measured", "kind": run.kind, **facts, **truth}
        return row | last
    from aerodima.workbench.car.termination import STOPPED
    from aerodima.workbench.car.tip_up import path_row, tip_up
    from aerodima.workbench.car.turn_course import turn_course
    from aerodima.workbench.car.turn_signals import steered_windows
    from aerodima.workbench.metrics.run_summary import summarise

    summary = summarise(run, scenario.name)
    windows = steered_windows(run.time, run.signal("steering_command_rad"))
    row = {
        "run": task.name,
        **summary.as_row(),
        **asdict(turn_course(run)),
        **asdict(tip_up(run, windows)),
        **path_row(run, scenario),
        "stopped_at_flip_s": run.extra.get(STOPPED),
    }
    if task.signals == "all":
        row |= summary.impulses_row()
        if run.has_tail:
            from aerodima.workbench.car.tail_impulses import CAUSES, tail_yaw_impulses

            yaw = tail_yaw_impulses(run)
            row |= {f"{cause}_yaw_impulse_window_n_m_s": getattr(yaw, cause) for cause in CAUSES}
    return row | last


def _provenance(task: RunTask, scenario: Scenario | RigScenario | None) -> Row:
    row: Row = {
        "scenario": task.scenario,
        "settings": " ".join(task.settings),
        "seed": None,
        "scenario_sha256": None,
    }
    if scenario is not None:
        resolved = json.dumps(scenario.resolved(), sort_keys=True)
        row["seed"] = scenario.seed
        row["scenario_sha256"] = hashlib.sha256(resolved.encode()).hexdigest()
    versions = sorted(software_versions().items())
    return row | {f"version_{name}": version for name, version in versions}


def open_run_engine(
    workers: int = 2, scheduler: str | None = None, **options: Any
) -> AbstractContextManager[Engine]:
    """Opens `aerodima.workbench.open_engine`, whose workers are ready to simulate; with its
    options.
    """
    from aerodima.workbench.batch.engine_factory import open_engine

    return open_engine(workers, scheduler, module="aerodima.workbench.car.car_run", **options)


class CachedRunner:
    """Runner that makes each task once and keeps its row.

    Args:
        engine: engine on which tasks are run; this process by default.
        store: open store that keeps rows on the disk and holds those of before. Without one this
            object remembers them, as it does rows of lost workers, which the next one tries again.
        progress: function that receives lines of progress.

    Attributes:
        say: function that receives lines of progress.
        stage: name of the work in progress, for these lines; set it on the way.
        ran: number of runs made by this object.
    """

    def __init__(
        self,
        engine: Engine | None = None,
        store: RowStore | None = None,
        progress: ProgressLine = no_progress,
    ) -> None:
        self._engine = engine or Engine()
        self._store = store
        self._known: dict[str, Row] = {} if store is None else dict(store.rows)
        self.say = progress
        self.stage = ""
        self.ran = 0

    def rows(self, tasks: Sequence[RunTask]) -> list[Row]:
        """Returns `evaluate` of each task, in order, under its own name; one that kills its worker
        gives a row with an error.
        """
        keys = [run_key(task) for task in tasks]
        rows = self._rows_by_key(evaluate, tasks, keys, partial(failed_row, error=WORKER_LOST))
        return [row | {"run": task.name} for task, row in zip(tasks, rows, strict=True)]

    def map(
        self, function: Callable[[Item], Any], items: Sequence[Item], keys: Sequence[str] = ()
    ) -> list[Any]:
        """Returns the result of a function for each item; raises what the function raises, and
        UserError for a lost worker.

        Args:
            function: module-level function of an item, whose result is JSON-able.
            items: items, each of which is worked on once.
            keys: keys of the results; by default made of the function's name, `repr` of the item
                and the code of its aim.
        """
        keys = keys or [
            content_key(function.__name__, repr(item), code_content(getattr(item, "aim", "")))
            for item in items
        ]
        rows = self._rows_by_key(partial(_result_of, function), items, keys)
        return [row["result"] for row in rows]

    def _rows_by_key(
        self,
        work: Callable[[Item], Row],
        items: Sequence[Item],
        keys: Sequence[str],
        lost: Callable[[Item], Row] | None = None,
    ) -> list[Row]:
        """Returns rows of items by their keys, with a line of progress for each new one."""
        by_key = dict(zip(keys, items, strict=True))
        missing = [key for key in by_key if key not in self._known]
        bar = ProgressBar(self.say, len(by_key), len(by_key) - len(missing))

        def keep(index: int, row: Row) -> None:
            self.ran += 1
            key = missing[index]
            self._known[key] = row
            if self._store is not None and row.get("error") != WORKER_LOST:
                self._store.add(key, row)
            if "result" not in row:
                bar.advance(f"{self.stage} {row['outcome'] or 'failed':8}".lstrip())
            elif self.stage:
                bar.advance(self.stage)

        self._engine.map(work, [by_key[key] for key in missing], keep, lost)
        return [self._known[key] for key in keys]


@contextmanager
def cached_runs(
    out: Path, engine: Engine, *, force: bool = False, progress: ProgressLine = no_progress
) -> Iterator[CachedRunner]:
    """Opens the runs kept in `runs.jsonl` of a folder, with these parameters and versions.

    Raises:
        UserError: the folder is in use, or holds runs of other parameters or versions and `force`
            is not set.
    """
    identity = {
        "schema": "aerodima/judge/1",
        "parameters": default_values(),
        "versions": software_versions(),
    }
    with RowStore(out / "runs.jsonl", identity, force=force) as store:
        runs = CachedRunner(engine, store, progress)
        with print_resume_hint(progress, lambda: f"{len(store.rows)} runs"):
            yield runs
        progress(f"{runs.ran} runs made; {len(store.rows)} are in {out}")


def _result_of(function: Callable[[Any], Any], item: Any) -> Row:
    return {"result": function(item)}


def run_key(task: RunTask) -> str:
    """Hashes everything that determines the row of a run, swing and law included, but not its name.

    Modules that a law's file imports are not looked at.
    """
    content = scenario_content(task.scenario, task.settings) + code_content(task.law)
    return content_key(task.scenario, task.settings, task.signals, software_versions(), content)


def code_content(*places: str) -> list[str]:
    """Returns names and text of the user's code, such as `mine.py:my_aim`, for keys of cached
    results; other places have none.
    """
    content = []
    for place in places:
        path, found, name = place.rpartition(".py:")
        if found:
            content += [name, Path(f"{path}.py").read_text(encoding="utf-8")]
    return content


def scenario_content(name: str, settings: Sequence[str] = ()) -> list[Any]:
    """Returns the content of the files behind a scenario with overrides, those of its swing, tail,
    bodies and coefficients included, for keys of cached results.
    """
    try:
        scenario = load_any_scenario(name, settings)
        if isinstance(scenario, RigScenario):
            return [scenario.resolved(), ""]
        swing = scenario.controller.swing_file
        content = "" if swing == NO_SWING else find_swing(swing).model_dump_json()
        names = [scenario.tail.geometry, scenario.tail.coefficients, scenario.car.bodies]
        if scenario.car.has_bodies:
            from aerodima.workbench.car.car_bodies import CarBodies

            bodies = checked(CarBodies, read_yaml(Path(names[-1])), names[-1]).bodies
            names += [body.coefficients for body in bodies]
        files = [Path(name).read_bytes() for name in names if Path(name).is_file()]
        return [scenario.resolved(), content, *files]
    except UserError as error:
        return [str(error)]


def make_frame(rows: Sequence[Row]) -> pd.DataFrame:
    """Makes one table of rows with different keys: numbers as float, truth values as boolean,
    everything else as text.

    Columns are in the order of their first appearance, longest rows first; the kind of a column
    does not depend on the order of its rows.
    """
    names = list(dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row))
    return pd.DataFrame({name: _column(name, [row.get(name) for row in rows]) for name in names})


def _column(name: str, values: list[Any]) -> pd.Series:
    present = [value for value in values if value is not None]
    if name == "clean" or (present and all(isinstance(value, bool) for value in present)):
        return pd.Series(values, dtype="boolean")
    is_text = name in TEXT_COLUMNS or name.startswith("version_")
    if not is_text and all(isinstance(value, int | float) for value in present):
        return pd.Series(values, dtype="float64")
    return pd.Series([None if value is None else str(value) for value in values], dtype="str")
