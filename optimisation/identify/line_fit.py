"""Straight lines through points, as a fit like any other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from aerodima.optimisation.fit.fit_parameters import Parameter, Parameters
from aerodima.optimisation.fit.fit_pipeline import FitResult, fit
from aerodima.optimisation.fit.least_squares import Loss, Problem
from aerodima.optimisation.fit.least_squares_solvers import solve_formula
from aerodima.optimisation.fit.residual_noise import independent_noise
from aerodima.workbench.errors import FitError


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
