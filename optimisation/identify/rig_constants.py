"""Constants of a rig and errors of its instruments that a fit varies."""

import math
from collections.abc import Collection, Mapping, Sequence
from functools import cache

import pandas as pd

from aerodima.optimisation.identify.fit_options import FitOptions
from aerodima.optimisation.identify.least_squares import Parameter
from aerodima.optimisation.identify.log_rig import is_simulated, named_rig
from aerodima.workbench.core.array_types import FloatArray, Texts, Values
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.quantity import unit_of
from aerodima.workbench.core.resources import model_path, published_table
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.scenario.rig_scenario import (
    RigScenario,
    RigUncertaintyParameters,
)

_TABLE = pd.read_csv(model_path("rig/constants.csv"), index_col="constant", keep_default_na=False)
"""Table of the constants: bound to either side when free, keys of the scenario that a constant
shifts and shifts the other way (none for an error of an instrument), and kinds of logs whose fits
can free it."""
_KEYS = _TABLE.key.to_dict()
_OPPOSITE_KEYS = _TABLE.opposite_key[_TABLE.opposite_key != ""].to_dict()
BIASES = ("fx_bias", "fy_bias", "fz_bias", "tx_bias", "ty_bias", "tz_bias")
"""Names of the biases that are left in the readings of the force sensor, N and N m."""
_SCALE = 0.01
"""Scale of a free constant, as a share of its reach."""
_MAX_SHIFT = 20.0
"""Bound of a constant with a prior to either side, in its standard deviations."""


@cache
def accuracies() -> FloatArray:
    """Read accuracies of the reactions (6), N and N m (Table 4.8); do not change them in place."""
    return published_table("residual_weights").uncertainty_factor.to_numpy(float)[:6]


@cache
def speed_accuracy() -> float:
    """Read the accuracy of the speed, rad/s, from Table 4.8 (printed as rad/s; ERRATA E19); in rad
    it is also that of an angle, one count.
    """
    return float(published_table("residual_weights").uncertainty_factor.iloc[6])


def constant_names(kind: str) -> Texts:
    """Names the constants that a fit of a log of this kind can free."""
    logs = {"static": "static", "robot_swing": "robot"}.get(kind, "swing")
    return tuple(_TABLE.index[_TABLE.logs.str.contains(logs)])


def require_constants(free: Sequence[str], names: Collection[str]) -> None:
    """Raise FitError for a constant to free that is not among the names."""
    for name in free:
        if name not in names:
            raise FitError(f"--free {name}: this fit has no such constant; {nearest(name, names)}")


def constant_parameters(
    log: RunLog,
    scenario: RigScenario,
    kind: str,
    options: FitOptions,
    biases: Values | None = None,
) -> tuple[Parameter, ...]:
    """Make the constants that a fit varies, as shifts from the scenario that start at zero and have
    a prior unless they are free.

    Args:
        log: log that is fitted.
        scenario: rig that the log was made on.
        kind: kind of the log.
        options: options of the fit: constants that are free, knowledge of the others, and the rig.
        biases: standard deviations of the biases in the readings; these become unknowns only where
            the rig has other ones.

    Raises:
        FitError: `options.free` names a constant that this fit does not have.
    """
    names = constant_names(kind)
    free = options.free
    require_constants(free, names)
    deviations = {}
    if options.constants == "uncertain":
        deviations = scenario.uncertainty.model_dump()
    if is_simulated(log):  # exact, but for those that the user calls uncertain
        stated = named_rig(options.rig, options.settings).get("uncertainty", {})
        deviations = {name: value for name, value in deviations.items() if name in stated}
    if any(name in free or deviations.get(name, 0.0) > 0.0 for name in names):
        deviations |= biases or {}
    parameters = []
    for name in names:
        deviation = deviations.get(name, 0.0)
        if name in free:
            reach = float(_TABLE.reach[name])
            scale = _SCALE * reach
            deviation = math.inf
        elif deviation > 0.0:
            reach = _MAX_SHIFT * deviation
            scale = deviation
        else:
            continue
        known = Parameter(name, _unit(name), 0.0, -reach, reach, scale=scale, prior_std=deviation)
        parameters.append(known)
    return tuple(parameters)


def _unit(name: str) -> str:
    if name in BIASES:
        return "N" if name[0] == "f" else "N m"
    return unit_of(RigUncertaintyParameters, name)


def shifted(scenario: RigScenario, values: Values) -> RigScenario:
    """Shift the constants of a rig; ranges are not checked again, since trials of a fit stay near
    the scenario.
    """
    changes: dict[str, dict[str, float]] = {}

    def shift_key(key: str, shift: float) -> None:
        section, entry = key.split(".")
        if section == "tail":
            section = f"tail_{scenario.experiment.tail}"
        changed = changes.setdefault(section, {})
        changed[entry] = changed.get(entry, getattr(getattr(scenario, section), entry)) + shift

    for name, shift in values.items():
        for key in _KEYS.get(name, "").split():
            shift_key(key, shift)
        if name in _OPPOSITE_KEYS:
            shift_key(_OPPOSITE_KEYS[name], -shift)
    return with_values(scenario, changes)


def with_values(scenario: RigScenario, changes: Mapping[str, Values]) -> RigScenario:
    """Make the rig with other values, by section and key; ranges are not checked."""
    sections = {
        name: getattr(scenario, name).model_copy(update=values) for name, values in changes.items()
    }
    return scenario.model_copy(update=sections)
