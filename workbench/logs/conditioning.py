"""Making a log fit for identification: a run log in, a new one out, which says in its metadata what was done.

Three functions: gaps and lost samples become straight lines, the drift of a sensor goes, a low pass takes noise away.
Each works on the columns it is given and leaves the others as they are. What was done is kept as `extra.conditioning`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pandas as pd

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.signal_table import TIME
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import (
    GAP_FACTOR,
    LEAST_REST_SAMPLES,
    BoolArray,
    Interval,
    LowPass,
    check_gaps,
    check_signals,
    check_time,
    gaps_in,
    hold_last,
    in_parts,
    low_pass,
    resting_line,
)


def fill_gaps(run_log: RunLog, longest: float) -> RunLog:
    """Bridges gaps and NaN of at most `longest` (s) by straight lines; commands and states hold their last value.

    Raises:
        LogError: a longer one (names column and time), or NaN before the first or after the last number of a column.
    """
    time = run_log.time
    _named(run_log, check_time, time)
    step = float(np.median(np.diff(time)))
    steps = np.diff(time)
    _named(run_log, check_gaps, time, max(longest * (1 + 1e-9), GAP_FACTOR * step))
    wide = gaps_in(time)
    inserted = [np.linspace(time[at], time[at + 1], round(steps[at] / step) + 1)[1:-1] for at in wide]
    grid = np.sort(np.concatenate([time, *inserted]))
    notes = [
        f"gap of {steps[at]:.4g} s at {time[at]:g} s filled with {new.size} rows"
        for at, new in zip(wide, inserted, strict=True)
    ]
    filled: dict[str, FloatArray] = {}
    for name, signal in signals_of(run_log).items():
        good = np.isfinite(signal)
        if np.count_nonzero(good) < time.size:
            notes.append(_check_nan(run_log, name, good, longest, step))
        if is_held(name):
            filled[name] = hold_last(grid, time[good], signal[good])
        else:
            filled[name] = np.interp(grid, time[good], signal[good])
    return _noted(replace(run_log, table=pd.DataFrame({TIME: grid, **filled})), notes)


def remove_drift(
    run_log: RunLog, columns: Sequence[str], rest: Sequence[Interval], level: Literal["zero", "keep"] = "zero"
) -> RunLog:
    """Subtracts the line through the resting parts from each column.

    Args:
        run_log: without NaN in these columns.
        columns: to change.
        rest: parts in which the true signal is the same, s. Two parts, before and after the motion, determine the
            slope far better than one.
        level: `zero`: the true signal is zero at rest (a zeroed sensor, no wind); `keep`: only the slope goes, the
            value at the first resting time stays (wind at rest).

    Raises:
        LogError: no rest, NaN, fewer than ten resting samples.
    """
    time = run_log.time
    resting = in_parts(time, rest)
    if np.count_nonzero(resting) < LEAST_REST_SAMPLES:
        raise LogError(
            f"{run_log.name}: no resting part with at least {LEAST_REST_SAMPLES} samples, so no drift line for "
            f"{', '.join(columns)}"
        )
    changed: dict[str, FloatArray] = {}
    notes = []
    for name in columns:
        signal = run_log.signal(name)
        _named(run_log, check_signals, time, {name: signal}, largest_step=np.inf)
        slope, mean, centre = resting_line(time, signal, resting)
        kept = mean + slope * (time[resting][0] - centre) if level == "keep" else 0.0
        changed[name] = signal - (mean + slope * (time - centre)) + kept
        notes.append(f"drift of {name}: {slope:.3g} per s, {mean:.4g} at rest" + (", kept" if level == "keep" else ""))
    return _noted(replace(run_log, table=run_log.table.assign(**changed)), notes)


def low_pass_columns(run_log: RunLog, columns: Sequence[str], design: LowPass) -> RunLog:
    """Columns after a zero-phase low pass; LogError for gaps, NaN, too low a rate or too few samples."""
    time = run_log.time
    changed = {name: _named(run_log, low_pass, time, run_log.signal(name), design, column=name) for name in columns}
    what = f"order {design.order}, {design.cutoff_hz:g} Hz, forwards and back"
    return _noted(replace(run_log, table=run_log.table.assign(**changed)), [f"low pass ({what}): {', '.join(columns)}"])


def conditioning_notes(run_log: RunLog) -> list[str]:
    """What was done to a log before, a line each."""
    return [str(note) for entry in run_log.extra.get("conditioning", []) for note in entry.get("notes", [])]


def earlier_shift(run_log: RunLog) -> float:
    """By how much the times of a log were made earlier when it was cut, s, as logs of version 0.2 say."""
    return float(sum(entry.get("time_shift_s", 0.0) for entry in run_log.extra.get("conditioning", [])))


def _noted(run_log: RunLog, notes: Sequence[str]) -> RunLog:
    entries = [*run_log.extra.get("conditioning", []), {"notes": list(notes)}]
    return replace(run_log, extra={**run_log.extra, "conditioning": entries}) if notes else run_log


def is_held(column: str) -> bool:
    """Whether a column is a command, a state or a held sample: it jumps, and is not interpolated."""
    return "_command" in column or column.startswith(("status_", "speed_", "planned_", "controller_"))


def signals_of(run_log: RunLog) -> dict[str, FloatArray]:
    """Every column but the time."""
    return {name: run_log.signal(name) for name in run_log.table.columns if name != TIME}


def _check_nan(run_log: RunLog, name: str, good: BoolArray, longest: float, step: float) -> str:
    """Note about the NaN of a column; LogError when they last too long or stand at an end."""
    time = run_log.time
    at = int(np.flatnonzero(~good)[0])
    where = f"{run_log.name}: column {name!r}"
    if not good.any() or not (good[0] and good[-1]):
        raise LogError(f"{where}: not a number at {time[at]:g} s, with no sample on both sides; cut the log")
    lasting = np.diff(time[good])
    if float(lasting.max()) > max(longest * (1 + 1e-9), GAP_FACTOR * step):
        begin = float(time[good][int(np.argmax(lasting))])
        raise LogError(
            f"{where}: no numbers for {lasting.max():.4g} s after {begin:g} s; at most {longest:g} s is filled"
        )
    return f"{np.count_nonzero(~good)} lost sample(s) of {name} filled, the first at {time[at]:g} s"


def _named(run_log: RunLog, function: Callable[..., FloatArray | None], *args: Any, **kwargs: Any) -> Any:
    """The function's result; its LogError gets the name of the log."""
    try:
        return function(*args, **kwargs)
    except LogError as error:
        raise LogError(f"{run_log.name}: {error}") from None
