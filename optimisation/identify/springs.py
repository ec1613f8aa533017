"""Spring rates from force-displacement data (thesis Table 6.1: tyres and suspension)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.optimisation.fit.fit_pipeline import FitResult
from aerodima.optimisation.fit.least_squares import Loss
from aerodima.optimisation.identify.csv_columns import read_columns
from aerodima.optimisation.identify.line_fit import fit_line
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
