"""Constants of a rig and errors of its instruments that a fit varies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

from aerodima.optimisation.identify.fit_options import FitOptions
from aerodima.optimisation.identify.least_squares import Parameter
from aerodima.optimisation.identify.log_rig import is_simulated, named_rig
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.quantity import unit_of
from aerodima.workbench.core.resources import published_table
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.scenario.rig_scenario import (
    RigScenario,
    RigUncertaintyParameters,
)

CONSTANTS: dict[str, tuple[float, dict[str, float]]] = {
    "mount_mass": (0.5, {"mount.mass": 1.0}),
    "mount_com_x": (0.1, {"mount.com_x": 1.0, "mount.pivot_x": -1.0}),
    "mount_com_y": (0.1, {"mount.com_y": 1.0, "mount.pivot_y": -1.0}),
    "pivot_x": (0.1, {"mount.pivot_x": 1.0}),
    "pivot_y": (0.1, {"mount.pivot_y": 1.0}),
    "pivot_z": (0.1, {"mount.pivot_z": 1.0}),
    "bar_mass": (0.2, {"bar.mass": 1.0}),
    "bar_com": (0.08, {"bar.com_distance": 1.0}),
    "bar_inertia": (1e-3, {"bar.inertia_xx": 1.0}),
    "bar_width": (0.015, {"bar.width": 1.0}),
    "bar_drag": (1.5, {"bar.drag_coefficient": 1.0}),
    "tail_mass": (0.05, {"tail.mass": 1.0}),
    "tail_com": (0.1, {"tail.com_distance": 1.0}),
    "tail_gap": (0.05, {"tail.gap": 1.0}),
    "tail_length": (0.1, {"tail.length": 1.0}),
    "tail_width": (0.03, {"tail.major_axis": 1.0}),
    "rotor_inertia": (5e-3, {"maxon.reflected_inertia": 1.0}),
    "torque_constant": (0.2, {"maxon.torque_constant": 1.0}),
    "jet_edge_depth": (0.15, {"tunnel.jet_edge_depth": 1.0}),
    "wind_speed": (0.3, {}),
    "air_density": (0.5, {"environment.air_density": 1.0}),
    "coulomb": (0.04, {"friction.coulomb": 1.0}),
    "viscous": (0.03, {"friction.viscous": 1.0}),
    "encoder_zero": (0.2, {}),
    "encoder_gain": (0.3, {}),
    "current_bias": (2.0, {}),
    "current_delay": (0.05, {}),
    "force_gain": (0.5, {}),
}
"""Name -> bound to either side where it is free, and keys of the scenario that it shifts, each with
a sign; none for an error of an instrument."""
BIASES = ("fx_bias", "fy_bias", "fz_bias", "tx_bias", "ty_bias", "tz_bias")
"""What is left in the readings of the force sensor, N and N m."""
_BIAS_REACH = 500.0
"""Bound of a free bias to either side, N or N m."""
_SCALE = 0.01
"""Scale of a free constant, as a share of its reach."""
_MAX_SHIFT = 20.0
"""Bounds of one with a prior, in its standard deviations."""
_SWING_ONLY = (
    "bar_inertia",
    "rotor_inertia",
    "coulomb",
    "viscous",
    "current_bias",
    "current_delay",
    "encoder_gain",
)


_ROBOT = ("wind_speed", "air_density", "encoder_zero", "encoder_gain")
_STATIC_ONLY = ("mount_mass", "mount_com_x", "mount_com_y", "force_gain", *BIASES)


@cache
def accuracies() -> FloatArray:
    """Read Table 4.8 for the six reactions (6), N and N m; do not change it in place."""
    return published_table("residual_weights").uncertainty_factor.to_numpy(float)[:6]


@cache
def speed_accuracy() -> float:
    """Read Table 4.8 for the speed, rad/s (printed as rad/s; ERRATA E19); in rad also that of an
    angle, one count.
    """
    return float(published_table("residual_weights").uncertainty_factor.iloc[6])


def constant_names(kind: str) -> tuple[str, ...]:
    """Names the constants that a fit of a log of this kind can free."""
    if kind == "robot_swing":
        return _ROBOT
    unused = _SWING_ONLY if kind == "static" else _STATIC_ONLY
    return tuple(name for name in (*CONSTANTS, *BIASES) if name not in unused)


def require_constants(free: Sequence[str], names: Sequence[str]) -> None:
    """Raise FitError for a constant to free that is not among the names."""
    for name in free:
        if name not in names:
            raise FitError(
                f"--free {name}: this fit has no such constant; {nearest(name, list(names))}"
            )


def constant_parameters(
    log: RunLog,
    scenario: RigScenario,
    kind: str,
    options: FitOptions,
    biases: Mapping[str, float] | None = None,
) -> tuple[Parameter, ...]:
    """Make the constants that a fit varies, as shifts from the scenario: from zero, and a deviation
    unless they are free.

    Args:
        biases: standard deviations of what is left in the readings; unknowns only where the rig has
            others.

    Raises:
        FitError: `options.free` names something else.
    """
    names = constant_names(kind)
    free = options.free
    require_constants(free, names)
    deviations = {}
    if options.constants == "uncertain":
        deviations = scenario.uncertainty.model_dump()
    if is_simulated(log):  # exact, but for what the user says of them
        stated = named_rig(options.rig, options.settings).get("uncertainty", {})
        deviations = {name: value for name, value in deviations.items() if name in stated}
    if any(name in free or deviations.get(name, 0.0) > 0.0 for name in names):
        deviations |= biases or {}
    parameters = []
    for name in names:
        deviation = deviations.get(name, 0.0)
        if name in free:
            parameters.append(_free_parameter(name))
        elif deviation > 0.0:
            reach = _MAX_SHIFT * deviation
            unit = _unit(name)
            known = Parameter(name, unit, 0.0, -reach, reach, scale=deviation, prior_std=deviation)
            parameters.append(known)
    return tuple(parameters)


def _free_parameter(name: str) -> Parameter:
    reach = _BIAS_REACH if name in BIASES else CONSTANTS[name][0]
    return Parameter(name, _unit(name), 0.0, -reach, reach, scale=_SCALE * reach)


def _unit(name: str) -> str:
    if name in BIASES:
        return "N" if name[0] == "f" else "N m"
    return unit_of(RigUncertaintyParameters, name)


def shifted(scenario: RigScenario, values: Mapping[str, float]) -> RigScenario:
    """Shift the constants of a rig; ranges are not checked again, trials of a fit stay near
    the scenario.
    """
    changes: dict[str, dict[str, float]] = {}
    for name, shift in values.items():
        if name not in CONSTANTS:
            continue
        for key, sign in CONSTANTS[name][1].items():
            section, entry = key.split(".")
            if section == "tail":
                section = f"tail_{scenario.experiment.tail}"
            changed = changes.setdefault(section, {})
            value = getattr(getattr(scenario, section), entry)
            changed[entry] = changed.get(entry, value) + sign * shift
    return with_values(scenario, changes)


def with_values(scenario: RigScenario, changes: Mapping[str, Mapping[str, float]]) -> RigScenario:
    """Make the rig with other values, by section and key; ranges are not checked."""
    sections = {
        name: getattr(scenario, name).model_copy(update=values) for name, values in changes.items()
    }
    return scenario.model_copy(update=sections)
