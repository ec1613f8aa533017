"""From the path of a log to the result of its fit: what a batch does per log (plain functions, so that they pickle)."""

from __future__ import annotations

from pathlib import Path

from optimisation.identify.added_mass import DEFAULT_SEEDS, fit_added_mass
from optimisation.identify.added_mass import Bounds as MassBounds
from optimisation.identify.friction import fit_friction
from optimisation.identify.robot_tail import Shape, fit_robot_tail
from optimisation.identify.springs import fit_spring, read_spring_data
from optimisation.identify.static import Bounds, fit_static
from optimisation.identify.static_log import static_data
from optimisation.identify.swing_fit import FREE, FitOptions
from optimisation.identify.swing_log import swing_data
from optimisation.pipeline import FitResult
from optimisation.robust import Loss
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


def fit_spring_file(path: str, *, loss: Loss = "squares") -> FitResult:
    """See `fit_spring`."""
    return fit_spring(read_spring_data(Path(path)), path, loss)


def fit_friction_log(path: str, *, stribeck: bool = False, options: FitOptions = FREE) -> FitResult:
    """See `fit_friction`; the log is of a bar swing or a robot swing."""
    log = read_run_log(path)
    kind = log.kind if log.kind in ("bar_swing", "robot_swing") else "bar_swing"
    return fit_friction(swing_data(log, kind), stribeck, options)


def fit_added_mass_log(
    path: str, *, seeds: tuple[str, ...] = DEFAULT_SEEDS, bounds: MassBounds = "wide", options: FitOptions = FREE
) -> FitResult:
    """See `fit_added_mass`; the reactions are compared too."""
    log = read_run_log(path)
    return fit_added_mass(swing_data(log, "swing"), log, seeds=seeds, bounds=bounds, options=options)


def fit_robot_tail_log(path: str, *, shape: Shape = "constant", options: FitOptions = FREE) -> FitResult:
    """See `fit_robot_tail`."""
    return fit_robot_tail(swing_data(read_run_log(path), "robot_swing"), shape, options)
