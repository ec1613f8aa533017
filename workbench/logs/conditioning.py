"""Making a log fit for identification: pure functions, a run log in, a new run log and notes about it out.

`aerodima.workbench.logs.recipe` puts them in the order that a YAML file states. Each works on the columns it is given
and leaves the others as they are.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pandas as pd

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.signal_table import TIME, rig_columns
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import (
    GAP_FACTOR,
    LEAST_REST_SAMPLES,
    REST,
    BoolArray,
    Interval,
    LowPass,
    check_gaps,
    check_signals,
    check_time,
    even_times,
    gaps_in,
    hold_last,
    in_parts,
    low_pass,
    resample,
    resting_line,
    stated_rest,
    stretches,
)
from aerodima.workbench.resources import published_table

WRENCH = tuple(column.name for column in rig_columns() if column.name.startswith(("force_", "torque_")))
"""Force and torque columns of a rig log, in the order of `offsets_to_add` and of Table 4.4."""
_TABLE_4_4 = ("fx_offset_n", "fy_offset_n", "fz_offset_n", "tx_offset_n_m", "ty_offset_n_m", "tz_offset_n_m")
OFFSETS = "offsets_to_add"
"""Key in a log's `extra`: what the sensor was zeroed at, N and N m; zeros once it has been added."""


@dataclass(frozen=True)
class Conditioned:
    """A log after a step, what the step has to say, and by how much it made the times earlier (s)."""

    run_log: RunLog
    notes: tuple[str, ...] = ()
    time_shift: float = 0.0


def is_held(column: str) -> bool:
    """Whether a column is a command, a state or a held sample: it jumps, and is not interpolated."""
    return "_command" in column or column.startswith(("status_", "speed_", "planned_", "controller_"))


def signals_of(run_log: RunLog) -> dict[str, FloatArray]:
    """Every column but the time."""
    return {name: run_log.signal(name) for name in run_log.table.columns if name != TIME}


def with_signals(run_log: RunLog, signals: Mapping[str, FloatArray], time: FloatArray | None = None) -> RunLog:
    """The log with these columns replaced or added; with a new time, they are all columns."""
    if time is not None:
        return replace(run_log, table=pd.DataFrame({TIME: time, **signals}))
    return replace(run_log, table=run_log.table.assign(**signals))


def remove_drift(
    run_log: RunLog, columns: Sequence[str], rest: Sequence[Interval], level: Literal["zero", "keep"] = "zero"
) -> Conditioned:
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
        check_signals(time, {name: signal}, largest_step=np.inf)
        slope, mean, centre = resting_line(time, signal, resting)
        kept = mean + slope * (time[resting][0] - centre) if level == "keep" else 0.0
        changed[name] = signal - (mean + slope * (time - centre)) + kept
        notes.append(f"drift of {name}: {slope:.3g} per s, {mean:.4g} at rest" + (", kept" if level == "keep" else ""))
    return Conditioned(with_signals(run_log, changed), tuple(notes))


def published_offsets(tail: str) -> dict[str, float]:
    """Offsets of Table 4.4 for tail `1`, `2` or `3`: column to N or N m."""
    table = published_table("force_offsets")
    rows = table[table["tail"].astype(str) == str(tail)]
    if rows.empty:
        raise LogError(f"tail {tail!r}: Table 4.4 has offsets for the tails {', '.join(map(str, table['tail']))} only")
    return {name: float(rows[key].iloc[0]) for name, key in zip(WRENCH, _TABLE_4_4, strict=True)}


def add_offsets(run_log: RunLog, tail: str | None = None) -> Conditioned:
    """Adds to the readings what the force sensor was zeroed at.

    The log's own `offsets_to_add` if it has them, else Table 4.4 for its tail. Afterwards `offsets_to_add` are zeros,
    so that nothing adds them again.

    Args:
        run_log: of the rig.
        tail: `1`, `2` or `3`; that of the log by default.

    Raises:
        LogError: the offsets were added before, the log has no tail of Table 4.4 or no force column at all.
    """
    own = run_log.stated(OFFSETS, len(WRENCH))
    if own is not None and not any(own) and any(entry.get("offsets") for entry in earlier_conditioning(run_log)):
        raise LogError(f"{run_log.name}: the offsets have been added to this log before")
    tail = tail or (None if run_log.extra.get("tail") is None else str(run_log.extra["tail"]))
    if own is not None:
        offsets, source = dict(zip(WRENCH, own, strict=True)), "the log's metadata"
    elif tail is None:
        raise LogError(f"{run_log.name}: its metadata have no tail; state it in the mapping or the recipe")
    else:
        offsets, source = published_offsets(tail), f"Table 4.4, tail {tail}"
    present = [name for name in WRENCH if name in run_log.table.columns]
    if not present:
        raise LogError(f"{run_log.name}: no force or torque column, so nothing to add offsets to")
    changed = {name: run_log.signal(name) + offsets[name] for name in present}
    extra = {**run_log.extra, OFFSETS: [0.0] * len(WRENCH)}
    notes = [f"offsets of {source} added to {', '.join(present)}"]
    missing = [name for name in WRENCH if name not in present]
    if missing:
        notes.append(f"the log has no {', '.join(missing)}")
    return Conditioned(replace(with_signals(run_log, changed), extra=extra), tuple(notes))


def cut(run_log: RunLog, start: float, end: float, restart_time: bool = False) -> Conditioned:
    """The rows from `start` to `end` (s, both included); `restart_time` lets the first be at 0 s.

    The rest phase in the metadata (`rest_s`) moves with the times.

    Raises:
        LogError: fewer than two rows are left.
    """
    time = run_log.time
    _named(run_log, check_time, time)
    margin = 1e-9 * (time[-1] - time[0])
    chosen = (time >= start - margin) & (time <= end + margin)
    if np.count_nonzero(chosen) < 2:
        raise LogError(f"{run_log.name}: {start:g} to {end:g} s leaves nothing of {time[0]:g} to {time[-1]:g} s")
    table = run_log.table[chosen].reset_index(drop=True)
    kept = time[chosen]
    shift = float(kept[0]) if restart_time else 0.0
    table[TIME] -= shift
    note = f"cut to {kept[0]:g} .. {kept[-1]:g} s, {kept.size} rows"
    rest = stated_rest(run_log) if restart_time else None
    moved = {} if rest is None else {REST: [at - shift for at in rest]}
    return Conditioned(replace(run_log, table=table, extra={**run_log.extra, **moved}), (note,), shift)


def keep_longest(run_log: RunLog) -> Conditioned:
    """The longest piece without a gap and without a NaN in any column."""
    time = run_log.time
    _named(run_log, check_time, time)
    good = np.all(np.isfinite(run_log.table.to_numpy(dtype=np.float64)), axis=1)
    pieces = stretches(good, gaps_in(time) + 1)
    if not pieces:
        raise LogError(f"{run_log.name}: no row in which every column is a number")
    start, end = max(pieces, key=lambda piece: piece[1] - piece[0])
    if (start, end) == (0, time.size):
        return Conditioned(run_log)
    kept = cut(run_log, float(time[start]), float(time[end - 1]))
    return Conditioned(kept.run_log, (f"longest of {len(pieces)} piece(s): {kept.notes[0]}",))


def fill(run_log: RunLog, longest: float) -> Conditioned:
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
    return Conditioned(with_signals(run_log, filled, grid), tuple(notes))


def filtered(run_log: RunLog, columns: Sequence[str], design: LowPass) -> Conditioned:
    """Columns after a zero-phase low pass; LogError for gaps, NaN, too low a rate or too few samples."""
    time = run_log.time
    changed = {name: _named(run_log, low_pass, time, run_log.signal(name), design, column=name) for name in columns}
    what = f"order {design.order}, {design.cutoff_hz:g} Hz, forwards and back"
    return Conditioned(with_signals(run_log, changed), (f"low pass ({what}): {', '.join(columns)}",))


def resampled(run_log: RunLog, rate: float) -> Conditioned:
    """The log at another rate (Hz): straight lines between samples, commands and states held."""
    time = run_log.time
    grid = _named(run_log, even_times, time, rate)
    signals = {
        name: _named(run_log, resample, time, signal, grid, hold=is_held(name), column=name)
        for name, signal in signals_of(run_log).items()
    }
    before = 1.0 / float(np.median(np.diff(time)))
    notes = [f"resampled from {before:.4g} to {rate:g} Hz"]
    if rate < before * (1 - 1e-6):
        notes.append(
            f"what the signals hold above {rate / 2:g} Hz is folded below it unless it was filtered out before"
        )
    return Conditioned(with_signals(run_log, signals, grid), tuple(notes))


def rate_from_angle(run_log: RunLog, angle: str, rate: str) -> Conditioned:
    """Adds `rate` as the central difference of `angle`; filter the angle first, a difference magnifies noise."""
    time, values = run_log.time, run_log.signal(angle)
    _named(run_log, check_signals, time, {angle: values})
    return Conditioned(
        with_signals(run_log, {rate: np.gradient(values, time)}), (f"{rate} differentiated from {angle}",)
    )


def earlier_conditioning(run_log: RunLog) -> list[dict[str, Any]]:
    """What was done to a log before, one entry per recipe."""
    return list(run_log.extra.get("conditioning", []))


def earlier_shift(run_log: RunLog) -> float:
    """By how much recipes have made the times of a log earlier, s."""
    return float(sum(entry.get("time_shift_s", 0.0) for entry in earlier_conditioning(run_log)))


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
