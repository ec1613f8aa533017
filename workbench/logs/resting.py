"""Where in a log nothing moves."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import GAP_FACTOR, check_time

BoolArray = NDArray[np.bool_]
Interval = tuple[float, float]

REST_AVERAGE = 0.1
"""Signals are averaged over this time (s) before they are compared with the limits of rest."""
REST_MARGIN = 0.2
"""Cut off a resting part at either side of a motion, s: motion begins and dies away below the limits."""
LEAST_REST_SAMPLES = 10
"""Fewer samples do not make a resting part."""
REST = "rest_s"
"""Key in a log's `extra`: first and last time of its rest phase, s; a cut moves it with the times of the log."""


def stated_rest(run_log: RunLog) -> Interval | None:
    """The rest phase that the metadata of a log state; None without. LogError when it is not two times."""
    stated = run_log.stated(REST, 2)
    return None if stated is None else (stated[0], stated[1])


def resting_parts(run_log: RunLog, within: Mapping[str, Interval], shortest: float = 0.5) -> list[Interval]:
    """Times at which everything that tells about motion stays within its limits.

    Args:
        run_log: may have gaps; NaN is not rest.
        within: column to lowest and highest value at rest; averaged over 0.1 s first, so that noise does not count.
        shortest: a shorter standstill, such as the turning point of a swing, is not rest, s.

    Returns:
        First and last time of each part, s; an empty list when the log has no rest.

    Raises:
        LogError: a column is not in the log, or the times are not increasing.
    """
    time = run_log.time
    check_time(time)
    step = float(np.median(np.diff(time)))
    quiet = np.ones(time.size, dtype=bool)
    for name, (low, high) in within.items():
        average = _moving_average(run_log.signal(name), max(1, round(REST_AVERAGE / step)))
        quiet &= (average >= low) & (average <= high)
    breaks = np.flatnonzero(np.diff(time) > GAP_FACTOR * step) + 1
    parts = []
    for first, end in stretches(quiet, breaks):
        start = time[first] if first == 0 else time[first] + REST_MARGIN
        stop = time[end - 1] if end == time.size else time[end - 1] - REST_MARGIN
        if stop - start >= shortest and np.count_nonzero((time >= start) & (time <= stop)) >= LEAST_REST_SAMPLES:
            parts.append((float(start), float(stop)))
    return parts


def in_parts(time: FloatArray, parts: Sequence[Interval]) -> BoolArray:
    """Which times lie in any of the parts, both ends included."""
    inside = np.zeros(time.size, dtype=bool)
    for start, end in parts:
        inside |= (time >= start) & (time <= end)
    return inside


def _moving_average(signal: FloatArray, width: int) -> FloatArray:
    """Centred mean over `width` samples; the ends use what there is."""
    kernel = np.ones(min(width, signal.size))
    return np.convolve(signal, kernel, mode="same") / np.convolve(np.ones(signal.size), kernel, mode="same")


def stretches(chosen: BoolArray, breaks: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Start and end (exclusive) of the stretches of chosen samples; a stretch does not cross a break."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    runs = []
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        inner = [int(at) for at in breaks if start < at < end]
        runs += list(zip([int(start), *inner], [*inner, int(end)], strict=True))
    return runs
