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

CONSTANTS = {
    "mount_mass": 0.5,
    "mount_com_x": 0.1,
    "mount_com_y": 0.1,
    "pivot_x": 0.1,
    "pivot_y": 0.1,
    "pivot_z": 0.1,
    "bar_mass": 0.2,
    "bar_com": 0.08,
    "bar_inertia": 1e-3,
    "bar_width": 0.015,
    "bar_drag": 1.5,
    "tail_mass": 0.05,
    "tail_com": 0.1,
    "tail_gap": 0.05,
    "tail_length": 0.1,
    "tail_width": 0.03,
    "rotor_inertia": 5e-3,
    "torque_constant": 0.2,
    "jet_edge_depth": 0.15,
    "wind_speed": 0.3,
    "air_density": 0.5,
    "coulomb": 0.04,
    "viscous": 0.03,
    "encoder_zero": 0.2,
    "encoder_gain": 0.3,
    "current_bias": 2.0,
    "current_delay": 0.05,
    "force_gain": 0.5,
}
"""Name -> bound to either side where it is free."""
_KEYS = {
    "mount_mass": "mount.mass",
    "mount_com_x": "mount.com_x",
    "mount_com_y": "mount.com_y",
    "pivot_x": "mount.pivot_x",
    "pivot_y": "mount.pivot_y",
    "pivot_z": "mount.pivot_z",
    "bar_mass": "bar.mass",
    "bar_com": "bar.com_distance",
    "bar_inertia": "bar.inertia_xx",
    "bar_width": "bar.width",
    "bar_drag": "bar.drag_coefficient",
    "tail_mass": "tail.mass",
    "tail_com": "tail.com_distance",
    "tail_gap": "tail.gap",
    "tail_length": "tail.length",
    "tail_width": "tail.major_axis",
    "rotor_inertia": "maxon.reflected_inertia",
    "torque_constant": "maxon.torque_constant",
    "jet_edge_depth": "tunnel.jet_edge_depth",
    "air_density": "environment.air_density",
    "coulomb": "friction.coulomb",
    "viscous": "friction.viscous",
}
"""Name -> key of the scenario that it shifts; none for an error of an instrument."""
_OPPOSITE_KEYS = {"mount_com_x": "mount.pivot_x", "mount_com_y": "mount.pivot_y"}
"""Name -> key that it shifts the other way."""
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
    reach = _BIAS_REACH if name in BIASES else CONSTANTS[name]
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

    def shift_key(key: str, shift: float) -> None:
        section, entry = key.split(".")
        if section == "tail":
            section = f"tail_{scenario.experiment.tail}"
        changed = changes.setdefault(section, {})
        value = getattr(getattr(scenario, section), entry)
        changed[entry] = changed.get(entry, value) + shift

    for name, shift in values.items():
        if name in _KEYS:
            shift_key(_KEYS[name], shift)
        if name in _OPPOSITE_KEYS:
            shift_key(_OPPOSITE_KEYS[name], -shift)
    return with_values(scenario, changes)


def with_values(scenario: RigScenario, changes: Mapping[str, Mapping[str, float]]) -> RigScenario:
    """Make the rig with other values, by section and key; ranges are not checked."""
    sections = {
        name: getattr(scenario, name).model_copy(update=values) for name, values in changes.items()
    }
    return scenario.model_copy(update=sections)
