"""Added mass of a cheetah tail on its swings, and QSS against QSS-AM (thesis section 4.9).

Fitted to the position only; then all six reactions of both models are compared with the log, which is a test that the
fit has not seen.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from optimisation.identify.published_tables import published
from optimisation.identify.static_balance import REACTIONS
from optimisation.identify.static_log import COLUMNS
from optimisation.identify.swing_fit import SwingModel
from optimisation.identify.swing_log import SwingData
from optimisation.identify.swing_model import Pendulum, air_torque, friction_torque
from optimisation.least_squares import Problem
from optimisation.parameters import Parameter
from optimisation.pipeline import FitResult
from workbench.aero.published_coefficients import CHEETAH_LIMIT
from workbench.logs.schema import RunLog
from workbench.plants.rig import ADDED_MASS_PARTS, Rig

_REACTION_POINTS = 200


def potential_flow_mass(data: SwingData) -> float:
    """rho pi R^2 of the length of one part (eq. 2.6), kg: a circular cylinder of the mean of both widths."""
    tail, density = data.scenario.cheetah_tail, data.scenario.environment.air_density
    radius = 0.25 * (tail.major_axis + tail.minor_axis)
    return density * math.pi * radius**2 * tail.length / ADDED_MASS_PARTS


def added_mass_model(data: SwingData) -> SwingModel:
    """The rollout with the quasi-steady coefficients of the tail and the published friction."""
    friction = data.scenario.friction
    air = air_torque(data.scenario)
    torques = [friction_torque(friction.coulomb, friction.viscous, friction.tanh_gain)]
    torques += [air] if air is not None else []
    return SwingModel(data, Pendulum.of(data.scenario), lambda values: torques)


def added_mass_parameter(data: SwingData) -> Parameter:
    """Seed 0, between the bounds of Table 4.12."""
    row = _seed_row(data)
    return Parameter("added_mass", "kg", 0.0, float(row.lb_kg), float(row.ub_kg), scale=0.02)


def _seed_row(data: SwingData) -> Any:
    table = published("added_mass_seeds")
    return table.iloc[int(np.argmin(np.abs(table.wind_speed_m_per_s - data.scenario.experiment.wind_speed)))]


def added_mass_problem(data: SwingData) -> Problem:
    """The least-squares problem of one swing."""
    return added_mass_model(data).problem([added_mass_parameter(data)])


def fit_added_mass(data: SwingData, log: RunLog | None = None) -> FitResult:
    """Added mass per part of one swing, from zero and from the seed of Table 4.12, whichever ends lower.

    The published seed of 10 m/s takes away more inertia than tail 1 has; the attempt is reported with that reason.

    Args:
        log: that the data came from; with it the reactions of both models are compared.
    """
    model = added_mass_model(data)
    seed = {"added_mass": float(_seed_row(data).x0_kg)}
    result = model.fit([added_mass_parameter(data)], [seed])
    values = {e.name: e.value for e in result.estimates}
    quasi_steady = model.fit([replace(added_mass_parameter(data), frozen=True)])
    without = {e.name: e.value for e in quasi_steady.estimates}
    motion, still = model.motion(values), model.motion(without)
    facts: dict[str, Any] = {
        "angle_rms_qss_rad": quasi_steady.residual_rms["angle"],
        "angle_rms_qss_am_rad": result.residual_rms["angle"],
        "potential_flow_kg": potential_flow_mass(data),
        **_reynolds(data, motion),
    }
    if log is not None:
        facts |= _reactions(data, log, motion, values["added_mass"], "qss_am")
        facts |= _reactions(data, log, still, 0.0, "qss")
    facts["verdict"] = _verdict(result, facts)
    curve = {**model.curve(values), "quasi-steady": still[0].tolist()}
    curve["with added mass"] = curve.pop("model")
    return replace(result, facts={**result.facts, **facts}, curves={"angle": curve})


def _reynolds(data: SwingData, motion: tuple[np.ndarray, np.ndarray]) -> dict[str, float]:
    """Largest relative speed and Reynolds number at the tip."""
    scenario = data.scenario
    tail, environment = scenario.cheetah_tail, scenario.environment
    reach = scenario.bar.tail_distance + tail.gap + tail.length
    tip = reach * motion[1]
    speed = np.hypot(scenario.experiment.wind_speed - tip * np.cos(motion[0]), tip * np.sin(motion[0]))
    most = float(np.max(speed))
    return {
        "most_speed_m_per_s": most,
        "most_reynolds": environment.air_density * most * tail.major_axis / environment.air_viscosity,
    }


def _reactions(
    data: SwingData, log: RunLog, motion: tuple[np.ndarray, np.ndarray], added_mass: float, model: str
) -> dict[str, float]:
    """Scatter of the difference of each reaction between log and model; its mean is left out, the bias sets it.

    The first sample is left out too: there the motor's torque jumps.
    """
    rig = Rig(data.scenario.varied(aero={"added_mass": added_mass}))
    limit = data.scenario.mount.angle_limit
    rows = np.unique(np.linspace(1, len(data.time) - 2, _REACTION_POINTS).astype(int))
    rows = rows[np.abs(motion[0][rows]) <= limit]
    torque = 0.5 * (data.motor[1:] + data.motor[:-1])
    modelled = np.array([rig.reaction(motion[0][i], motion[1][i], torque[i - 1]).wrench for i in rows])
    places = np.searchsorted(log.time, data.release + data.time[rows] - 1e-9)
    found = {}
    for axis, (channel, column) in enumerate(COLUMNS.items()):
        if column not in log.table.columns:
            continue
        difference = log.signal(column)[np.minimum(places, len(log.time) - 1)] - modelled[:, axis]
        found[f"{channel}_rms_{model}"] = float(np.std(difference))
    return found


def _verdict(result: FitResult, facts: dict[str, Any]) -> str:
    """What the swing says about added mass, in a sentence."""
    estimate, warn = result["added_mass"], ""
    if facts["most_speed_m_per_s"] > CHEETAH_LIMIT:
        warn = f"; beyond {CHEETAH_LIMIT:g} m/s, where the quasi-steady model was not shown to hold"
    if not estimate.identifiable:
        return "the swing does not determine an added mass" + warn
    better = 1.0 - facts["angle_rms_qss_am_rad"] / facts["angle_rms_qss_rad"]
    compared = [name for name in REACTIONS if f"{name}_rms_qss" in facts]
    closer = [name for name in compared if facts[f"{name}_rms_qss_am"] < 0.98 * facts[f"{name}_rms_qss"]]
    text = f"added mass makes the position error {better:.0%} smaller"
    if compared:
        text += f" and {len(closer)} of {len(compared)} reactions closer"
    if estimate.lower <= 0.0 <= estimate.upper:
        return "no added mass needed: zero lies in its interval" + warn
    return text + warn
