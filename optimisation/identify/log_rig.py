"""What a user may choose for a fit, the rig that a log was made on, and what its samples mean.

A log of this workbench carries its scenario; one of another laboratory has the rig of `models/`, of
the scenario that its mapping names, or of the one that the user names for the fit. The log's own
facts (kind, tail, axis, wind) go last.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any, Literal

import numpy as np

from aerodima.optimisation.identify.least_squares import Loss, Parameter
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import FitError, LogError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.quantity import unit_of
from aerodima.workbench.core.resources import published_table
from aerodima.workbench.core.yaml_files import find_file, read_yaml
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import check_signals
from aerodima.workbench.scenario.rig_scenario import (
    RigScenario,
    RigUncertaintyParameters,
    rig_scenario_from_dict,
)

Knowledge = Literal["uncertain", "exact"]
KNOWLEDGE: tuple[Knowledge, ...] = ("uncertain", "exact")
ANGLE = "angle_rad"
CURRENT = "current_a"
LARGEST_ANGLE = math.radians(110.0)
"""Largest angle of a log, rad: a larger one is of another unit."""
LARGEST_SPEED = 60.0
"""m/s of wind that a log may state: far beyond any tunnel for tails of this size, below a slip of
the unit."""
_TRUTH = ("aero", "seed", "name", "schema", "simulation")
_OF_THE_LOG = tuple(f"experiment.{key}" for key in ("kind", "tail", "axis", "wind_speed"))
_FACTS = (("tail", ("1", "2", "3")), ("axis", ("major", "minor")))
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
_FAR = 20.0
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


@dataclass(frozen=True)
class FitOptions:
    """Choices that every fit of a rig log understands; what a fit has no use for is refused by its
    command.

    Attributes:
        loss: `huber` holds samples back that lie far off.
        bounds: lower and upper bound by name of the parameter, in place of the model's own.
        rig: name or file of the rig scenario that the log was made on; the log's own by default,
            else `models/`.
        settings: overrides on top of the rig, `section.key=value`.
        free: constants of the rig and errors of its instruments (`CONSTANTS`, `BIASES`) that are
            unknowns without a prior.
        constants: `uncertain`, by the scenario's section `uncertainty`; or `exact`: intervals are
            those of noise alone.
    """

    loss: Loss = "squares"
    bounds: tuple[tuple[str, float, float], ...] = ()
    rig: str = ""
    settings: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    constants: Knowledge = "uncertain"

    def bounded(self, parameters: Sequence[Parameter]) -> list[Parameter]:
        """The parameters within these bounds, their seeds too; FitError for a bound that belongs to
        none of them.
        """
        self.require_known([p.name for p in parameters])
        limits = {name: (low, high) for name, low, high in self.bounds}
        found = []
        for p in parameters:
            low, high = limits.get(p.name, (p.lower, p.upper))
            found.append(
                p
                if p.frozen
                else replace(p, seed=min(max(p.seed, low), high), lower=low, upper=high)
            )
        return found

    def require_known(self, names: Sequence[str]) -> None:
        """FitError for a bound on something that the fit does not have."""
        unknown = [name for name, _, _ in self.bounds if name not in names]
        if unknown:
            raise FitError(f"bound on {unknown[0]!r}: the free parameters are {', '.join(names)}")


FREE = FitOptions()
"""Least squares within the model's own bounds, on the rig that the log names."""


def checked_angle(log: RunLog, kind: str, least: int) -> tuple[FloatArray, FloatArray]:
    """Times (s) and angles (rad) of a log (n each), once both are what a fit of this kind can use.

    Raises:
        LogError: unsorted time, gap or NaN, with column and time.
        FitError: another kind of log, fewer than `least` samples, angles that must be degrees.
    """
    if log.kind != kind:
        raise FitError(f"is a log of kind {log.kind!r}; this fit needs {kind!r}")
    time = log.time
    angle = log.signal(ANGLE)
    if len(time) < least:
        raise FitError(f"{len(time)} samples; this fit needs at least {least}")
    check_signals(time, {ANGLE: angle})
    largest = angle[np.argmax(np.abs(angle))]
    if abs(largest) > LARGEST_ANGLE:
        raise FitError(
            f"column {ANGLE!r} reaches {largest:g}, beyond +-{LARGEST_ANGLE:.2f} rad; is it in "
            "degrees?"
        )
    return time, angle


@contextmanager
def named(name: str) -> Iterator[None]:
    """Names a log in the errors that are raised within."""
    try:
        yield
    except (LogError, FitError) as error:
        raise type(error)(f"{name}: {str(error).removeprefix(f'{name}: ')}") from error


def is_ours(log: RunLog) -> bool:
    """Whether a rig of this workbench made the log: it has the experiment of its scenario."""
    return "experiment" in log.scenario


def is_simulated(log: RunLog) -> bool:
    """Whether the log's scenario is the rig that it was simulated with, so that its constants are
    the true ones.

    Of this workbench's rigs only that of the robot's tail exists outside of simulation.
    """
    return is_ours(log) and ("truth" in log.extra or log.kind != "robot_swing")


def rig_of(log: RunLog, kind: str, options: FitOptions = FREE) -> RigScenario:
    """The rig that a log was made on; what a fit is to find is that of `models/`, not of the log.

    Raises:
        FitError: the log does not say which tail was on the rig, or how fast the wind was.
        ScenarioError: the scenario or an override is wrong.
    """
    content = {
        key: value
        for key, value in log.scenario.items()
        if key not in (_TRUTH if is_ours(log) else ())
    }
    if kind == "static":
        content.pop("experiment", None)
        content["tunnel"] = {
            key: value for key, value in content.get("tunnel", {}).items() if key != "psi3"
        }
    named = named_rig(options.rig, options.settings)
    merged = {**content, **{key: _over(content.get(key), value) for key, value in named.items()}}
    merged["experiment"] = {**merged.get("experiment", {}), **_experiment(log, kind)}
    return _scenario(json.dumps(merged, sort_keys=True))


def _over(below: Any, value: Any) -> Any:
    if isinstance(value, dict) and isinstance(below, dict):
        return {**below, **value}
    return value


@lru_cache(maxsize=16)
def named_rig(rig: str, settings: tuple[str, ...]) -> dict[str, Any]:
    """What the user says of the rig: section -> key -> value; do not change it in place.

    Raises:
        FitError: a setting is about what the log says.
        ScenarioError: not the name of a rig, no such key, a value out of range.
    """
    data: dict[str, Any] = {}
    if rig:
        path = find_file(rig, RigScenario.folder, "scenario")
        data = {
            key: value
            for key, value in read_yaml(path).items()
            if key not in ("schema", "name", "seed")
        }
    for setting in settings:
        RigScenario.apply_setting(data, setting)
        if setting.split("=")[0].strip() in _OF_THE_LOG:
            raise FitError(
                f"--set {setting}: a log says itself what was tested; allowed: what describes the "
                "rig"
            )
    _scenario(json.dumps(data, sort_keys=True))
    return data


@lru_cache(maxsize=64)
def _scenario(key: str) -> RigScenario:
    return rig_scenario_from_dict(json.loads(key))


def _experiment(log: RunLog, kind: str) -> dict[str, Any]:
    """What the log's metadata say of its experiment."""
    found: dict[str, Any] = {"kind": kind}
    extra = log.extra
    if kind in ("static", "swing"):
        for key, allowed in _FACTS:
            value = extra.get(key)
            if str(value) not in allowed:
                raise FitError(f"metadata {key!r} is {value!r}; allowed: {', '.join(allowed)}")
        found |= {"tail": int(extra["tail"]), "axis": str(extra["axis"])}
    if kind == "bar_swing":
        return {**found, "wind_speed": 0.0}
    if kind == "static":
        return found
    return {**found, "wind_speed": wind_speed(log, 0.0, 40.0)}


def wind_speed(log: RunLog, least: float, most: float) -> float:
    """Wind speed in the log's metadata, m/s; FitError when it is missing or out of range."""
    value = log.extra.get("wind_speed_m_per_s")
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not least <= float(value) <= most
    ):
        if least:
            allowed = f"{least:g} to {most:g}"
        else:
            allowed = f"above 0 to {most:g}"
        raise FitError(f"metadata 'wind_speed_m_per_s' is {value!r}; allowed: {allowed} m/s")
    return float(value)


@cache
def accuracies() -> FloatArray:
    """Table 4.8 for the six reactions (6), N and N m; do not change it in place."""
    return published_table("residual_weights").uncertainty_factor.to_numpy(float)[:6]


@cache
def speed_accuracy() -> float:
    """Table 4.8 for the speed, rad/s (printed as rad/s; ERRATA E19); in rad also that of an angle,
    one count.
    """
    return float(published_table("residual_weights").uncertainty_factor.iloc[6])


def differences(scenario: RigScenario) -> dict[str, Any]:
    """What of a rig differs from `models/`, as `section.key`; the experiment is left out."""
    return {
        f"{section}.{key}": value
        for section, known in RigScenario.defaults().items()
        for key, value in getattr(scenario, section).model_dump(mode="json").items()
        if section != "experiment" and value != known[key]
    }


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
    """The constants that a fit varies, as shifts from the scenario: seed zero, and a deviation
    unless they are free.

    Args:
        biases: standard deviations of what is left in the readings; unknowns only where the rig has
            others.

    Raises:
        FitError: `options.free` names something else.
    """
    names = constant_names(kind)
    require_constants(options.free, names)
    if options.constants == "exact":
        deviations = {}
    else:
        deviations = scenario.uncertainty.model_dump()
    if is_simulated(log):  # exact, but for what the user says of them
        stated = named_rig(options.rig, options.settings).get("uncertainty", {})
        deviations = {name: value for name, value in deviations.items() if name in stated}
    free = options.free
    if any(name in free or deviations.get(name, 0.0) > 0.0 for name in names):
        deviations |= biases or {}
    parameters = []
    for name in names:
        deviation = deviations.get(name, 0.0)
        is_free = name in free
        if is_free or deviation > 0.0:
            parameters.append(_parameter(name, is_free, deviation))
    return tuple(parameters)


def _parameter(name: str, free: bool, deviation: float) -> Parameter:
    is_bias = name in BIASES
    if not is_bias:
        unit = unit_of(RigUncertaintyParameters, name)
    elif name[0] == "f":
        unit = "N"
    else:
        unit = "N m"
    if free:
        reach = _BIAS_REACH if is_bias else CONSTANTS[name][0]
        return Parameter(name, unit, 0.0, -reach, reach, scale=_SCALE * reach)
    reach = _FAR * deviation
    return Parameter(name, unit, 0.0, -reach, reach, scale=deviation, deviation=deviation)


def shifted(scenario: RigScenario, values: Mapping[str, float]) -> RigScenario:
    """The rig with its constants shifted; ranges are not checked again, trials of a fit stay near
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
    """The rig with other values, by section and key; ranges are not checked."""
    sections = {
        name: getattr(scenario, name).model_copy(update=values) for name, values in changes.items()
    }
    return scenario.model_copy(update=sections)
