"""Runs a study on an engine: what is missing is run, results reach the disk as they come, one table at the end."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from aerodima.optimisation.sweep.run_memory import RememberingEngine
from aerodima.optimisation.sweep.study import PlannedRun, Study, check_factors, plan_runs
from aerodima.optimisation.sweep.study_engine import Engine
from aerodima.optimisation.sweep.study_store import TABLE, make_frame, open_store, read_table, write_table
from aerodima.workbench.batch.progress import saying_how_to_go_on
from aerodima.workbench.config.scenario import default_values, load_scenario
from aerodima.workbench.logs.schema import software_versions

Say = Callable[[str], None]
STUDY_RUNS_SCHEMA = "aerodima/sweep/2"


def run_study(study: Study, out: Path, engine: Engine, *, force: bool = False, say: Say | None = None) -> pd.DataFrame:
    """The table of a study; one that was stopped goes on where it was.

    Args:
        study: what to run.
        out: folder of the results; see `aerodima.optimisation.sweep.study_store`.
        engine: where to run it.
        force: drop results that are there.
        say: told lines of progress.

    Returns:
        One row per run in the order of the plan: place in the study, outcome, metrics, provenance, error.

    Raises:
        SweepError: unknown factor; the folder is in use, holds another study, or its disk is full.
    """
    say = say or (lambda line: None)
    check_factors(study, study.name)
    runs = plan_runs(study)
    tasks, identity = [run.task for run in runs], _identity(study, runs)
    with open_store(out, identity, force=force) as store:
        there = len(store.rows)
        if there and (out / TABLE).is_file():
            say(f"{out}: complete already, {len(runs)} runs")
            return read_table(out)
        say(f"{len(runs)} runs, {there} there already; {engine.workers} at a time, results in {out}")
        start = time.monotonic()
        with saying_how_to_go_on(say, lambda: f"{len(store.rows)} of {len(runs)} runs"):
            rows = RememberingEngine(engine, store, say).rows(tasks)
        seconds, new = time.monotonic() - start, len(store.rows) - there
        frame = make_frame([run.place | row for run, row in zip(runs, rows, strict=True)])
        timing = {
            "runs_of_the_last_call": new,
            "wall_time_of_the_last_call_s": seconds,
            "startup_of_the_workers_s": engine.startup,
            "workers": engine.workers,
        }
        write_table(out, frame, identity, timing)
    say(_how_it_went(frame, new, seconds, engine))
    return frame


def _identity(study: Study, runs: Sequence[PlannedRun]) -> dict[str, Any]:
    """What must be the same for results to belong together."""
    tasks = json.dumps([[run.task.scenario, run.task.settings, run.task.signals] for run in runs])
    bases = {name: load_scenario(name).resolved() for name in sorted({run.task.scenario for run in runs})}
    inputs = json.dumps([default_values(), bases], sort_keys=True)
    return {
        "schema": STUDY_RUNS_SCHEMA,
        "study": study.model_dump(mode="json", by_alias=True),
        "runs": hashlib.sha256(tasks.encode()).hexdigest(),
        "inputs": hashlib.sha256(inputs.encode()).hexdigest(),
        "versions": software_versions(),
    }


def _how_it_went(frame: pd.DataFrame, number: int, seconds: float, engine: Engine) -> str:
    failed = frame["error"].fillna("") != ""
    outcomes = frame["outcome"].value_counts()
    text = ", ".join(f"{count} {name}" for name, count in sorted(outcomes.items()))
    line = f"{text or 'no outcome'}; {number} runs in {seconds:.1f} s on {engine.workers} worker(s)"
    line += f", after {engine.startup:.1f} s to start them"
    if failed.any():
        line += f"; {int(failed.sum())} failed, the first: {frame.loc[failed, 'error'].iloc[0]}"
    return line
