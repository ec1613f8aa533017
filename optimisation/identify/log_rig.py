"""The rig that a log was made on, and requirements on a log for a fit.

A log of this workbench carries its scenario; one of another laboratory has the rig of `models/`, of
the scenario that its mapping names, or of the one that the user names for the fit. The log's own
facts (kind, tail, axis, wind) override these.
"""

import math

import numpy as np

from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.workbench.core.array_types import ArrayPair
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.file_reading import Json, Settings
from aerodima.workbench.core.ranges import check_range
from aerodima.workbench.core.yaml_files import find_file, read_yaml
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import check_signals
from aerodima.workbench.scenario.rig_scenario import (
    RigScenario,
    rig_scenario_from_dict,
)
from aerodima.workbench.scenario.scenario_file import merged

ANGLE = "angle_rad"
CURRENT = "current_a"
MAX_ANGLE = math.radians(110.0)
"""Largest angle of a log, rad; a larger one is in another unit."""
MAX_WIND_SPEED = 60.0
"""Largest wind speed that a log may state, m/s: far beyond any tunnel for tails of this size, below
a slip of the unit."""
_TRUTH = ("aero", "seed", "name", "schema", "simulation")
_OF_THE_LOG = tuple(f"experiment.{key}" for key in ("kind", "tail", "axis", "wind_speed"))
_FACTS = (("tail", ("1", "2", "3")), ("axis", ("major", "minor")))


def checked_angle(log: RunLog, kind: str, least: int) -> ArrayPair:
    """Read times (s) and angles (rad) of a log (n each), and check that a fit of this kind can use
    them.

    Raises:
        LogError: unsorted time, gap or NaN, with column and time.
        FitError: another kind of log, fewer than `least` samples, or angles that must be degrees.
    """
    if log.kind != kind:
        raise FitError(f"is a log of kind {log.kind!r}; this fit needs {kind!r}")
    time = log.time
    angle = log.signal(ANGLE)
    if len(time) < least:
        raise FitError(f"{len(time)} samples; this fit needs at least {least}")
    check_signals(time, {ANGLE: angle})
    largest = angle[np.argmax(np.abs(angle))]
    if abs(largest) > MAX_ANGLE:
        raise FitError(
            f"column {ANGLE!r} reaches {largest:g}, beyond +-{MAX_ANGLE:.2f} rad; is it in degrees?"
        )
    return time, angle


def is_ours(log: RunLog) -> bool:
    """Tells whether a rig of this workbench made the log: it has the experiment of its scenario."""
    return "experiment" in log.scenario


def is_simulated(log: RunLog) -> bool:
    """Tells whether the log's scenario is the rig that it was simulated with, so that its constants
    are the true ones.

    Of this workbench's rigs only that of the robot's tail exists outside of simulation.
    """
    return is_ours(log) and ("truth" in log.extra or log.kind != "robot_swing")


def rig_of(log: RunLog, kind: str, options: FitOptions = FREE) -> RigScenario:
    """Make the rig that a log was made on; quantities that a fit is to find are those of `models/`,
    not of the log.

    Raises:
        FitError: the log does not say which tail was on the rig, or how fast the wind was.
        ScenarioError: the scenario or an override is wrong.
    """
    content = dict(log.scenario)
    if is_ours(log):
        for key in _TRUTH:
            content.pop(key, None)
    if kind == "static":
        content.pop("experiment", None)
        content["tunnel"] = dict(content.get("tunnel", {}))
        content["tunnel"].pop("psi3", None)
    content = merged(content, named_rig(options.rig, options.settings))
    content["experiment"] = {**content.get("experiment", {}), **_experiment(log, kind)}
    return rig_scenario_from_dict(content)


def named_rig(rig: str, settings: Settings) -> Json:
    """Reads the user's values of the rig, by section and key: what a file and its `base` state, and
    the settings.

    Raises:
        FitError: a setting is about a fact that the log states.
        ScenarioError: not the name of a rig, or its file is wrong, or a setting.
    """
    data: Json = {}
    if rig:
        path = find_file(rig, RigScenario.folder, "scenario")
        RigScenario.load(path, settings)
        data = RigScenario.with_base(read_yaml(path), path.parent)
    for setting in settings:
        RigScenario.apply_setting(data, setting)
        if setting.split("=")[0].strip() in _OF_THE_LOG:
            raise FitError(
                f"--set {setting}: a log says itself what was tested; allowed: what describes the "
                "rig"
            )
    rig_scenario_from_dict(data)
    return data


def _experiment(log: RunLog, kind: str) -> Json:
    """Reads the facts of the experiment from the log's metadata."""
    experiment: Json = {"kind": kind}
    extra = log.extra
    if kind in ("static", "swing"):
        for key, allowed in _FACTS:
            value = extra.get(key)
            if str(value) not in allowed:
                raise FitError(f"metadata {key!r} is {value!r}; allowed: {', '.join(allowed)}")
        experiment["tail"] = int(extra["tail"])
        experiment["axis"] = str(extra["axis"])
    if kind == "bar_swing":
        experiment["wind_speed"] = 0.0
    elif kind != "static":
        experiment["wind_speed"] = stated_number(log, "wind_speed_m_per_s", 0.0, 40.0, "m/s")
    return experiment


def stated_number(log: RunLog, key: str, least: float, most: float, unit: str) -> float:
    """Read a number in the log's metadata; FitError when it is missing or out of range."""
    value = log.extra.get(key)
    place = f"metadata {key!r}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise FitError(f"{place} is {value!r}; must be a number, {unit}")
    check_range(place, value, least, most, unit, error=FitError)
    return float(value)


def differences(scenario: RigScenario) -> Json:
    """Lists a rig's values that differ from `models/`, by `section.key`, but for the experiment."""
    known = rig_scenario_from_dict({}).resolved()
    return {
        f"{section}.{key}": value
        for section, values in scenario.resolved().items()
        if section != "experiment" and isinstance(values, dict)
        for key, value in values.items()
        if value != known[section][key]
    }
