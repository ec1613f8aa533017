"""Signal tools for logs: checks, zero-phase low pass, resampling, where nothing moves, headings without jumps.

Every function takes times (s, shape (n,)) and a signal of the same shape. What is wrong in a log (NaN, unsorted time, a
gap) is an error that names the column and the time; nothing is dropped or filled in silently. No Drake.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.schema import RunLog

GAP_FACTOR = 1.5
"""A step longer than this many median steps is a gap."""
_SAME_TIME = 1e-9
"""A sample this much after a time (fraction of the log's length) belongs to it."""
_JITTER = 0.01
"""Steps that differ by more than this fraction of the mean one are resampled before filtering."""


@dataclass(frozen=True)
class LowPass:
    """Butterworth low pass, run forwards and back so that it shifts nothing in time.

    Attributes:
        order: order of the Butterworth design. Passed twice, the gain at the cut-off is 1/2 (not 1/sqrt 2) and falls by
            40 dB per decade and order beyond.
        cutoff_hz: cut-off frequency of the design, Hz.
    """

    order: int
    cutoff_hz: float


IMU_FILTER = LowPass(order=2, cutoff_hz=5.0)
"""IMU signals of the car."""
GPS_FILTER = LowPass(order=2, cutoff_hz=1.0)
"""GPS speed of the car."""
RIG_FILTER_10_HZ = LowPass(order=6, cutoff_hz=10.0)
"""Rig signals, slow."""
RIG_FILTER_20_HZ = LowPass(order=6, cutoff_hz=20.0)
"""Rig signals, fast."""


def check_time(time: FloatArray, column: str = "time_s") -> None:
    """Raise LogError unless times are finite, strictly increasing and at least two."""
    if len(time) < 2:
        raise LogError(f"column {column!r}: {len(time)} sample(s), at least 2 are needed")
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        raise LogError(f"column {column!r}: {time[bad[0]]} in row {bad[0]}; times must be finite")
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise LogError(f"column {column!r}: not increasing in row {row}, {time[row]:g} s after {time[row - 1]:g} s")


def gaps_in(time: FloatArray) -> NDArray[np.int64]:
    """Rows of times (n,) that have a gap behind them: a step longer than `GAP_FACTOR` median steps."""
    steps = np.diff(time)
    return np.flatnonzero(steps > GAP_FACTOR * np.median(steps)) if steps.size else np.zeros(0, dtype=np.int64)


def check_gaps(time: FloatArray, largest_step: float | None = None, column: str = "time_s") -> None:
    """Raise LogError naming the first step longer than `largest_step` (s; default 1.5 median steps)."""
    steps = np.diff(time)
    allowed = GAP_FACTOR * float(np.median(steps)) if largest_step is None else largest_step
    wide = np.flatnonzero(steps > allowed)
    if wide.size:
        at = int(wide[0])
        raise LogError(
            f"column {column!r}: {wide.size} gap(s), the first of {steps[at]:.6g} s after {time[at]:g} s; "
            f"at most {allowed:.6g} s is allowed"
        )


def check_signals(time: FloatArray, signals: Mapping[str, FloatArray], largest_step: float | None = None) -> None:
    """Raise LogError for unsorted time, gaps, a signal of another length, and any NaN or infinite sample.

    Args:
        time: s, shape (n,).
        signals: column name to samples, shape (n,) each.
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
                f"column {name!r}: {bad.size} sample(s) not finite, first {signal[bad[0]]} at {time[bad[0]]:g} s"
            )


def low_pass(time: FloatArray, signal: FloatArray, design: LowPass, column: str = "signal") -> FloatArray:
    """Zero-phase low pass of a signal, at the same times.

    Jittered times (a live log) are filtered on an even grid of the mean step and brought back by linear interpolation.

    Raises:
        LogError: gap or NaN, cut-off not below half the sample rate, signal too short for the filter.
    """
    from scipy.signal import butter, sosfiltfilt

    check_signals(time, {column: signal})
    step = (time[-1] - time[0]) / (len(time) - 1)
    if design.cutoff_hz >= 0.5 / step:
        raise LogError(
            f"column {column!r}: cut-off {design.cutoff_hz:g} Hz needs more than {2 * design.cutoff_hz:g} samples per "
            f"second, there are {1 / step:.4g}"
        )
    even = bool(np.all(np.abs(np.diff(time) - step) <= _JITTER * step))
    grid = time if even else np.linspace(time[0], time[-1], len(time))
    samples = signal if even else np.interp(grid, time, signal)
    try:
        filtered = sosfiltfilt(butter(design.order, design.cutoff_hz, output="sos", fs=1.0 / step), samples)
    except ValueError as cause:
        raise LogError(
            f"column {column!r}: {len(signal)} samples are too few for a filter of order {design.order}"
        ) from cause
    return filtered if even else np.interp(time, grid, filtered)


def resting_line(time: FloatArray, signal: FloatArray, resting: NDArray[np.bool_]) -> tuple[float, float, float]:
    """The line that fits the resting samples best: slope (per s), level at the mean resting time, and that time (s)."""
    centre = float(np.mean(time[resting]))
    slope, level = np.polyfit(time[resting] - centre, signal[resting], 1)
    return float(slope), float(level), centre


def hold_last(time: FloatArray, sample_time: FloatArray, samples: FloatArray) -> FloatArray:
    """Samples (m,) taken at `sample_time`, held until the next one, at the times `time` (n,); NaN before the first."""
    margin = _SAME_TIME * (sample_time[-1] - sample_time[0])
    index = np.searchsorted(sample_time, time + margin, side="right") - 1
    return np.where(index >= 0, samples[np.maximum(index, 0)], np.nan)


BoolArray = NDArray[np.bool_]
Interval = tuple[float, float]

LEAST_REST_SAMPLES = 10
"""Fewer samples do not make a resting part."""
REST = "rest_s"
"""Key in a log's `extra`: first and last time of its rest phase, s; a cut moves it with the times of the log."""


def stated_rest(run_log: RunLog) -> Interval | None:
    """The rest phase that the metadata of a log state; None without. LogError when it is not two times."""
    stated = run_log.stated(REST, 2)
    return None if stated is None else (stated[0], stated[1])


def in_parts(time: FloatArray, parts: Sequence[Interval]) -> BoolArray:
    """Which times lie in any of the parts, both ends included."""
    inside = np.zeros(time.size, dtype=bool)
    for start, end in parts:
        inside |= (time >= start) & (time <= end)
    return inside


UNWRAPPED = ("yaw_truth_rad", "imu_yaw_rad")
"""Headings, so that they can be subtracted."""


class RowUnwrapper:
    """Unwraps the headings of rows that come one after the other."""

    def __init__(self, columns: Sequence[str]) -> None:
        self._angles = [columns.index(name) for name in UNWRAPPED if name in columns]
        self._before: list[float] | None = None

    def apply(self, row: np.ndarray) -> np.ndarray:
        """Changes the headings of a row (columns,) in place and returns it."""
        if self._before is not None:
            for index, earlier in zip(self._angles, self._before, strict=True):
                row[index] += 2 * np.pi * round((earlier - row[index]) / (2 * np.pi))
        self._before = [row[index] for index in self._angles]
        return row
