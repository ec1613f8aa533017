"""Static logs whose truth is known: made by the rig's plant, with or without a rest phase in front."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from workbench.logs.schema import RunLog
from workbench.plants.rig import Rig
from workbench.rig_logs import RIG_COLUMN_NAMES, simulate_static_log
from workbench.rig_scenario import RigScenario, load_rig_scenario
from workbench.sensors.force_torque import sensor_readings

ANGLES_DEG = (0, 15, 30, 45, 60, 75)
SPEEDS = (10.0, 20.0, 30.0)
CD, CL = 0.9, 0.25
"""Of all logs: inside the bounds, and of the size of the published ones."""


def static_scenario(tail: int, axis: str, degrees: float, speed: float, psi: float) -> RigScenario:
    return load_rig_scenario("static").varied(
        experiment={"tail": tail, "axis": axis, "angle": math.radians(degrees), "wind_speed": speed},
        aero={"source": "constant", "drag": CD, "lift": CL},
        tunnel={"psi3": psi},
    )


def log_with_rest(scenario: RigScenario, rig: Rig, calm: Rig, rest: float) -> RunLog:
    """The hold of `rig`, after `rest` seconds at the same angle without wind (`calm`); one sensor for both."""
    log = simulate_static_log(scenario, rig)
    angle, count = scenario.experiment.angle, len(log.table)
    still = calm.reaction_at_current(angle, 0.0, calm.holding_current(angle)).wrench
    windy = np.asarray(log.extra["true_wrench"])
    wrench = np.where((np.arange(count) / scenario.simulation.log_rate <= rest)[:, None], still, windy)
    table = log.table.copy()
    table.iloc[:, 4:] = sensor_readings(
        wrench, count, scenario.force_sensor, log.extra["offsets_to_add"], scenario.seed
    )
    return replace(
        log, table=pd.DataFrame(table, columns=list(RIG_COLUMN_NAMES)), extra={**log.extra, "rest_s": [0.0, rest]}
    )


def truth_of(log: RunLog) -> dict[str, float]:
    """Truth of a fit of this log."""
    return {
        "cd": log.scenario["aero"]["drag"],
        "cl": log.scenario["aero"]["lift"],
        "psi3": log.scenario["tunnel"]["psi3"],
        "current": log.extra["true_current_a"],
    }


def static_logs(tests: int, rest: float | None, duration: float = 20.0, seed: int = 0) -> Iterator[RunLog]:
    """Three tails, two axes, six angles, three speeds, `tests` logs each: 540 logs with five."""
    rng = np.random.default_rng(seed)
    number = 1000 * seed
    for tail in (1, 2, 3):
        for axis in ("major", "minor"):
            for degrees in ANGLES_DEG:
                for speed in SPEEDS:
                    scenario = static_scenario(tail, axis, degrees, speed, float(rng.uniform(-0.1, 0.1)))
                    scenario = scenario.varied(experiment={"duration": duration})
                    rig = Rig(scenario)
                    calm = Rig(scenario.varied(experiment={"wind_speed": 0.0}))
                    for _ in range(tests):
                        number += 1
                        one = scenario.varied(seed=number)
                        yield simulate_static_log(one, rig) if rest is None else log_with_rest(one, rig, calm, rest)
