"""Tuning of a steering limit by speed, as a stability control has one: the driver steers at full
lock, and the wheels get the angle of a lateral acceleration of the kinematic car.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aerodima.optimisation.swerve.candidate import NO_TAIL, SWERVE
from aerodima.optimisation.swerve.reduced_swerves import ReducedSwerve
from aerodima.optimisation.swerve.steering import limited_steering
from aerodima.optimisation.swerve.suite import Case
from aerodima.workbench.car.swerve import swerve_counts
from aerodima.workbench.scenario.scenario import load_scenario

ACCELERATIONS = np.geomspace(0.5, 12.0, 64)
"""Lateral accelerations that are tried, m/s2."""


def tune_limit(cases: Sequence[Case], speeds: Sequence[float]) -> float:
    """Returns the largest of `ACCELERATIONS` up to which every training car stays upright at every
    speed, m/s2.

    Args:
        cases: training cars on their floors.
        speeds: m/s.
    """
    held = np.ones(len(ACCELERATIONS), bool)
    for case in cases:
        for speed in speeds:
            settings = (*case.settings(), *NO_TAIL.settings, f"manoeuvre.speed={speed!r}")
            scenario = load_scenario(SWERVE, settings)
            swerves = ReducedSwerve(scenario).drive(limited_steering(scenario, ACCELERATIONS))
            held &= swerve_counts(swerves)
    return float(ACCELERATIONS[max(int(np.argmin(np.append(held, False))) - 1, 0)])
