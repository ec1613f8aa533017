"""The log of a static hold: one state of the plant, read by the sensors as long as it is held."""

import numpy as np
import pandas as pd

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.schema import RunLog, run_log_from_metadata
from aerodima.workbench.rig.rig_log import RIG_COLUMN_NAMES, known_truth, rig_log_metadata
from aerodima.workbench.rig.rig_plant import Rig
from aerodima.workbench.rig.rig_sensors import (
    current_errors,
    force_errors,
    quantise,
)
from aerodima.workbench.scenario.rig_scenario import RigScenario


def simulate_static_log(
    scenario: RigScenario, rig: Rig | None = None, calm: Rig | None = None
) -> RunLog:
    """Simulates the log of a static hold, which begins with a rest without wind when
    `experiment.wind_off` asks for one.

    The wind is there at once after the rest, and the motor holds the angle throughout.

    Args:
        scenario: scenario whose `experiment.kind` is `static`; its seed gives bias, drift and
            noise.
        rig: rig of the same scenario, when there is one already.
        calm: the same rig without wind, likewise; it is needed only for a rest.

    Returns:
        A log whose `extra` has, beside the entries of every rig log, `truth` (cd, cl, psi3, current
        in A), `true_wrench` in the wind (6), `bias` (6, N and N m), `exposed`, and after a rest
        `rest_s`, its first and last time.

    Raises:
        UserError: holding takes a current beyond the limit.
        ModelError: see `add_rig_plant`.
    """
    rig = rig or Rig(scenario)
    experiment = scenario.experiment
    sensor = scenario.force_sensor
    current, wrench = _hold(rig, experiment.angle)
    rate = scenario.simulation.log_rate
    time = np.arange(round(experiment.duration * rate) + 1) / rate
    count = len(time)
    currents = np.full(count, current)
    newest_sample = np.floor(time * sensor.rate + 1e-6).astype(int)
    sample_time = np.arange(newest_sample[-1] + 1) / sensor.rate
    wrenches = np.tile(wrench, (len(sample_time), 1))
    facts: Json = {}
    if experiment.wind_off > 0.0:
        calm = calm or Rig(scenario.varied(experiment={"wind_speed": 0.0}))
        still_current, still_wrench = _hold(calm, experiment.angle)
        end = experiment.wind_off + 1e-9
        resting = time <= end
        currents[resting] = still_current
        wrenches[sample_time <= end] = still_wrench
        facts["rest_s"] = [0.0, float(time[resting][-1])]
    errors = force_errors(sensor, scenario.sensor_offsets, scenario.seed)
    readings = errors.first_readings(wrenches, len(sample_time), sensor.rate)[newest_sample]
    noise = current_errors(scenario.maxon.current_noise, scenario.seed)
    logged_currents = noise.first_readings(currents[:, None], count, rate)
    angles = np.full(count, quantise(experiment.angle, scenario.count_angle))
    table = np.column_stack([time, angles, np.zeros(count), logged_currents, readings])
    metadata = rig_log_metadata(
        scenario,
        truth={**known_truth(scenario), "current": current},
        true_wrench=wrench.tolist(),
        bias=errors.bias.tolist(),
        exposed=rig.is_exposed(experiment.angle),
        **facts,
    )
    return run_log_from_metadata(pd.DataFrame(table, columns=list(RIG_COLUMN_NAMES)), metadata)


def _hold(rig: Rig, angle: float) -> tuple[float, FloatArray]:
    """Returns the current (A) that holds an angle (rad), and the support's wrench then (6)."""
    current = rig.holding_current(angle)
    return current, rig.reaction(angle, 0.0, rig.torque_of(current)).wrench
