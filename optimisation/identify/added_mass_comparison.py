"""QSS against QSS-AM (thesis section 4.9): the quasi-steady model without and with added mass, on one swing.

Position, all six reactions, coefficients and Reynolds number of every section during the swing, and a verdict per swing
and per wind speed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.identify.coefficient_averages import aggregate
from aerodima.optimisation.identify.fit_pipeline import FitResult
from aerodima.optimisation.identify.hold_mean import REACTIONS
from aerodima.optimisation.identify.static_log import COLUMNS, largest_reading
from aerodima.optimisation.identify.swing_fit import SwingModel
from aerodima.workbench.aero.laws import SectionLaw
from aerodima.workbench.aero.published_coefficients import CHEETAH_LIMIT
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.plants.rig_model import tail_layout
from aerodima.workbench.plants.rig_motion import RigMotion, rig_law
from aerodima.workbench.plants.tail import ADDED_MASS_PARTS

_POINTS = 200
_TIME = "time after the release, s"
_CLOSER = 0.98
"""A reaction counts as closer to the log when its scatter falls below this part."""
_WORTH = 0.1
"""Added mass is worth its place when it makes the position error smaller by more than this part."""
QSS, QSS_AM = "quasi-steady", "with added mass"

Motion = tuple[np.ndarray, np.ndarray]


def compare(
    model: SwingModel, log: RunLog | None, with_mass: FitResult, without: FitResult, potential_flow: float
) -> tuple[dict[str, Any], dict[str, Any], list[str]]:
    """Both models on one swing.

    Args:
        model: of the rollouts.
        log: that the swing came from; without it the reactions are left out.
        with_mass, without: fits of the two models.
        potential_flow: added mass per part by eq. 2.6, kg.

    Returns:
        Facts (one number each), curves for plots, warnings.
    """
    data = model.data
    values = {e.name: e.value for e in with_mass.estimates}
    motions = {
        QSS: model.motion({e.name: e.value for e in without.estimates}),
        QSS_AM: model.motion(values),
    }
    part = data.scenario.cheetah_tail.length / ADDED_MASS_PARTS
    facts: dict[str, Any] = {
        "added_mass_kg_per_m": values["added_mass"] / part,
        "potential_flow_kg_per_m": potential_flow / part,
        "times_potential_flow": values["added_mass"] / potential_flow,
        "angle_rms_qss_rad": without.residual_rms["angle"],
        "angle_rms_qss_am_rad": with_mass.residual_rms["angle"],
    }
    curves: dict[str, Any] = {
        "angle": {
            "x": data.time.tolist(),
            "measured": data.angle.tolist(),
            **{name: motion[0].tolist() for name, motion in motions.items()},
            "labels": [_TIME, "angle, rad"],
        }
    }
    rows = np.unique(np.linspace(1, len(data.time) - 2, _POINTS).astype(int))
    rows = rows[np.abs(motions[QSS_AM][0][rows]) <= data.scenario.mount.angle_limit]
    rig = RigMotion.of(data.scenario)
    rigs = {
        QSS: replace(rig, added_mass=0.0),
        QSS_AM: replace(rig, added_mass=values["added_mass"]),
    }
    section_facts, section_curves = _sections(data.scenario, rigs[QSS_AM], motions[QSS_AM], data.time, rows)
    warnings: list[str] = []
    if log is not None:
        found, reaction_curves, warnings = _reactions(model, log, rigs, motions, rows)
        facts |= found
        curves |= reaction_curves
    facts |= section_facts
    facts["verdict"] = _verdict(with_mass, facts)
    return facts, curves | section_curves, warnings


def _reactions(
    model: SwingModel, log: RunLog, rigs: dict[str, RigMotion], motions: dict[str, Motion], rows: np.ndarray
) -> tuple[dict[str, Any], dict[str, Any], list[str]]:
    """Scatter of the difference of each reaction between log and model; its mean is left out, the bias sets it.

    The first sample is left out too: there the motor's torque jumps.
    """
    data = model.data
    torque = 0.5 * (data.motor[1:] + data.motor[:-1])
    modelled = {}
    for name, rig in rigs.items():
        angle, rate = (values[rows] for values in motions[name])
        states = zip(angle.tolist(), rate.tolist(), torque[rows - 1].tolist(), strict=True)
        modelled[name] = rig.wrenches(angle, rate, np.array([rig.acceleration(*state) for state in states]))
    places = np.minimum(np.searchsorted(log.time, data.release + data.time[rows] - 1e-9), len(log.time) - 1)
    facts: dict[str, Any] = {}
    curves: dict[str, Any] = {}
    warnings: list[str] = []
    for axis, (channel, column) in enumerate(COLUMNS.items()):
        if column not in log.table.columns or not np.all(np.isfinite(log.signal(column)[places])):
            warnings.append(f"{column} is missing or not finite: its reaction is not compared")
            continue
        measured = log.signal(column)[places]
        if np.max(np.abs(measured)) > largest_reading(channel):
            reached = f"reaches {np.max(np.abs(measured)):g}, beyond {largest_reading(channel):g}; wrong unit?"
            warnings.append(f"{column} {reached} Its reaction is not compared")
            continue
        if np.ptp(measured) == 0.0:
            warnings.append(f"{column} is constant ({measured[0]:g}), a dead channel: its reaction is not compared")
            continue
        for name, short in ((QSS, "qss"), (QSS_AM, "qss_am")):
            facts[f"{channel}_rms_{short}"] = float(np.std(measured - modelled[name][:, axis]))
        shift = float(np.mean(measured - modelled[QSS_AM][:, axis]))
        unit = "N" if channel.startswith("f") else "N m"
        curves[channel] = {
            "x": data.time[rows].tolist(),
            "measured": (measured - shift).tolist(),
            **{name: values[:, axis].tolist() for name, values in modelled.items()},
            "labels": [_TIME, f"{channel[0].upper()}_{channel[1]} without bias, {unit}"],
        }
    return facts, curves, warnings


def _sections(
    scenario: RigScenario, rig: RigMotion, motion: Motion, time: np.ndarray, rows: np.ndarray
) -> tuple[dict[str, float], dict[str, Any]]:
    """C_D, C_L and Reynolds number of the sections over the swing, and how fast the fastest was."""
    law = rig_law(scenario)[0]
    felt = np.array([rig.sections(float(motion[0][i]), float(motion[1][i])) for i in rows])
    speed, environment = felt[:, :, 0], scenario.environment
    reynolds = speed * tail_layout(scenario).chord * environment.air_density / environment.air_viscosity
    pairs = np.array([[section_coefficients(law, v, g) for v, g in sections] for sections in felt])
    curves = {}
    for name, values in (("C_D", pairs[:, :, 0]), ("C_L", pairs[:, :, 1]), ("Reynolds number", reynolds)):
        curves[f"{name} of the sections (1 at the root; gaps: outside the jet)"] = {
            "x": time[rows].tolist(),
            **{f"section {i + 1}": values[:, i].tolist() for i in range(values.shape[1])},
            "labels": [_TIME, name],
        }
    if not np.any(np.isfinite(speed)):
        return {"most_speed_m_per_s": math.nan, "most_reynolds": math.nan}, curves
    return {"most_speed_m_per_s": float(np.nanmax(speed)), "most_reynolds": float(np.nanmax(reynolds))}, curves


def section_coefficients(law: SectionLaw, speed: float, gamma: float) -> tuple[float, float]:
    """C_D and C_L of a law at a relative speed (m/s) and an angle of attack (rad); lift is positive to the root."""
    if not math.isfinite(speed) or speed == 0.0:
        return math.nan, math.nan
    # A hanging section: axis down, broadside to a wind along -y that has a part along the axis.
    axis, normal = (0.0, 0.0, -1.0), (0.0, -1.0, 0.0)
    s, c = math.sin(gamma), math.cos(gamma)
    force = law.section_force((0.0, -speed * c, -speed * s), axis, normal, 1.0, 2.0 / speed**2)
    return float(-c * force[1] - s * force[2]), float(-s * force[1] + c * force[2])


def _verdict(result: FitResult, facts: dict[str, Any]) -> str:
    """What the swing says about added mass, in a sentence."""
    estimate, warn = result["added_mass"], ""
    if facts["most_speed_m_per_s"] > CHEETAH_LIMIT:
        warn = f"; beyond {CHEETAH_LIMIT:g} m/s, where the quasi-steady model was not shown to hold"
    if not estimate.identifiable:
        return "the swing does not determine an added mass" + warn
    if estimate.lower <= 0.0 <= estimate.upper:
        return "no added mass needed: zero lies in its interval" + warn
    better = 1.0 - facts["angle_rms_qss_am_rad"] / facts["angle_rms_qss_rad"]
    text = f"added mass makes the position error {better:.0%} smaller"
    compared, closer = _closer(facts)
    return text + (f" and {closer} of {compared} reactions closer" if compared else "") + warn


def _closer(facts: dict[str, Any]) -> tuple[int, int]:
    """How many reactions were compared, and how many of them added mass brings closer."""
    names = [name for name in REACTIONS if f"{name}_rms_qss" in facts]
    return len(names), sum(facts[f"{n}_rms_qss_am"] < _CLOSER * facts[f"{n}_rms_qss"] for n in names)


def comparison_table(results: Sequence[FitResult]) -> pd.DataFrame:
    """One row per swing."""
    rows = [{"log": Path(r.name).name, "added_mass_kg": r["added_mass"].value, **r.facts} for r in results]
    return pd.DataFrame(rows)


def by_wind_speed(results: Sequence[FitResult]) -> pd.DataFrame:
    """One row per tail, axis and wind speed: all averages of the added mass, both models' errors, and a verdict."""
    cells: dict[tuple[str, str, float], list[FitResult]] = {}
    for result in results:
        f = result.facts
        cells.setdefault((f["tail"], f["axis"], f["wind_speed_m_per_s"]), []).append(result)
    rows = []
    for (tail, axis, speed), group in sorted(cells.items()):
        sure = [r for r in group if r["added_mass"].identifiable]
        names = ("times_potential_flow", "potential_flow_kg_per_m", "angle_rms_qss_rad", "angle_rms_qss_am_rad")
        median = {name: float(np.median([r.facts[name] for r in sure or group])) for name in (*names, "most_reynolds")}
        masses = np.array([r["added_mass"].value for r in sure])
        found = aggregate(masses, np.array([r.resnorm for r in sure])).columns() if sure else {}
        rows.append(
            {
                "tail": tail,
                "axis": axis,
                "wind_speed_m_per_s": speed,
                "swings": len(group),
                **{f"added_mass_{name}_kg": value for name, value in found.items() if name != "samples"},
                **median,
                "verdict": _cell_verdict(sure, median),
            }
        )
    return pd.DataFrame(rows)


def _cell_verdict(sure: Sequence[FitResult], median: dict[str, float]) -> str:
    """What the swings of one wind speed say together."""
    if not sure:
        return "no swing determines an added mass: QSS"
    zero = sum(r["added_mass"].lower <= 0.0 <= r["added_mass"].upper for r in sure)
    better = 1.0 - median["angle_rms_qss_am_rad"] / median["angle_rms_qss_rad"]
    if 2 * zero >= len(sure) or better <= _WORTH:
        return f"QSS is enough: position error {better:.0%} smaller, zero in {zero} of {len(sure)} intervals"
    counts = [_closer(dict(r.facts)) for r in sure]
    closer = f", {np.median([c for _, c in counts]):g} of {counts[0][0]} reactions closer" if counts[0][0] else ""
    text = f"QSS-AM: position error {better:.0%} smaller{closer}"
    if len({r["added_mass"].value > 0.0 for r in sure}) > 1:
        text += "; but the swings disagree about its sign"
    return text
