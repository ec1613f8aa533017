"""Signal tools for logs: checks, zero-phase low pass, resampling, headings, and conditioning.

The tools take times (s, shape (n,)) and a signal of the same shape. Faults of a log (NaN, unsorted
time, a gap) are errors that name the column and the time; nothing is dropped or filled in silently.
Drake is not needed.

Conditioning makes a log fit for identification: it takes a run log and returns a new one, which
says in its metadata (`extra.conditioning`) what was done. Gaps and lost samples become straight
lines, the drift of a sensor is removed, a low pass reduces noise; columns other than those named
stay as they are.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd

from aerodima.workbench.core.array_types import BoolArray, FloatArray, IntArray, NamedArrays
from aerodima.workbench.core.errors import FitError, LogError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.scenario.signal_table import TIME

GAP_FACTOR = 1.5
"""Number of median steps beyond which a step is a gap."""
_SAME_TIME = 1e-9
"""Time by which a sample may follow an instant and still belong to it, as a fraction of the log's
length."""
_JITTER = 0.01
"""Fraction of the mean step by which steps may differ before they are resampled for filtering."""
Interval = tuple[float, float]
MIN_REST_SAMPLES = 10
"""Smallest number of samples in the resting parts of a log."""
REST = "rest_s"
"""Key in a log's `extra`: first and last time of its rest phase, s; a cut moves it with the times
of the log."""
HELD = ("status_", "speed_", "planned_", "controller_")
"""Beginnings of the names of states and held samples, which are not interpolated."""
UNWRAPPED = ("yaw_truth_rad", "imu_yaw_rad")
"""Headings that are unwrapped, so that they can be subtracted."""


@dataclass(frozen=True)
class LowPass:
    """Butterworth low pass, run forwards and back so that it shifts nothing in time.

    Attributes:
        order: order of the Butterworth design. Passed twice, the gain at the cut-off is 1/2 (not
            1/sqrt 2) and falls by 40 dB per decade and order beyond.
        cutoff_hz: cut-off frequency of the design, Hz.
    """

    order: int
    cutoff_hz: float


IMU_FILTER = LowPass(order=2, cutoff_hz=5.0)
"""Filter of the car's IMU signals."""
GPS_FILTER = LowPass(order=2, cutoff_hz=1.0)
"""Filter of the car's GPS speed."""
RIG_FILTER = LowPass(order=6, cutoff_hz=20.0)
"""Filter of the rig's signals."""


def check_time(time: FloatArray, column: str = TIME) -> None:
    """Raises LogError, with the row from 1, unless times are finite, strictly increasing and at
    least two.
    """
    if len(time) < 2:
        raise LogError(f"column {column!r}: {len(time)} sample(s), at least 2 are needed")
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        raise LogError(
            f"column {column!r}: {time[bad[0]]} in row {bad[0] + 1}; times must be finite"
        )
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise LogError(
            f"column {column!r}: not increasing in row {row + 1}, {time[row]:g} s after "
            f"{time[row - 1]:g} s"
        )


def gaps_in(time: FloatArray) -> IntArray:
    """Finds the rows of times (n,) that a gap follows: a step longer than `GAP_FACTOR` median
    steps.
    """
    return np.flatnonzero(np.diff(time) > GAP_FACTOR * median_step(time))


def median_step(time: FloatArray) -> float:
    """Returns the median of the steps between times (n,), s; 0 for a single time."""
    if len(time) < 2:
        return 0.0
    return float(np.median(np.diff(time)))


def check_gaps(time: FloatArray, largest_step: float | None = None, column: str = TIME) -> None:
    """Raises LogError with the first step above `largest_step` (s; default 1.5 median steps)
    between the samples of a column.
    """
    steps = np.diff(time)
    if largest_step is None:
        largest_step = GAP_FACTOR * median_step(time)
    wide = np.flatnonzero(steps > largest_step)
    if wide.size:
        first = wide[0]
        raise LogError(
            f"column {column!r}: {wide.size} gap(s), the first of {steps[first]:.6g} s after "
            f"{time[first]:g} s; at most {largest_step:.6g} s is allowed"
        )


def check_signals(
    time: FloatArray, signals: Mapping[str, FloatArray], largest_step: float | None = None
) -> None:
    """Raises LogError for unsorted time, gaps, a signal of another length, and any NaN or infinite
    sample.

    Args:
        time: times of the samples, s, shape (n,).
        signals: samples of each column by its name, shape (n,) each.
        largest_step: longest step that is not a gap, s; 1.5 median steps by default.
    """
    check_time(time)
    check_gaps(time, largest_step)
    for name, signal in signals.items():
        if signal.shape != time.shape:
            raise LogError(f"column {name!r}: {signal.size} samples for {time.size} times")
        bad = np.flatnonzero(~np.isfinite(signal))
        if bad.size:
            raise LogError(
                f"column {name!r}: {bad.size} sample(s) not finite, first {signal[bad[0]]} at "
                f"{time[bad[0]]:g} s"
            )


def checked_signals(run_log: RunLog, columns: Iterable[str]) -> NamedArrays:
    """Reads columns of a run log, (n,) each; LogError as `check_signals`."""
    signals = {column: run_log.signal(column) for column in columns}
    check_signals(run_log.time, signals)
    return signals


def checked_table(run_log: RunLog, columns: Iterable[str]) -> FloatArray:
    """Reads columns of a run log as an array (n, columns); LogError as `check_signals`."""
    return np.column_stack([*checked_signals(run_log, columns).values()])


def low_pass(
    time: FloatArray, signal: FloatArray, design: LowPass, column: str = "signal"
) -> FloatArray:
    """Filters a signal without phase lag, at the same times.

    Jittered times (a live log) are filtered on an even grid of the mean step and brought back by
    linear interpolation.

    Raises:
        LogError: gap or NaN, cut-off not below half the sample rate, signal too short for the
            filter.
    """
    from scipy.signal import butter, sosfiltfilt

    check_signals(time, {column: signal})
    step = (time[-1] - time[0]) / (len(time) - 1)
    if not 0.0 < design.cutoff_hz < 0.5 / step:
        raise LogError(
            f"column {column!r}: cut-off {design.cutoff_hz:g} Hz must be above 0 and below half of "
            f"the {1 / step:.4g} samples per second"
        )
    even = bool(np.all(np.abs(np.diff(time) - step) <= _JITTER * step))
    grid = np.linspace(time[0], time[-1], len(time))
    if not even:
        signal = np.interp(grid, time, signal)
    sections = butter(design.order, design.cutoff_hz, output="sos", fs=1.0 / step)
    try:
        filtered = sosfiltfilt(sections, signal)
    except ValueError as cause:
        raise LogError(
            f"column {column!r}: {len(signal)} samples are too few for a filter of order "
            f"{design.order}"
        ) from cause
    if even:
        return filtered
    return np.interp(time, grid, filtered)


def hold_last(time: FloatArray, sample_time: FloatArray, samples: FloatArray) -> FloatArray:
    """Holds samples (m,) taken at `sample_time` until the next one, at the times `time` (n,); NaN
    before the first.
    """
    margin = _SAME_TIME * (sample_time[-1] - sample_time[0])
    index = np.searchsorted(sample_time, time + margin, side="right") - 1
    return np.where(index >= 0, samples[np.maximum(index, 0)], np.nan)


def stated_rest(run_log: RunLog) -> Interval | None:
    """Reads the rest phase that the metadata of a log state; None if they state none.

    LogError if it is not two times.
    """
    stated = run_log.stated(REST, 2)
    return (stated[0], stated[1]) if stated else None


def in_parts(time: FloatArray, parts: Sequence[Interval]) -> BoolArray:
    """Says which times lie in any of the parts, both ends included."""
    inside = np.zeros(time.size, bool)
    for start, end in parts:
        inside |= (time >= start) & (time <= end)
    return inside


class RowUnwrapper:
    """Unwraps the headings of rows that come one after the other."""

    def __init__(self, columns: Sequence[str]) -> None:
        self._angles = [columns.index(name) for name in UNWRAPPED if name in columns]
        self._before: FloatArray | None = None

    def apply(self, row: np.ndarray) -> np.ndarray:
        """Changes the headings of a row (columns,) in place and returns it."""
        angles = row[self._angles]
        if self._before is not None:
            angles += 2 * np.pi * np.round((self._before - angles) / (2 * np.pi))
        row[self._angles] = self._before = angles
        return row


def fill_gaps(run_log: RunLog, longest: float) -> RunLog:
    """Bridges gaps and NaN of at most `longest` (s) by straight lines; commands and states hold
    their last value.

    Raises:
        LogError: a longer gap (names column and time), NaN before the first or after the last
            number of a column, or `longest` is negative or not finite.
    """
    if not 0.0 <= longest < np.inf:
        raise LogError(f"{run_log.name}: gaps of {longest:g} s cannot be filled; must be >= 0 s")
    time = run_log.time
    with naming(run_log.name):
        check_time(time)
        step = median_step(time)
        max_step = max(longest * (1 + 1e-9), GAP_FACTOR * step)
        check_gaps(time, max_step)
    times = [time]
    notes = []
    for row in gaps_in(time):
        gap = time[row + 1] - time[row]
        count = round(gap / step) + 1
        inserted = np.linspace(time[row], time[row + 1], count)[1:-1]
        times.append(inserted)
        notes.append(f"gap of {gap:.4g} s at {time[row]:g} s filled with {inserted.size} rows")
    grid = np.sort(np.concatenate(times))
    table = pd.DataFrame({TIME: grid})
    for name in run_log.table.columns.drop(TIME):
        signal = run_log.signal(name)
        good = np.isfinite(signal)
        if not good.all():
            lost = time[~good]
            if not (good[0] and good[-1]):
                raise LogError(
                    f"{run_log.name}: column {name!r}: not a number at {lost[0]:g} s, with no "
                    "sample on both sides; cut the log"
                )
            with naming(run_log.name):
                check_gaps(time[good], max_step, name)
            notes.append(f"{lost.size} lost sample(s) of {name} filled, the first at {lost[0]:g} s")
        is_held = "_command" in name or name.startswith(HELD)
        fill = hold_last if is_held else np.interp
        table[name] = fill(grid, time[good], signal[good])
    return _conditioned(run_log, table, notes)


def remove_drift(
    run_log: RunLog,
    columns: Sequence[str],
    rest: Sequence[Interval],
    level: Literal["zero", "keep"] = "zero",
) -> RunLog:
    """Subtracts the line through the resting parts from each column.

    Args:
        run_log: log without NaN in these columns.
        columns: names of the columns that are changed.
        rest: parts in which the true signal is the same, s. Two parts, before and after the motion,
            determine the slope far better than one.
        level: `zero` if the true signal is zero at rest (a zeroed sensor, no wind); `keep` removes
            only the slope, and the value at the first resting time stays (wind at rest).

    Raises:
        LogError: no rest, NaN, fewer than ten resting samples.
    """
    time = run_log.time
    resting = in_parts(time, rest)
    if np.count_nonzero(resting) < MIN_REST_SAMPLES:
        raise LogError(
            f"{run_log.name}: no resting part with at least {MIN_REST_SAMPLES} samples, so no "
            f"drift line for {', '.join(columns)}"
        )
    centre = float(np.mean(time[resting]))
    table = run_log.table.copy()
    notes = []
    for name in columns:
        signal = run_log.signal(name)
        with naming(run_log.name):
            check_signals(time, {name: signal}, largest_step=np.inf)
        slope, mean = np.polyfit(time[resting] - centre, signal[resting], 1)
        note = f"drift of {name}: {slope:.3g} per s, {mean:.4g} at rest"
        kept = 0.0
        if level == "keep":
            kept = mean + slope * (time[resting][0] - centre)
            note += ", kept"
        table[name] = signal - (mean + slope * (time - centre)) + kept
        notes.append(note)
    return _conditioned(run_log, table, notes)


def low_pass_columns(run_log: RunLog, columns: Sequence[str], design: LowPass) -> RunLog:
    """Filters columns without phase lag; LogError for gaps, NaN, a low rate or few samples."""
    table = run_log.table.copy()
    for name in columns:
        with naming(run_log.name):
            table[name] = low_pass(run_log.time, run_log.signal(name), design, name)
    note = (
        f"low pass (order {design.order}, {design.cutoff_hz:g} Hz, forwards and back): "
        f"{', '.join(columns)}"
    )
    return _conditioned(run_log, table, [note])


def conditioning_notes(run_log: RunLog) -> list[str]:
    """Lists the conditioning that was done to a log, one line each."""
    return [
        str(note)
        for entry in run_log.extra.get("conditioning", [])
        for note in entry.get("notes", [])
    ]


def earlier_shift(run_log: RunLog) -> float:
    """Returns the time (s) by which version 0.2 shifted a log to earlier times when it cut it."""
    return float(
        sum(entry.get("time_shift_s", 0.0) for entry in run_log.extra.get("conditioning", []))
    )


def _conditioned(run_log: RunLog, table: pd.DataFrame, notes: list[str]) -> RunLog:
    """Makes the log with another table, and with notes of what was done in its metadata."""
    extra = dict(run_log.extra)
    if notes:
        extra["conditioning"] = [*extra.get("conditioning", []), {"notes": notes}]
    return replace(run_log, table=table, extra=extra)


@contextmanager
def naming(name: str) -> Iterator[None]:
    """Puts the name of a log before the errors about it that lack it."""
    try:
        yield
    except (LogError, FitError) as error:
        raise type(error)(f"{name}: {str(error).removeprefix(f'{name}: ')}") from error
