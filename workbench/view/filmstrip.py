"""A run as a strip of five pictures in one PNG, with time, speed and roll or tilt under each.

The moments tell the run: before, at the start of the turn, at its peak, on the way back, after. For
a tail that swings, the way over the top is shown in place of the way back.
"""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from aerodima.workbench.car.turn_signals import TurnSignals, turn_signals
from aerodima.workbench.car.verdict import FLIP_TILT
from aerodima.workbench.core.array_types import BoolArray, FloatArray
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.deprecation import renamed
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.view.captions import RESULT_COLOURS, run_caption, state_caption
from aerodima.workbench.view.offscreen import OffscreenRun
from aerodima.workbench.view.recording import nearest_rows

_BEFORE = 0.25
"""Time shown before the turn, s."""
_AFTER = 0.75
"""Time shown after the turn, s."""
_TIPPING = np.radians(35.0)
"""Tilt from which a car is shown as tipping, rad."""
_ASIDE = np.radians(20.0)
"""Roll beyond which a tail is on one side, rad; small motions about the middle do not count."""
_MIN_DISTANCE = 0.05
"""Shortest time between two pictures, s, if the run is long enough."""
FRAME = (440, 470)
"""Width and height of one picture, pixels."""
_GAP = 8
"""Width of the gap between two pictures, pixels."""
_TITLE = 52
"""Height of the title, pixels."""
_LABEL = 84
"""Height of the labels below the pictures, pixels."""
STRIP = (5 * FRAME[0] + 6 * _GAP, FRAME[1] + _TITLE + _LABEL)
"""Width and height of the strip, pixels."""
_DPI = 100
"""Pixels per inch."""


def key_frames(run_log: RunLog) -> dict[str, int]:
    """Chooses the moments of a strip: rows of the log by what happens there, in the order of time;
    evenly spread for a log that ends before its turn does.
    """
    time = run_log.time
    try:
        signals = turn_signals(run_log)
    except LogError:
        labels = ["start", "a quarter", "half", "three quarters", "end"]
        rows = np.linspace(0, time.size - 1, len(labels)).round().astype(int)
    else:
        if np.max(signals.tilt) > FLIP_TILT:
            times = _rollover(run_log, signals)
        else:
            times = _kept_upright(run_log, signals)
        labels = list(times)
        spread = _spread(np.array([*times.values()]), time[0], time[-1])
        rows = nearest_rows(time, spread)
    return dict(zip(labels, rows.tolist(), strict=True))


def _tail_on_top(run_log: RunLog, signals: TurnSignals) -> float | None:
    """Finds when a tail that swings from one side to the other stands straight up, s; None if it
    does not.
    """
    angle = run_log.signal("tail_roll_angle_rad")
    aside = np.flatnonzero((np.abs(angle) > _ASIDE) & signals.from_start)
    passes = np.flatnonzero(np.diff(np.sign(angle[aside])))
    if passes.size:
        first, last = aside[passes[0] : passes[0] + 2]
        return float(signals.time[first + np.argmin(np.abs(angle[first:last]))])
    return None


def _kept_upright(run_log: RunLog, signals: TurnSignals) -> dict[str, float]:
    """Gives the time (s) of each label for a car that stays upright."""
    start, end = signals.window
    roll = np.where(signals.from_start, signals.roll, -np.inf)
    peak = float(signals.time[np.argmax(roll)])
    middle = {"turning in": _turning_in(run_log, signals), "peak roll": peak}
    tail_on_top = _tail_on_top(run_log, signals)
    if tail_on_top is not None:
        middle["tail over the top"] = tail_on_top
    else:
        half = (signals.roll < 0.5 * np.max(roll)) & (signals.time > peak)
        middle["recovering"] = _first(signals, half, 0.5 * (peak + end))
    ordered = sorted(middle.items(), key=lambda moment: moment[1])
    return {
        "before the turn": start - _BEFORE,
        **dict(ordered),
        "after the turn": max(end, ordered[-1][1]) + _AFTER,
    }


def _rollover(run_log: RunLog, signals: TurnSignals) -> dict[str, float]:
    """Gives the time (s) of each label for a car that rolls over."""
    start = signals.window[0]
    over = _first(signals, signals.tilt > np.pi / 2, float(signals.time[np.argmax(signals.tilt)]))
    return {
        "before the turn": start - _BEFORE,
        "turning in": _turning_in(run_log, signals),
        "tipping": _first(signals, signals.tilt > _TIPPING, start),
        "on its side": over,
        "after": over + _AFTER,
    }


def _turning_in(run_log: RunLog, signals: TurnSignals) -> float:
    """Finds when the yaw rate passes the trigger of the tail's law, s."""
    trigger = run_log.number("controller", "trigger_yaw_rate")
    return _first(signals, signals.yaw_rate > trigger, signals.window[0])


def _first(signals: TurnSignals, condition: BoolArray, otherwise: float) -> float:
    """Finds the first time from the start of the turn on at which a condition holds, s."""
    rows = np.flatnonzero(condition & signals.from_start)
    if rows.size:
        return float(signals.time[rows[0]])
    return otherwise


def _spread(times: FloatArray, first: float, last: float) -> FloatArray:
    """Moves ordered times (s) into the log, and apart as far as there is room."""
    shifts = min(_MIN_DISTANCE, (last - first) / times.size) * np.arange(times.size)
    apart = np.maximum.accumulate(np.maximum(times - shifts, first))
    return np.minimum(apart, last - shifts[-1]) + shifts


def write_strip(run_log: RunLog, path: Path | str, *, force: bool = False) -> Path:
    """Writes the strip of a run; equal runs give equal bytes with one driver.

    Args:
        run_log: log of the run.
        path: path of the PNG file.
        force: whether an existing file is replaced; it is refused otherwise.

    Raises:
        UserError: the file exists or cannot be written, or there is no renderer (`check_renderer`).
        LogError: the log cannot be replayed, see `add_logged_run`.
    """
    write = partial(filmstrip_figure(run_log).savefig, format="png", metadata={"Software": None})
    return write_atomically(Path(path), write, force, UserError)


def filmstrip_figure(run_log: RunLog) -> Figure:
    """Draws the strip as a matplotlib figure of `STRIP` pixels."""
    shown = OffscreenRun(run_log)
    logged = shown.logged
    width, height = STRIP
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    label = partial(figure.text, ha="center", va="center", fontsize=13)
    for index, (moment, row) in enumerate(key_frames(logged.run_log).items()):
        left = _GAP + index * (FRAME[0] + _GAP)
        size = (FRAME[0] / width, FRAME[1] / height)
        axes = figure.add_axes((left / width, _LABEL / height, *size))
        camera = shown.camera(row, logged.camera_azimuth, logged.camera_place, FRAME)
        axes.imshow(shown.picture(row, camera), interpolation="nearest")
        axes.set_axis_off()
        middle = (left + FRAME[0] / 2) / width
        label(middle, 58 / height, moment, weight="bold")
        label(middle, 26 / height, state_caption(logged.run_log, row))
    caption = run_caption(logged.run_log)
    title = partial(
        figure.text, y=1 - 0.5 * _TITLE / height, va="center", fontsize=16, weight="bold"
    )
    margin = 2 * _GAP / width
    title(margin, s=f"{caption.name}: {caption.facts}", ha="left")
    title(1 - margin, s=caption.outcome, ha="right", color=RESULT_COLOURS[caption.result])
    return figure


strip_figure = renamed("strip_figure", filmstrip_figure)
"""Old name of `filmstrip_figure`."""
