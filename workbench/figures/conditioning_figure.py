"""Before and after: the columns that a recipe changed, as one picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from aerodima.workbench.config.signal_table import TIME
from aerodima.workbench.figures.figure_style import new_figure, styled
from aerodima.workbench.logs.conditioning import is_held
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import Interval, gaps_in, hold_last

MOST_ROWS = 12
"""Signals that one picture holds."""
_BEFORE, _AFTER, _REST, _GAP = "#9aa0a6", "#b3261e", "#cfe8d5", "#f3c77a"


@styled()
def plot_conditioning(before: RunLog, after: RunLog, rest: Sequence[Interval] = ()) -> Figure:
    """One row per changed column: before in grey, after in red, resting parts green, gaps of the first log yellow.

    Args:
        before: the log as imported.
        after: the same after `apply_recipe`.
        rest: resting parts, s.
    """
    names = changed_columns(before, after)[:MOST_ROWS]
    figure, grid = new_figure(10.0, 1.2 + 1.7 * max(1, len(names)), max(1, len(names)), sharex=True)
    rows = grid[:, 0]
    shift = _shift(after)
    for axes, name in zip(rows, names, strict=False):
        for start, end in rest:
            axes.axvspan(start, end, color=_REST, lw=0, label="at rest" if (start, end) == rest[0] else None)
        for start, end in _gaps(before.time):
            axes.axvspan(start, end, color=_GAP, lw=0, label="gap")
        if name in before.table.columns:
            time, values = _with_breaks(before.time, before.signal(name))
            axes.plot(time, values, color=_BEFORE, lw=1.0, label="before")
        axes.plot(after.time + shift, after.signal(name), color=_AFTER, lw=1.0, label="after")
        axes.set_ylabel(name, fontsize=8)
    handles = {label: handle for handle, label in zip(*rows[0].get_legend_handles_labels(), strict=True)}
    if handles:
        figure.legend(list(handles.values()), list(handles), loc="outside upper right", ncols=4)
    rows[-1].set_xlabel("time, s")
    figure.suptitle(Path(before.source).name or "run log", x=0.01, ha="left", fontsize=10)
    return figure


def changed_columns(before: RunLog, after: RunLog) -> list[str]:
    """Columns whose values differ, or that are new; all measured ones when rows were only cut or inserted."""
    changed = []
    shift = _shift(after)
    for name in after.table.columns:
        if name == TIME:
            continue
        if name not in before.table.columns:
            changed.append(name)
            continue
        old = before.signal(name)
        good = np.isfinite(old)
        read = hold_last if is_held(name) else np.interp
        expected = read(after.time + shift, before.time[good], old[good])
        if good.all() and np.allclose(expected, after.signal(name), rtol=1e-9, atol=1e-12):
            continue
        changed.append(name)
    measured = [name for name in after.table.columns if name != TIME and not is_held(name)]
    return changed or measured


def _shift(after: RunLog) -> float:
    """What a restarted time has to be moved by to lie on the first log's, s."""
    entries = after.extra.get("conditioning", [])
    return float(entries[-1].get("time_shift_s", 0.0)) if entries else 0.0


def _gaps(time: NDArray[np.float64]) -> list[Interval]:
    return [(float(time[at]), float(time[at + 1])) for at in gaps_in(time)]


def _with_breaks(time: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """The line is interrupted in a gap instead of bridging it."""
    at = gaps_in(time) + 1
    return np.insert(time, at, np.nan), np.insert(values, at, np.nan)
