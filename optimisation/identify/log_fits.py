"""From the path of a log to the result of its fit: what a scientist calls, and a batch does per log.

Plain functions, so that they pickle. Each imports what it needs: a static hold needs no rollouts.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from aerodima.optimisation.fit.fit_pipeline import FitResult
from aerodima.optimisation.fit.least_squares import Loss
from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.workbench.logs.schema import read_run_log

if TYPE_CHECKING:
    from aerodima.optimisation.identify.added_mass import Bounds as MassBounds
    from aerodima.optimisation.identify.robot_tail import Shape
    from aerodima.optimisation.identify.static import Bounds


def fit_static_log(
    path: str,
    *,
    bounds: Bounds = "wide",
    frozen: tuple[str, ...] = (),
    random_seeds: int = 0,
    rest: tuple[float, float] | None = None,
    options: FitOptions = FREE,
) -> FitResult:
    """C_D, C_L, psi3 and holding current of a static hold.

    Args:
        path: of the log.
        bounds, frozen, random_seeds: see `fit_static`.
        rest: first and last time of the rest without wind, s; by default as the log states it.
        options: rig, constants, drift and loss of the samples.

    Raises:
        UserError: what is wrong with the log or the options.
    """
    from aerodima.optimisation.identify.static import fit_static
    from aerodima.optimisation.identify.static_log import static_data

    return fit_static(static_data(read_run_log(path), rest, options), bounds, frozen, random_seeds)


def fit_spring_file(path: str, *, loss: Loss = "squares") -> FitResult:
    """See `fit_spring`."""
    from aerodima.optimisation.identify.springs import fit_spring, read_spring_data

    return fit_spring(read_spring_data(Path(path)), path, loss)


def fit_friction_log(path: str, *, stribeck: bool = False, options: FitOptions = FREE) -> FitResult:
    """Coulomb and viscous friction of a free swing, see `fit_friction`; of a bar swing or a robot swing.

    Raises:
        UserError: what is wrong with the log or the options.
    """
    from aerodima.optimisation.identify.friction import fit_friction
    from aerodima.optimisation.identify.swing_log import swing_data

    log = read_run_log(path)
    kind = log.kind if log.kind in ("bar_swing", "robot_swing") else "bar_swing"
    return fit_friction(swing_data(log, kind, options=options), stribeck, options)


def fit_added_mass_log(
    path: str,
    *,
    seeds: tuple[str, ...] = ("zero", "table-4.12"),
    bounds: MassBounds = "wide",
    options: FitOptions = FREE,
) -> FitResult:
    """Added mass per part of a swing (kg), see `fit_added_mass`; the reactions are compared too.

    Raises:
        UserError: what is wrong with the log or the options.
    """
    from aerodima.optimisation.identify.added_mass import fit_added_mass
    from aerodima.optimisation.identify.swing_log import swing_data

    log = read_run_log(path)
    return fit_added_mass(swing_data(log, "swing", options=options), log, seeds=seeds, bounds=bounds, options=options)


def fit_robot_tail_log(path: str, *, shape: Shape = "constant", options: FitOptions = FREE) -> FitResult:
    """Normal-force coefficient of a robot swing as a function of the relative speed, see `fit_robot_tail`."""
    from aerodima.optimisation.identify.robot_tail import fit_robot_tail
    from aerodima.optimisation.identify.swing_log import swing_data

    return fit_robot_tail(swing_data(read_run_log(path), "robot_swing", options=options), shape, options)
