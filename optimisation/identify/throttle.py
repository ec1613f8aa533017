"""Throttle to steady speed: speed = gain x throttle + offset, from straight drives (thesis Fig. 6.8).

A drive is cut where the throttle changes; each part counts once, by the mean speed of its steady end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.optimisation.fit.fit_pipeline import FitResult
from aerodima.optimisation.fit.least_squares import Loss
from aerodima.optimisation.identify.csv_columns import read_columns
from aerodima.optimisation.identify.line_fit import fit_line
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.logs.signals import check_signals

TIME, THROTTLE, SPEED = "time_s", "throttle_command", "speed_m_per_s"
MOVING = 0.1
"""Speed below which the car stands (a throttle too small to move it is no point of the line), m/s."""


@dataclass(frozen=True)
class SteadyRule:
    """What counts as steady.

    Attributes:
        window: length of the steady end of a part, s.
        drift: largest change of the speed over the window, of the mean speed.
        same_throttle: throttle changes below this do not start a new part.
    """

    window: float = 1.0
    drift: float = 0.03
    same_throttle: float = 0.005


@dataclass(frozen=True)
class SteadyPoint:
    """One steady part of a drive: mean throttle and speed (m/s), scatter of the speed (m/s), and when it was (s)."""

    throttle: float
    speed: float
    scatter: float
    start: float
    end: float
    log: str = ""


def read_drive(path: Path | str) -> pd.DataFrame:
    """Time, throttle and speed of a drive: a run log (Parquet), or a CSV file with those columns.

    Raises:
        FitError, LogError: the file cannot be read, a column is missing, or a cell is not a finite number.
    """
    path = Path(path)
    if path.suffix != ".csv":
        log = read_run_log(path)
        return pd.DataFrame({name: log.signal(name) for name in (TIME, THROTTLE, SPEED)})
    return read_columns(path, (TIME, THROTTLE, SPEED))


def steady_points(drive: pd.DataFrame, rule: SteadyRule | None = None, log: str = "drive") -> list[SteadyPoint]:
    """The steady parts of a drive; may be none.

    Raises:
        LogError: unsorted time, gap or NaN.
        FitError: a throttle beyond -1 to 1.
    """
    rule = rule or SteadyRule()
    time, throttle, speed = (drive[name].to_numpy(float) for name in (TIME, THROTTLE, SPEED))
    check_signals(time, {THROTTLE: throttle, SPEED: speed})
    if np.max(np.abs(throttle)) > 1.0:
        raise FitError(
            f"{log}: column {THROTTLE!r} reaches {np.max(np.abs(throttle)):g}; allowed: -1 to 1. Is it in per cent?"
        )
    edges = np.flatnonzero(np.abs(np.diff(throttle)) > rule.same_throttle) + 1
    points = []
    for part in np.split(np.arange(len(time)), edges):
        end = time[part[-1]]
        window = part[time[part] >= end - rule.window - 1e-9]
        if (
            end - time[part[0]] < rule.window
            or len(window) < 3
            or np.all(np.abs(throttle[window]) < rule.same_throttle)
        ):
            continue
        mean = float(np.mean(speed[window]))
        slope = float(np.polyfit(time[window] - end, speed[window], 1)[0])
        if mean > MOVING and abs(slope) * rule.window <= rule.drift * mean:
            scatter = float(np.std(speed[window]))
            points.append(
                SteadyPoint(float(np.mean(throttle[window])), mean, scatter, float(time[window[0]]), float(end), log)
            )
    return points


def fit_throttle(points: Sequence[SteadyPoint], name: str = "throttle", loss: Loss = "squares") -> FitResult:
    """Gain and offset of the line through all steady points.

    Raises:
        FitError: fewer than three points, or all at one throttle.
    """
    throttle = np.array([point.throttle for point in points])
    speed = np.array([point.speed for point in points])
    if len(points) < 3 or np.ptp(throttle) < 0.02:
        found = f"at a throttle of {throttle.min():g} to {throttle.max():g}" if len(points) else "in any drive"
        raise FitError(
            f"{name}: {len(points)} steady part(s) {found}; a line needs at least 3 at different throttle. "
            "Hold each throttle until the speed settles"
        )
    result = fit_line(
        throttle,
        speed,
        ("throttle_gain", "m/s"),
        ("throttle_offset", "m/s"),
        name=name,
        channel="speed",
        facts={"points": len(points)},
        loss=loss,
    )
    order = np.argsort(throttle)
    line = result["throttle_gain"].value * throttle[order] + result["throttle_offset"].value
    curve = {
        "x": throttle[order].tolist(),
        "measured": speed[order].tolist(),
        "model": line.tolist(),
        "labels": ["throttle", "steady speed, m/s"],
    }
    return replace(result, curves={"speed": curve})
