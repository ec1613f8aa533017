"""Runs a study on an engine: what is missing is run, results reach the disk as they come, one table at the end."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from aerodima.optimisation.sweep.study import PlannedRun, Study, check_factors, plan_runs
from aerodima.optimisation.sweep.study_engine import Engine
from aerodima.optimisation.sweep.study_store import ResultStore, make_frame, open_store
from aerodima.workbench.config.scenario import default_values, load_scenario
from aerodima.workbench.logs.schema import software_versions

Say = Callable[[str], None]
BAR = 24
"""Width of the progress bar, characters."""


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
    with open_store(out, _identity(study, runs), force=force) as store:
        if store.finished:
            say(f"{out}: complete already, {len(runs)} runs")
            return store.read_table()
        known = store.rows()
        missing = [place for place in range(len(runs)) if place not in known]
        say(f"{len(runs)} runs, {len(known)} there already; {engine.workers} at a time, results in {out}")
        start = time.monotonic()
        new = _run_missing(runs, missing, engine, store, _Progress(len(runs), len(known), say))
        seconds = time.monotonic() - start
        rows = known | dict(zip(missing, new, strict=True))
        frame = make_frame([runs[place].place | rows[place] for place in range(len(runs))])
        store.finish(
            frame,
            {
                "runs_of_the_last_call": len(missing),
                "wall_time_of_the_last_call_s": seconds,
                "startup_of_the_workers_s": engine.startup,
                "workers": engine.workers,
            },
        )
    say(_how_it_went(frame, len(missing), seconds, engine))
    return frame


def _run_missing(
    runs: Sequence[PlannedRun], missing: Sequence[int], engine: Engine, store: ResultStore, progress: _Progress
) -> list[dict[str, Any]]:
    def keep(place: int, row: dict[str, Any]) -> None:
        store.add(missing[place], row)
        progress.one_more(row)

    try:
        rows = engine.rows([runs[place].task for place in missing], keep)
    except BaseException:
        progress.stopped()
        raise
    finally:
        store.flush()
    return rows


def _identity(study: Study, runs: Sequence[PlannedRun]) -> dict[str, Any]:
    """What must be the same for results to belong together."""
    tasks = json.dumps([[run.task.scenario, run.task.settings, run.task.signals] for run in runs])
    bases = {name: load_scenario(name).resolved() for name in sorted({run.task.scenario for run in runs})}
    inputs = json.dumps([default_values(), bases], sort_keys=True)
    return {
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


class _Progress:
    """A bar with the time that is left, from the pace of the runs of this call."""

    def __init__(self, total: int, there: int, say: Say) -> None:
        self._total, self._done, self._new, self._say = total, there, 0, say
        self._start = time.monotonic()

    def one_more(self, row: dict[str, Any]) -> None:
        """Counts a run."""
        self._done += 1
        self._new += 1
        left = (time.monotonic() - self._start) / self._new * (self._total - self._done)
        filled = BAR * self._done // self._total
        outcome = row["outcome"] or "failed"
        width = len(str(self._total))
        bar = "#" * filled + "." * (BAR - filled)
        self._say(f"[{bar}] {self._done:>{width}}/{self._total} {outcome:8} {left:5.0f} s to go")

    def stopped(self) -> None:
        """Says what is kept."""
        self._say(f"stopped: {self._done} of {self._total} runs are kept; the same command goes on with the rest")
