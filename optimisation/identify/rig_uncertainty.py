"""Constants of the rig and errors of its instruments that a fit may vary: with a prior, or free by name.

Each is a shift from what the scenario says. How far it may be off stands in the scenario's section `uncertainty`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from aerodima.optimisation.fit.fit_parameters import Parameter
from aerodima.optimisation.identify.log_rig import FitOptions, is_simulated, named_rig
from aerodima.workbench.config.checked_files import nearest, unit_of
from aerodima.workbench.config.rig_scenario import RigScenario, RigUncertaintyParameters
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.schema import RunLog


@dataclass(frozen=True)
class Constant:
    """One of them.

    Attributes:
        keys: `section.key` of the scenario that it shifts, with a sign each; none for an error of an instrument.
        reach: bound to either side when it is free.
    """

    keys: tuple[tuple[str, float], ...] = ()
    reach: float = 0.0


def _of(key: str, reach: float) -> Constant:
    return Constant(((key, 1.0),), reach)


CONSTANTS: dict[str, Constant] = {
    "mount_mass": _of("mount.mass", 0.5),
    "mount_com_x": Constant((("mount.com_x", 1.0), ("mount.pivot_x", -1.0)), 0.1),
    "mount_com_y": Constant((("mount.com_y", 1.0), ("mount.pivot_y", -1.0)), 0.1),
    "pivot_x": _of("mount.pivot_x", 0.1),
    "pivot_y": _of("mount.pivot_y", 0.1),
    "pivot_z": _of("mount.pivot_z", 0.1),
    "bar_mass": _of("bar.mass", 0.2),
    "bar_com": _of("bar.com_distance", 0.08),
    "bar_inertia": _of("bar.inertia_xx", 1e-3),
    "bar_width": _of("bar.width", 0.015),
    "bar_drag": _of("bar.drag_coefficient", 1.5),
    "tail_mass": _of("tail.mass", 0.05),
    "tail_com": _of("tail.com_distance", 0.1),
    "tail_gap": _of("tail.gap", 0.05),
    "tail_length": _of("tail.length", 0.1),
    "tail_width": _of("tail.major_axis", 0.03),
    "rotor_inertia": _of("maxon.reflected_inertia", 5e-3),
    "torque_constant": _of("maxon.torque_constant", 0.2),
    "jet_edge_depth": _of("tunnel.jet_edge_depth", 0.15),
    "wind_speed": Constant((), 0.3),
    "air_density": _of("environment.air_density", 0.5),
    "coulomb": _of("friction.coulomb", 0.04),
    "viscous": _of("friction.viscous", 0.03),
    "encoder_zero": Constant((), 0.2),
    "encoder_gain": Constant((), 0.3),
    "current_bias": Constant((), 2.0),
    "current_delay": Constant((), 0.05),
    "force_gain": Constant((), 0.5),
}
BIASES = ("fx_bias", "fy_bias", "fz_bias", "tx_bias", "ty_bias", "tz_bias")
"""What is left in the readings of the force sensor, N and N m."""
_BIAS_REACH = 500.0
_SCALE = 0.01
"""Of a free constant, of its reach."""
_FAR = 20.0
"""Bounds of one with a prior, in its standard deviations."""
_SWING_ONLY = ("bar_inertia", "rotor_inertia", "coulomb", "viscous", "current_bias", "current_delay", "encoder_gain")
_ROBOT = ("wind_speed", "air_density", "encoder_zero", "encoder_gain")
_STATIC_ONLY = ("mount_mass", "mount_com_x", "mount_com_y", "force_gain", *BIASES)


def constant_names(kind: str) -> tuple[str, ...]:
    """What a fit of a log of this kind can free."""
    if kind == "robot_swing":
        return _ROBOT
    unused = _SWING_ONLY if kind == "static" else _STATIC_ONLY
    return tuple(name for name in (*CONSTANTS, *BIASES) if name not in unused)


def require_constants(free: Sequence[str], names: Sequence[str]) -> None:
    """FitError for a constant to free that is not among the names."""
    for name in free:
        if name not in names:
            raise FitError(f"--free {name}: this fit has no such constant; {nearest(name, list(names))}")


def constant_parameters(
    log: RunLog,
    scenario: RigScenario,
    kind: str,
    options: FitOptions,
    known: Mapping[str, float] | None = None,
    without: Sequence[str] = (),
) -> tuple[Parameter, ...]:
    """The constants that a fit varies, as shifts from the scenario: seed zero, and a deviation unless they are free.

    Args:
        known: standard deviations beside those of the scenario (biases).
        without: names that the fit has as parameters of its own.

    Raises:
        FitError: `options.free` names something else.
    """
    names = [name for name in constant_names(kind) if name not in without]
    require_constants(options.free, names)
    deviations = scenario.uncertainty.model_dump()
    if is_simulated(log):  # exact, but for what the user says of them
        stated = named_rig(options.rig, options.settings).get("uncertainty", {})
        deviations = {name: value for name, value in deviations.items() if name in stated}
    deviations |= known or {}
    return tuple(
        _parameter(name, name in options.free, deviations.get(name, 0.0))
        for name in names
        if name in options.free or deviations.get(name, 0.0) > 0.0
    )


def _parameter(name: str, free: bool, deviation: float) -> Parameter:
    unit = ("N" if name[0] == "f" else "N m") if name in BIASES else unit_of(RigUncertaintyParameters, name)
    if free:
        reach = _BIAS_REACH if name in BIASES else CONSTANTS[name].reach
        return Parameter(name, unit, 0.0, -reach, reach, scale=_SCALE * reach)
    reach = _FAR * deviation
    return Parameter(name, unit, 0.0, -reach, reach, scale=deviation, deviation=deviation)


def shifted(scenario: RigScenario, values: Mapping[str, float]) -> RigScenario:
    """The rig with its constants shifted; ranges are not checked again, trials of a fit stay near the scenario."""
    changes: dict[str, dict[str, float]] = {}
    for name, shift in values.items():
        for key, sign in CONSTANTS[name].keys if name in CONSTANTS else ():
            section, entry = key.split(".")
            section = f"tail_{scenario.experiment.tail}" if section == "tail" else section
            changed = changes.setdefault(section, {})
            changed[entry] = changed.get(entry, getattr(getattr(scenario, section), entry)) + sign * shift
    return with_values(scenario, changes)


def with_values(scenario: RigScenario, changes: Mapping[str, Mapping[str, float]]) -> RigScenario:
    """The rig with other values, by section and key; ranges are not checked."""
    sections = {name: getattr(scenario, name).model_copy(update=values) for name, values in changes.items()}
    return scenario.model_copy(update=sections)
