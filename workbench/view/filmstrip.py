"""A run as a strip of five pictures in one PNG, with time, speed and roll or tilt under each.

The moments tell the run: before, at the start of the turn, at its peak, on the way back, after. Of
a tail that swings, the way over the top is shown in place of the way back.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from aerodima.workbench.car.turn_signals import TurnSignals, turn_signals
from aerodima.workbench.car.verdict import FLIP_TILT
from aerodima.workbench.core.atomic_write import refuse_existing, write_atomically
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.view.captions import RESULT_COLOURS, caption_of, now_text
from aerodima.workbench.view.offscreen import OffscreenRun

_BEFORE = 0.25
"""Time shown before the turn, s."""
_AFTER = 0.75
"""Time shown after the turn, s."""
_TIPPING = np.radians(35.0)
"""Tilt from which a car is shown as tipping, rad."""
_APART = 0.05
"""Shortest time between two pictures, s, where the run leaves the room."""
FRAME = (440, 470)
"""Width and height of one picture, pixels."""
_GAP = 8
"""Width between two pictures, pixels."""
_TITLE = 52
"""Height of the title, pixels."""
_LABEL = 84
"""Height of the labels below the pictures, pixels."""
STRIP = (5 * FRAME[0] + 6 * _GAP, FRAME[1] + _TITLE + _LABEL)
"""Width and height of the strip, pixels."""
_DPI = 100
"""Pixels per inch."""


@dataclass(frozen=True)
class Moment:
    """A row of the log and what happens there."""

    row: int
    label: str


def five_moments(run_log: RunLog) -> list[Moment]:
    """The moments of a strip, in the order of time; evenly spread for a log that ends before its
    turn does.
    """
    time = run_log.time
    try:
        signals = turn_signals(run_log)
    except LogError:
        shares = {"start": 0.0, "a quarter": 0.25, "half": 0.5, "three quarters": 0.75, "end": 1.0}
        return [Moment(round(share * (time.size - 1)), label) for label, share in shares.items()]
    trigger = float(run_log.scenario["controller"]["trigger_yaw_rate"])
    if np.max(signals.tilt) > FLIP_TILT:
        found = _rollover(signals, trigger)
    else:
        found = _kept_upright(signals, trigger, _tail_on_top(run_log, signals))
    times = _spread(list(found.values()), float(time[0]), float(time[-1]))
    return [
        Moment(int(np.argmin(np.abs(time - wanted))), label)
        for label, wanted in zip(found, times, strict=True)
    ]


def _tail_on_top(run_log: RunLog, signals: TurnSignals) -> float | None:
    """When a tail that swings stands straight up, s; None if it does not."""
    side = np.sign(run_log.signal("tail_roll_angle_rad"))
    passes = np.flatnonzero((side[1:] * side[:-1] < 0) & signals.from_start[1:])
    if passes.size:
        return float(signals.time[passes[0] + 1])
    return None


def _kept_upright(
    signals: TurnSignals, trigger: float, tail_on_top: float | None
) -> dict[str, float]:
    """Label -> time, s."""
    start, end = signals.window
    roll = signals.roll[signals.from_start]
    peak = float(signals.time[signals.from_start][np.argmax(roll)])
    highest = float(np.max(roll))
    middle = {"turning in": _first(signals, signals.yaw_rate > trigger, start), "peak roll": peak}
    if tail_on_top is not None:
        middle["tail over the top"] = tail_on_top
    else:
        half = (signals.roll < 0.5 * highest) & (signals.time > peak)
        middle["recovering"] = _first(signals, half, 0.5 * (peak + end))
    ordered = dict(sorted(middle.items(), key=lambda one: one[1]))
    return {
        "before the turn": start - _BEFORE,
        **ordered,
        "after the turn": max(end, *middle.values()) + _AFTER,
    }


def _rollover(signals: TurnSignals, trigger: float) -> dict[str, float]:
    """Label -> time, s."""
    start = signals.window[0]
    over = _first(signals, signals.tilt > np.pi / 2, float(signals.time[np.argmax(signals.tilt)]))
    return {
        "before the turn": start - _BEFORE,
        "turning in": _first(signals, signals.yaw_rate > trigger, start),
        "tipping": _first(signals, signals.tilt > _TIPPING, start),
        "on its side": over,
        "after": over + _AFTER,
    }


def _first(signals: TurnSignals, condition: NDArray[np.bool_], otherwise: float) -> float:
    """First time from the start of the turn on at which a condition holds, s."""
    rows = np.flatnonzero(condition & signals.from_start)
    if rows.size:
        return float(signals.time[rows[0]])
    return otherwise


def _spread(times: list[float], first: float, last: float) -> list[float]:
    """The same times in order, inside the log and apart as far as it has room, s."""
    gap = min(_APART, (last - first) / len(times))
    ordered: list[float] = []
    for index, wanted in enumerate(times):
        if ordered:
            earliest = ordered[-1] + gap
        else:
            earliest = first
        latest = last - gap * (len(times) - 1 - index)
        ordered.append(min(max(wanted, earliest), latest))
    return ordered


def write_strip(run_log: RunLog, path: Path | str, *, force: bool = False) -> Path:
    """Writes the strip of a run; equal runs give equal bytes with one driver.

    Args:
        run_log: the run.
        path: the PNG file; refused when it exists, unless `force`.

    Raises:
        UserError: the file exists or cannot be written, or there is no renderer (`check_renderer`).
        LogError: the log cannot be replayed, see `add_logged_run`.
    """
    path = Path(path)
    refuse_existing(path, force, UserError)
    figure = strip_figure(run_log)
    return write_atomically(
        path,
        lambda temporary: figure.savefig(temporary, format="png", metadata={"Software": None}),
        force,
        UserError,
    )


def strip_figure(run_log: RunLog) -> Figure:
    """The strip as a matplotlib figure of `STRIP` pixels."""
    shown = OffscreenRun(run_log)
    logged = shown.logged
    figure = Figure(figsize=(STRIP[0] / _DPI, STRIP[1] / _DPI), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    for index, moment in enumerate(five_moments(logged.run_log)):
        left = _GAP + index * (FRAME[0] + _GAP)
        axes = figure.add_axes(
            (left / STRIP[0], _LABEL / STRIP[1], FRAME[0] / STRIP[0], FRAME[1] / STRIP[1])
        )
        camera = shown.camera(moment.row, logged.camera_azimuth, logged.camera_place, FRAME)
        axes.imshow(shown.picture(moment.row, camera), interpolation="nearest")
        axes.set_axis_off()
        middle = (left + FRAME[0] / 2) / STRIP[0]
        now = now_text(logged.run_log, moment.row)
        figure.text(
            middle,
            58 / STRIP[1],
            moment.label,
            ha="center",
            va="center",
            fontsize=13,
            weight="bold",
        )
        figure.text(middle, 26 / STRIP[1], now, ha="center", va="center", fontsize=13)
    _title(figure, logged.run_log)
    return figure


def _title(figure: Figure, run_log: RunLog) -> None:
    caption = caption_of(run_log)
    y = 1 - 0.5 * _TITLE / STRIP[1]
    left = 2 * _GAP / STRIP[0]
    figure.text(
        left,
        y,
        f"{caption.name}: {caption.facts}",
        ha="left",
        va="center",
        fontsize=16,
        weight="bold",
    )
    colour = RESULT_COLOURS[caption.result]
    figure.text(
        1 - left,
        y,
        caption.outcome,
        ha="right",
        va="center",
        fontsize=16,
        weight="bold",
        color=colour,
    )
