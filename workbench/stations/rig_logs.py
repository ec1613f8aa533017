"""Logs of the rig in the project's schema, and the fast way to a static one.

A static log needs no simulation: the reaction at the held angle is computed once and the sensor's errors are added per
sample.
"""

import math
from typing import Any

import numpy as np
import pandas as pd

from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.config.signal_table import names_of, rig_columns
from aerodima.workbench.logs.schema import RunLog, run_log_from_metadata, run_metadata
from aerodima.workbench.plants.rig import Rig
from aerodima.workbench.plants.rig_air import rig_law
from aerodima.workbench.sensors.force_torque import sensor_errors, sensor_readings
from aerodima.workbench.sensors.rig_encoder import count_angle, quantise
from aerodima.workbench.sensors.sampled import CounterNoise

RIG_COLUMN_NAMES = tuple(names_of(rig_columns()))
NO_OFFSETS = (0.0,) * 6
"""Of the bare bar and the robot's tail, for which none are published."""


def sensor_offsets(scenario: RigScenario) -> tuple[float, ...]:
    """What the force sensor was zeroed at in an experiment (6), N and N m: add it to a reading."""
    return scenario.cheetah_tail.offsets if scenario.has_cheetah_tail else NO_OFFSETS


def rig_log_metadata(scenario: RigScenario, **facts: Any) -> dict[str, Any]:
    """Metadata of a rig log: kind, and in `extra` tail, axis, wind speed, offsets, current sampling and more facts."""
    experiment = scenario.experiment
    extra = {
        "tail": scenario.tail_name,
        "axis": experiment.axis if scenario.has_cheetah_tail else "none",
        "wind_speed_m_per_s": experiment.wind_speed,
        "offsets_to_add": list(sensor_offsets(scenario)),
        "current_sampling": "mean",
        **facts,
    }
    return run_metadata(scenario.resolved(), scenario.seed, kind=experiment.kind, extra=extra)


def known_truth(scenario: RigScenario) -> dict[str, float]:
    """What the fits of a simulated log should find, by their names and in their units; without the holding current."""
    experiment, aero = scenario.experiment, scenario.aero
    if experiment.kind == "static":
        drag, lift = static_coefficients(scenario)
        return {"cd": drag, "cl": lift, "psi3": scenario.tunnel.psi3}
    if experiment.kind == "swing":
        return {"added_mass": aero.added_mass}
    friction = scenario.robot_friction if scenario.is_robot else scenario.friction
    return {"coulomb": friction.coulomb, "viscous": friction.viscous}


def static_coefficients(scenario: RigScenario) -> tuple[float, float]:
    """C_D and C_L at the wind speed and the angle of attack of a static hold."""
    speed, tunnel = scenario.experiment.wind_speed, scenario.tunnel
    attack = math.asin(abs(math.sin(scenario.experiment.angle + tunnel.misalignment)) * math.cos(tunnel.psi3))
    law, _ = rig_law(scenario)
    assert isinstance(law, PolarLaw)
    drag, lift = (value(speed, attack) if callable(value) else value for value in (law.drag, law.lift))
    return float(drag), float(lift)


def simulate_static_log(scenario: RigScenario, rig: Rig | None = None, calm: Rig | None = None) -> RunLog:
    """The log of a static hold, with a rest without wind in front when `experiment.wind_off` asks for one.

    The wind is there at once after the rest, and the motor holds the angle throughout.

    Args:
        scenario: `experiment.kind` must be `static`; its seed gives bias, drift and noise.
        rig: of the same scenario, when there is one already.
        calm: the same without wind, likewise; asked only for a rest.

    Returns:
        A log whose `extra` has, beside what every rig log has, `truth` (cd, cl, psi3, current in A), `true_wrench` in
        the wind (6), `bias` (6, N and N m), `exposed`, and after a rest `rest_s`, its first and last time.

    Raises:
        UserError: holding takes a current beyond the limit.
        ModelError: see `add_rig_plant`.
    """
    rig = rig or Rig(scenario)
    experiment, sensor = scenario.experiment, scenario.force_sensor
    current, wrench = _hold(rig, experiment.angle)
    rate = scenario.simulation.log_rate
    count = round(experiment.duration * rate) + 1
    time = np.arange(count) / rate
    sampled = int(np.floor(time[-1] * sensor.rate + 1e-6)) + 1
    currents, wrenches = np.full(count, current), np.tile(wrench, (sampled, 1))
    facts: dict[str, Any] = {}
    if experiment.wind_off > 0.0:
        still_current, still = _hold(calm or Rig(scenario.varied(experiment={"wind_speed": 0.0})), experiment.angle)
        wrenches[np.arange(sampled) / sensor.rate <= experiment.wind_off + 1e-9] = still
        resting = time <= experiment.wind_off + 1e-9
        currents[resting] = still_current
        facts["rest_s"] = [0.0, float(time[resting][-1])]
    samples = sensor_readings(wrenches, sampled, sensor, sensor_offsets(scenario), scenario.seed)
    table = np.empty((count, len(RIG_COLUMN_NAMES)))
    table[:, 0] = time
    table[:, 1] = quantise(experiment.angle, count_angle(scenario))
    table[:, 2] = 0.0
    table[:, 3] = (
        currents + scenario.maxon.current_noise * CounterNoise(scenario.seed, "maxon_current", 1).first(count)[:, 0]
    )
    table[:, 4:] = samples[np.floor(time * sensor.rate + 1e-6).astype(int)]
    metadata = rig_log_metadata(
        scenario,
        truth={**known_truth(scenario), "current": current},
        true_wrench=wrench.tolist(),
        bias=sensor_errors(sensor, scenario.seed).bias.tolist(),
        exposed=rig.is_exposed(experiment.angle),
        **facts,
    )
    return run_log_from_metadata(pd.DataFrame(table, columns=list(RIG_COLUMN_NAMES)), metadata)


def _hold(rig: Rig, angle: float) -> tuple[float, np.ndarray]:
    """Current (A) that holds an angle (rad), and the wrench of the support then (6)."""
    current = rig.holding_current(angle)
    return current, rig.reaction_at_current(angle, 0.0, current).wrench
