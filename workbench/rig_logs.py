"""Logs of the rig in the project's schema, and the fast way to a static one.

A static log needs no simulation: the reaction at the held angle is computed once and the sensor's errors are added per
sample.
"""

from typing import Any

import numpy as np
import pandas as pd

from workbench.logs.columns import rig_columns
from workbench.logs.schema import RunLog, run_log_from_metadata, run_metadata
from workbench.plants.rig import Rig
from workbench.rig_scenario import RigScenario
from workbench.sensors.force_torque import sensor_errors, sensor_readings
from workbench.sensors.noise import CounterNoise
from workbench.sensors.rig_encoder import count_angle, quantise

RIG_COLUMN_NAMES = tuple(column.name for column in rig_columns())
NO_OFFSETS = (0.0,) * 6
"""Of the bare bar and the robot's tail, for which none are published."""


def sensor_offsets(scenario: RigScenario) -> tuple[float, ...]:
    """What the force sensor was zeroed at in an experiment (6), N and N m: add it to a reading."""
    return scenario.cheetah_tail.offsets if scenario.has_cheetah_tail else NO_OFFSETS


def rig_log_metadata(scenario: RigScenario, **facts: Any) -> dict[str, Any]:
    """Metadata of a rig log: kind, and in `extra` tail, axis, wind_speed_m_per_s, the offsets, and further facts."""
    experiment = scenario.experiment
    extra = {
        "tail": scenario.tail_name,
        "axis": experiment.axis if scenario.has_cheetah_tail else "none",
        "wind_speed_m_per_s": experiment.wind_speed,
        "offsets_to_add": list(sensor_offsets(scenario)),
        **facts,
    }
    return run_metadata(scenario.resolved(), scenario.seed, kind=experiment.kind, extra=extra)


def simulate_static_log(scenario: RigScenario, rig: Rig | None = None) -> RunLog:
    """The log of a static hold.

    Args:
        scenario: `experiment.kind` must be `static`; its seed gives bias, drift and noise.
        rig: of the same scenario, when there is one already.

    Returns:
        A log whose `extra` has, beside what every rig log has, the truth: `true_current_a`, `true_wrench` (6), `bias`
        (6, N and N m), `exposed`.

    Raises:
        UserError: holding takes a current beyond the limit.
        ModelError: see `add_rig_plant`.
    """
    rig = rig or Rig(scenario)
    angle = scenario.experiment.angle
    current = rig.holding_current(angle)
    wrench = rig.reaction_at_current(angle, 0.0, current).wrench
    rate = scenario.simulation.log_rate
    count = round(scenario.experiment.duration * rate) + 1
    time = np.arange(count) / rate
    sensor = scenario.force_sensor
    samples = sensor_readings(
        wrench, int(np.floor(time[-1] * sensor.rate + 1e-6)) + 1, sensor, sensor_offsets(scenario), scenario.seed
    )
    readings = samples[np.floor(time * sensor.rate + 1e-6).astype(int)]
    table = np.empty((count, len(RIG_COLUMN_NAMES)))
    table[:, 0] = time
    table[:, 1] = quantise(angle, count_angle(scenario))
    table[:, 2] = 0.0
    noise = CounterNoise(scenario.seed, "maxon_current", 1).first(count)[:, 0]
    table[:, 3] = current + scenario.maxon.current_noise * noise
    table[:, 4:] = readings
    metadata = rig_log_metadata(
        scenario,
        true_current_a=current,
        true_wrench=wrench.tolist(),
        bias=sensor_errors(sensor, scenario.seed).bias.tolist(),
        exposed=rig.is_exposed(angle),
    )
    return run_log_from_metadata(pd.DataFrame(table, columns=list(RIG_COLUMN_NAMES)), metadata)
