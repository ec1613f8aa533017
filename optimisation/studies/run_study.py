"""Execution of a study on an engine: missing runs are made, rows reach the disk as they come, and
one table is written at the end.

A study that was cut off at any time goes on with the runs that its rows lack, and makes those of
edited files again; with logs it is refused then. The table has nothing in it that differs from time
to time, so that it is the same however often the study was stopped and wherever it ran; the time
that the runs took is in a file beside it. Only one client at a time may use a folder.
"""

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from aerodima.optimisation.studies.runs import (
    CachedRunner,
    RunTask,
    load_any_scenario,
    make_frame,
    run_key,
)
from aerodima.optimisation.studies.study import PlannedRun, Study, check_factors, plan_runs
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import (
    ProgressLine,
    RowStore,
    no_progress,
    print_resume_hint,
)
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.file_reading import Facts, Json
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.scenario.scenario import default_values

STUDY_RUNS_SCHEMA = "aerodima/sweep/2"
TABLE = "table.parquet"
CSV = "table.csv"
MARK = "study.json"
ROWS = "rows.jsonl"
TIMING = "timing.json"
METADATA_KEY = b"aerodima"


def run_study(
    study: Study,
    out: str | Path,
    engine: Engine,
    *,
    force: bool = False,
    progress: ProgressLine = no_progress,
) -> pd.DataFrame:
    """Runs a study and returns its table; one that was stopped goes on where it was.

    Args:
        study: study that is run.
        out: folder of the results; see `aerodima.optimisation.studies.run_study`.
        engine: engine on which the study is run.
        force: whether to drop results that are there.
        progress: function that receives lines of progress.

    Returns:
        One row per run in the order of the plan: place in the study, outcome, metrics, provenance,
            error.

    Raises:
        SweepError: unknown factor; the folder is in use, holds another study, or its disk is full.
    """
    check_factors(study, study.name)
    out = Path(out)
    runs = plan_runs(study)
    identity = _identity(study, runs)
    with RowStore(out / ROWS, identity, force=force, alone=True, error=SweepError) as store:
        tasks = [run.task for run in runs]
        if study.logs:
            tasks = _with_logs(out, runs, store, force)
        there = sum(run_key(task) in store.rows for task in tasks)
        number = len(runs)
        if there == number and (out / TABLE).is_file():
            progress(f"{out}: complete already, {number} runs")
            return read_table(out)
        (out / TABLE).unlink(missing_ok=True)
        progress(
            f"{number} runs, {there} there already; {engine.workers} at a time, results in {out}"
        )
        start = time.monotonic()
        runner = CachedRunner(engine, store, progress)
        with print_resume_hint(progress, lambda: f"{there + runner.ran} of {number} runs"):
            rows = runner.rows(tasks)
        seconds = time.monotonic() - start
        frame = make_frame([run.place | row for run, row in zip(runs, rows, strict=True)])
        timing = {
            "runs_of_the_last_call": runner.ran,
            "wall_time_of_the_last_call_s": seconds,
            "startup_of_the_workers_s": engine.startup,
            "workers": engine.workers,
        }
        write_table(out, frame, identity, timing)
    progress(_how_it_went(frame, runner.ran, seconds, engine))
    return frame


def _identity(study: Study, runs: Sequence[PlannedRun]) -> Json:
    """Returns the facts that must be the same for results to belong together; of a study with logs
    also the keys of its runs, since a log does not say of which content of their files it is.
    """
    tasks = json.dumps([[asdict(run), study.logs and run_key(run.task)] for run in runs])
    bases = {
        name: load_any_scenario(name).resolved()
        for name in sorted({run.task.scenario for run in runs})
    }
    inputs = json.dumps([default_values(), bases], sort_keys=True)
    return {
        "schema": STUDY_RUNS_SCHEMA,
        "study": study.model_dump(mode="json", by_alias=True),
        "runs": hashlib.sha256(tasks.encode()).hexdigest(),
        "inputs": hashlib.sha256(inputs.encode()).hexdigest(),
        "versions": software_versions(),
    }


def _with_logs(
    out: Path, runs: Sequence[PlannedRun], store: RowStore, force: bool
) -> list[RunTask]:
    """Makes tasks that keep their logs; a run whose log is missing is made again."""
    tasks = []
    for run in runs:
        path = out / str(run.place["log"])
        if force:
            path.unlink(missing_ok=True)
        tasks.append(replace(run.task, log=str(path)))
        if not path.exists():
            store.rows.pop(run_key(run.task), None)
    return tasks


def _how_it_went(frame: pd.DataFrame, number: int, seconds: float, engine: Engine) -> str:
    failed = frame["error"].fillna("") != ""
    outcomes = frame["outcome"].value_counts()
    text = ", ".join(f"{count} {name}" for name, count in sorted(outcomes.items()))
    line = f"{text or 'no outcome'}; {number} runs in {seconds:.1f} s on {engine.workers} worker(s)"
    line += f", after {engine.startup:.1f} s to start them"
    if failed.any():
        line += f"; {int(failed.sum())} failed, the first: {frame.loc[failed, 'error'].iloc[0]}"
    return line


def write_table(folder: Path, frame: pd.DataFrame, identity: Facts, timing: Facts) -> None:
    """Writes the table of a study as Parquet and CSV, with files of its identity and its timing."""
    table = pa.Table.from_pandas(frame, preserve_index=False)
    table = table.replace_schema_metadata(
        {METADATA_KEY: json.dumps(identity, sort_keys=True).encode()}
    )
    files: dict[str, str | Callable[[Path], object]] = {
        MARK: json.dumps(identity, indent=1, sort_keys=True) + "\n",
        CSV: frame.to_csv(index=False),
        TIMING: json.dumps(timing, indent=1) + "\n",
        TABLE: lambda path: pq.write_table(table, path, compression="zstd"),
    }
    for name, content in files.items():
        write_atomically(folder / name, content, True, SweepError)


def read_table(folder: Path) -> pd.DataFrame:
    """Reads the finished table of a folder; SweepError where there is none."""
    path = folder / TABLE
    if not path.is_file():
        raise SweepError(f"{path}: no such table; `aerodima sweep run` makes it")
    return pq.read_table(path).to_pandas(ignore_metadata=True)
