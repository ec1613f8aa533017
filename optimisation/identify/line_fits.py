"""Straight lines through points: throttle to steady speed (thesis Fig. 6.8), and spring rates (Table 6.1).

speed = gain x throttle + offset, from straight drives: a drive is cut where the throttle changes; each part counts
once, by the mean speed of its steady end. Springs: tyres and suspension, from force-displacement data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.fit.fit_parameters import Parameter, Parameters
from aerodima.optimisation.fit.fit_pipeline import FitResult, fit
from aerodima.optimisation.fit.least_squares import Loss, Problem
from aerodima.optimisation.fit.least_squares_solvers import solve_formula
from aerodima.optimisation.fit.residual_noise import independent_noise
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


DISPLACEMENT, FORCE = "displacement_m", "force_n"
LARGEST_DISPLACEMENT = 0.5
"""No tyre or suspension of a model car gives way that far, m: larger numbers are of another unit."""
CURVED = 0.05
"""A spring whose rate changes by more than this part over the data is reported as curved."""


def read_spring_data(path: Path | str) -> pd.DataFrame:
    """A CSV file with the columns `displacement_m` and `force_n`; FitError, see `read_columns`."""
    return read_columns(path, (DISPLACEMENT, FORCE))


def fit_spring(table: pd.DataFrame, name: str = "spring", loss: Loss = "squares") -> FitResult:
    """Rate and preload of F = rate x + preload.

    Loading and unloading may both be in the data; what they differ by is part of the residual. A spring that stiffens
    or softens by more than 5 % over the data is warned about.

    Raises:
        FitError: fewer than three points, a displacement that does not change or must be of another unit, or a force
            that falls with displacement.
    """
    x, force = table[DISPLACEMENT].to_numpy(float), table[FORCE].to_numpy(float)
    if len(x) and np.max(np.abs(x)) > LARGEST_DISPLACEMENT:
        raise FitError(
            f"{name}: column {DISPLACEMENT!r} reaches {np.max(np.abs(x)):g}, beyond {LARGEST_DISPLACEMENT:g} m; "
            "is it in mm?"
        )
    if len(x) >= 3 and np.ptp(x) == 0.0:
        raise FitError(f"{name}: column {DISPLACEMENT!r} is constant ({x[0]:g} m); a spring rate needs a displacement")
    facts = {"points": len(x)}
    result = fit_line(x, force, ("rate", "N/m"), ("preload", "N"), name=name, channel="force", facts=facts, loss=loss)
    if result["rate"].value <= 0.0:
        raise FitError(
            f"{name}: the force falls with displacement (rate {result['rate'].value:.4g} N/m); "
            "count compression and its force with the same sign"
        )
    warnings = list(result.warnings)
    change = _change_of_rate(x, force, result["rate"].value)
    if change is not None and abs(change) > CURVED:
        warnings.append(
            f"the rate {'rises' if change > 0 else 'falls'} by {abs(change):.0%} over the data: not a linear spring"
        )
    order = np.argsort(x)
    curve = {
        "x": x[order].tolist(),
        "measured": force[order].tolist(),
        "model": (result["rate"].value * x[order] + result["preload"].value).tolist(),
        "labels": ["displacement, m", "force, N"],
    }
    return replace(result, warnings=tuple(warnings), curves={"force": curve})


def _change_of_rate(x: np.ndarray, force: np.ndarray, rate: float) -> float | None:
    """Change of the slope from one end of the data to the other, of the mean slope; None when it is not significant."""
    if len(x) < 5:
        return None
    centred = (x - x.mean()) / np.ptp(x)
    design = np.vander(centred, 3)
    coefficients, residual, rank, _ = np.linalg.lstsq(design, force, rcond=None)
    if rank < 3 or not len(residual):
        return None
    deviation = np.sqrt(residual[0] / (len(x) - 3) * np.linalg.inv(design.T @ design)[0, 0])
    if abs(coefficients[0]) < 3.0 * deviation:
        return None
    return float(2.0 * coefficients[0] / (rate * np.ptp(x)))


def fit_spring_file(path: str, *, loss: Loss = "squares") -> FitResult:
    """See `fit_spring`."""
    return fit_spring(read_spring_data(Path(path)), path, loss)


def fit_line(
    x: np.ndarray,
    y: np.ndarray,
    slope: tuple[str, str],
    offset: tuple[str, str],
    *,
    name: str,
    channel: str,
    facts: Mapping[str, Any] | None = None,
    loss: Loss = "squares",
) -> FitResult:
    """The line y = slope x + offset through points.

    Args:
        x, y: points (n).
        slope, offset: name and unit of the two parameters.
        channel: what y is, for the residual.
        loss: `huber` holds points back that lie far off.

    Raises:
        FitError: fewer than three points, or one that is not finite.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    if len(x) < 3:
        raise FitError(f"{name}: {len(x)} points are too few for a line with an interval; at least 3 are needed")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y))):
        raise FitError(f"{name}: a point is not finite")
    spread = float(np.std(x)) or 1.0
    height = float(np.std(y)) or float(np.max(np.abs(y))) or 1.0
    parameters = Parameters.of(
        [
            Parameter(slope[0], slope[1], 0.0, scale=height / spread),
            Parameter(offset[0], offset[1], 0.0, scale=height),
        ]
    )
    design = np.column_stack([x, np.ones_like(x)]) / height
    problem = Problem(parameters, lambda p: design @ p - y / height, lambda p: design, name=name)
    return fit(
        problem,
        solve_formula,
        lambda solution: independent_noise(solution.residual, len(parameters.free)),
        channels={channel: (slice(None), height)},
        facts=facts,
        loss=loss,
    )


def read_columns(path: Path | str, columns: Sequence[str]) -> pd.DataFrame:
    """The named columns of a CSV file, in SI units as their names say.

    Raises:
        FitError: no such file, a column is missing, or a cell is not a finite number.
    """
    path = Path(path)
    if not path.is_file():
        raise FitError(f"{path}: no such file")
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as cause:
        raise FitError(f"{path}: cannot be read as CSV ({' '.join(str(cause).split())})") from cause
    missing = [name for name in columns if name not in table.columns]
    if missing:
        raise FitError(f"{path}: no column {', '.join(missing)}; there are {', '.join(map(str, table.columns))}")
    numbers = {}
    for name in columns:
        values = pd.to_numeric(table[name], errors="coerce").to_numpy(float)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise FitError(
                f"{path}: column {name!r}: {table[name].iloc[bad[0]]!r} in row {bad[0]} is not a finite number"
            )
        numbers[name] = values
    return pd.DataFrame(numbers)
