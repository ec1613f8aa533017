"""From the path of a log to the result of its fit: what a batch does per log (plain functions, so that they pickle)."""

from __future__ import annotations

from pathlib import Path

from optimisation.identify.springs import fit_spring, read_spring_data
from optimisation.identify.static import Bounds, fit_static
from optimisation.identify.static_log import static_data
from optimisation.pipeline import FitResult
from workbench.logs.schema import read_run_log


def fit_static_log(
    path: str,
    *,
    bounds: Bounds = "wide",
    frozen: tuple[str, ...] = (),
    random_seeds: int = 0,
    rest: tuple[float, float] | None = None,
) -> FitResult:
    """See `fit_static`."""
    return fit_static(static_data(read_run_log(path), rest), bounds, frozen, random_seeds)


def fit_spring_file(path: str) -> FitResult:
    """See `fit_spring`."""
    return fit_spring(read_spring_data(Path(path)), path)
