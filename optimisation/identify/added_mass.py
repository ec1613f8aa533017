"""Added mass of a cheetah tail on its swings (thesis section 4.9), fitted to the position only."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from aerodima.optimisation.identify.fit_parameters import Parameter
from aerodima.optimisation.identify.fit_pipeline import FitResult
from aerodima.optimisation.identify.least_squares import Problem
from aerodima.optimisation.identify.log_rig import FREE, FitOptions
from aerodima.optimisation.identify.pendulum import Pendulum, air_torque, friction_torque
from aerodima.optimisation.identify.swing_fit import SwingModel
from aerodima.optimisation.identify.swing_log import SwingData, swing_data
from aerodima.workbench.aero.laws import SectionLaw
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.plants.rig_motion import rig_law
from aerodima.workbench.plants.tail import ADDED_MASS_PARTS, LEAST_INERTIA_LEFT
from aerodima.workbench.resources import published_table

Bounds = Literal["wide", "printed"]
BOUNDS: tuple[Bounds, ...] = ("wide", "printed")
_MOST = 1.0
"""Upper bound of `wide`, kg per part: twice the printed one, at which one published swing stopped."""


def potential_flow_mass(data: SwingData) -> float:
    """rho pi R^2 of the length of one part (eq. 2.6), kg: a circular cylinder of the mean of both widths."""
    tail, density = data.scenario.cheetah_tail, data.scenario.environment.air_density
    radius = 0.25 * (tail.major_axis + tail.minor_axis)
    return density * math.pi * radius**2 * tail.length / ADDED_MASS_PARTS


def added_mass_model(data: SwingData, law: SectionLaw | None = None) -> SwingModel:
    """The rollout with the quasi-steady coefficients of the tail, or another law, and the published friction."""
    friction = data.scenario.friction
    law = law or rig_law(data.scenario)[0]
    air = air_torque(data.scenario, law)
    torques = [friction_torque(friction.coulomb, friction.viscous, friction.tanh_gain)]
    torques += [air] if air is not None else []
    return SwingModel(
        data, Pendulum.of(data.scenario), lambda values: torques, lambda other: added_mass_model(other, law)
    )


def added_mass_parameter(data: SwingData, bounds: Bounds = "wide") -> Parameter:
    """Seed 0. Bounds: those of Table 4.12 (`printed`) or up to 1 kg; at least 3 % of the inertia must be left."""
    low, high = -math.inf, _MOST
    if bounds == "printed":
        row = _row(data.scenario.experiment.wind_speed)
        low, high = float(row.lb_kg), float(row.ub_kg)
    least = (1.0 - LEAST_INERTIA_LEFT) * Pendulum.of(data.scenario).least_added_mass
    return Parameter("added_mass", "kg", 0.0, max(low, least), high, scale=0.02)


def _row(wind_speed: float) -> Any:
    """Of Table 4.12 at the nearest wind speed."""
    table = published_table("added_mass_seeds")
    return table.iloc[int(np.argmin(np.abs(table.wind_speed_m_per_s - wind_speed)))]


SEEDS: dict[str, Callable[[SwingData], float]] = {
    "zero": lambda data: 0.0,
    "potential-flow": potential_flow_mass,
    "table-4.12": lambda data: float(_row(data.scenario.experiment.wind_speed).x0_kg),
    "table-4.12-10": lambda data: float(_row(10.0).x0_kg),
    "table-4.12-20": lambda data: float(_row(20.0).x0_kg),
}
"""Named seeds; `table-4.12` is that of the nearest wind speed."""
DEFAULT_SEEDS = ("zero", "table-4.12")
SCAN = "scan"
"""Name in the attempts of the start that `coarse_scan` finds; it is always tried."""
_SCANNED, _SCANNED_LENGTH = 24, 1.0
"""Masses that are scanned, over that much of the swing, s."""


def require_seed(name: str) -> None:
    """FitError unless it is a name of `SEEDS` or a finite number."""
    try:
        known = name in SEEDS or math.isfinite(float(name))
    except ValueError:
        known = False
    if not known:
        raise FitError(f"seed {name!r}: allowed: {', '.join(SEEDS)}, or a number of kg")


def seed_value(name: str, data: SwingData) -> float:
    """A seed in kg, by its name or as a number; FitError, see `require_seed`."""
    require_seed(name)
    return SEEDS[name](data) if name in SEEDS else float(name)


def added_mass_problem(data: SwingData) -> Problem:
    """The least-squares problem of one swing."""
    return added_mass_model(data).problem([added_mass_parameter(data)])


def fit_added_mass(
    data: SwingData,
    *,
    seeds: Sequence[str] = DEFAULT_SEEDS,
    bounds: Bounds = "wide",
    options: FitOptions = FREE,
) -> FitResult:
    """Added mass per part of one swing, from all seeds and a coarse scan, whichever ends lower.

    A seed outside the bounds is no start; it is reported with the reason (the published seed of 10 m/s takes away more
    inertia than tail 1 has).

    Args:
        seeds: names of `SEEDS`, or numbers of kg.

    Raises:
        FitError: no such seed, none within the bounds, or no rollout exists.
    """
    model = added_mass_model(data)
    free = added_mass_parameter(data, bounds)
    low, high = options.limits(free)
    values = {name: seed_value(name, data) for name in seeds}
    refused = {name: _refusal(model, low, high, value) for name, value in values.items()}
    if all(refused.values()):
        raise FitError(f"{data.name}: no seed can be tried: " + "; ".join(f"{n}: {r}" for n, r in refused.items()))
    values[SCAN], refused[SCAN] = coarse_scan(model, low, high), ""
    names = [name for name, reason in refused.items() if not reason]
    first = replace(free, seed=values[names[0]], lower=low, upper=high)
    result = model.fit([first], [{"added_mass": values[name]} for name in names[1:]], options=options)
    done: dict[str, Mapping[str, Any]] = {
        name: {"seed": name, **attempt} for name, attempt in zip(names, result.attempts, strict=False)
    }
    for name, reason in refused.items():
        if reason:
            start = {"added_mass": values[name]}
            done[name] = {"seed": name, "start": start, "success": False, "status": reason, "iterations": 0}
    tried = [done[name] for name in values if name in done] + list(result.attempts[len(names) :])
    quasi_steady = model.fit([replace(free, frozen=True)], options=options, exact=True)
    facts = {
        "times_potential_flow": result["added_mass"].value / potential_flow_mass(data),
        "angle_rms_without_rad": quasi_steady.residual_rms["angle"],
        "angle_rms_with_rad": result.residual_rms["angle"],
    }
    return replace(result, facts={**result.facts, **facts}, attempts=tuple(tried))


def coarse_scan(model: SwingModel, low: float, high: float) -> float:
    """The mass (kg) of the least cost over the first second of the swing, among some whose frequencies are even.

    Beyond that a swing of another frequency has slipped by a whole period, where the cost has other minima.
    """
    data, pendulum = model.data, model.pendulum
    arms = sum(s * s for s in pendulum.part_distances)
    inertia = np.array([pendulum.total_inertia(low), pendulum.total_inertia(high)])
    frequencies = np.linspace(inertia[1] ** -0.5, inertia[0] ** -0.5, _SCANNED)
    masses = np.clip((frequencies**-2.0 - pendulum.inertia) / arms, low, high)
    early = model.shortened(_SCANNED_LENGTH)
    start = {"start_angle": data.angle[0], "start_rate": data.start_rate}

    def cost(mass: float) -> float:
        try:
            return float(np.sum(np.square(early.motion({"added_mass": mass, **start})[0] - early.data.angle)))
        except FitError:
            return math.inf

    return float(min(masses.tolist(), key=cost))


def _refusal(model: SwingModel, low: float, high: float, value: float) -> str:
    """Why a seed is no start; empty when it is one."""
    if low <= value <= high:
        return ""
    try:
        model.pendulum.total_inertia(value)
    except FitError as error:
        return str(error)
    return f"{value:g} kg lies outside the bounds {low:.4g} .. {high:.4g} kg"


def fit_added_mass_log(
    path: str | Path,
    *,
    seeds: tuple[str, ...] = ("zero", "table-4.12"),
    bounds: Bounds = "wide",
    options: FitOptions = FREE,
) -> FitResult:
    """Added mass per part of a swing (kg), see `fit_added_mass`.

    Raises:
        UserError: what is wrong with the log or the options.
    """
    data = swing_data(read_run_log(path), "swing", options=options)
    return fit_added_mass(data, seeds=seeds, bounds=bounds, options=options)
