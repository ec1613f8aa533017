"""What is added to the readings of a hold without a rest phase, and how far wrong it may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aerodima.optimisation.identify.static_balance import REACTIONS
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.conditioning import OFFSETS
from aerodima.workbench.logs.schema import RunLog

OFFSETS_UNCERTAINTY = "offsets_uncertainty"
"""Key in a log's `extra`: standard deviation of what is left of the readings' offsets (6), N and N m."""
TARED = "tared_angle_rad"
"""Key in a log's `extra`: angle at which the sensor was zeroed without wind just before, rad."""


@dataclass(frozen=True)
class HoldOffset:
    """What is added to readings (6), the standard deviation of what is then left (6), and `StaticData.tare`."""

    added: np.ndarray
    deviation: np.ndarray
    tare: float | None


def stated_offset(log: RunLog, scenario: RigScenario, warnings: list[str]) -> HoldOffset:
    """Of a hold without rest: as the log states it, else as the scenario does; LogError and FitError for nonsense."""
    accuracy = np.asarray(scenario.force_sensor.accuracies)
    tared, stated = log.extra.get(TARED), log.stated(OFFSETS_UNCERTAINTY, len(REACTIONS))
    if tared is not None and (isinstance(tared, bool) or not isinstance(tared, int | float)):
        raise FitError(f"metadata {TARED!r} is {tared!r}; an angle in rad is needed")
    if stated is not None and min(stated) < 0.0:
        raise FitError(f"metadata {OFFSETS_UNCERTAINTY!r} is {list(stated)}; six numbers of at least 0 are needed")
    if stated is not None:
        deviation = np.asarray(stated)
    elif tared is not None:
        deviation = accuracy * scenario.force_sensor.drift_fraction * float(log.time[-1] - min(log.time[0], 0.0))
    else:
        deviation = accuracy
        warnings.append(
            "no rest phase: bias and drift stay in the readings; the sensor's accuracy is taken as their standard "
            f"deviation (state {OFFSETS_UNCERTAINTY} or {TARED} in the log if it was tared or calibrated)"
        )
    if tared is not None:
        return HoldOffset(np.zeros(6), deviation, float(tared))
    offsets = log.stated(OFFSETS, len(REACTIONS)) or scenario.cheetah_tail.offsets
    return HoldOffset(np.asarray(offsets, float), deviation, None)
