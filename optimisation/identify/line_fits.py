"""Straight lines through points, among them the spring rates of tyres and suspension (thesis Table 6.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.identify.fit_parameters import Parameter, Parameters
from aerodima.optimisation.identify.fit_pipeline import FitResult, fit
from aerodima.optimisation.identify.least_squares import Loss, Problem
from aerodima.optimisation.identify.least_squares_solvers import solve_formula
from aerodima.optimisation.identify.residual_noise import independent_noise
from aerodima.workbench.errors import FitError

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
