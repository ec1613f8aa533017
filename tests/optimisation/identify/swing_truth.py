"""Swings whose truth is known: the pendulum's rollout, read by the encoder and the current sensor
of the rig.

A test shows that the pendulum moves as the rig's plant does; the rollout takes milliseconds where
the plant takes seconds.
"""

import math

import numpy as np
import pandas as pd

from aerodima.optimisation.identify.fit_options import FREE
from aerodima.optimisation.identify.swing_coefficients import (
    added_mass_parameter,
    motor_of,
    still_tail_law,
)
from aerodima.optimisation.identify.swing_fit import SwingModel
from aerodima.optimisation.identify.swing_log import swing_data
from aerodima.workbench.aero.section_laws import NormalForceLaw
from aerodima.workbench.logs.schema import run_log_from_metadata
from aerodima.workbench.rig.pendulum import (
    PendulumModel,
    air_torque,
    friction_torque,
    known_friction,
)
from aerodima.workbench.rig.rig_log import rig_log_metadata
from aerodima.workbench.rig.swing_motion import simulate_swing
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario

RATE = 1000.0


def bar_log(coulomb, viscous, angle=1.5, duration=5.0):
    """A free swing of the bare bar, let go at once."""
    scenario = load_rig_scenario("bar").varied(
        experiment={"angle": angle, "duration": duration, "rest": 0.0}
    )
    return _log(scenario, [friction_torque(coulomb, viscous, 10.0)])


def flick_log(added_mass, seed, wind_speed=10.0, duration=1.5):
    """Tail 1 let go at 60 degrees and driven by a current that is logged with its noise."""
    scenario = load_rig_scenario("flick").varied(
        experiment={
            "angle": math.radians(60.0),
            "wind_speed": wind_speed,
            "duration": duration,
            "rest": 0.0,
        },
        seed=seed,
    )
    torques = [air_torque(scenario), known_friction(scenario)]
    time = np.arange(round(duration * RATE)) / RATE
    rng = np.random.default_rng(seed)
    current = 1.5 * np.sin(2.0 * math.pi * (1.0 + rng.uniform()) * time)
    noise = scenario.maxon.current_noise * rng.normal(size=len(time))
    return _log(scenario, torques, added_mass, current, noise)


def added_mass_of(log, options=FREE):
    """Fits the added mass of a flick with exact constants of the rig."""
    data = swing_data(log, "swing", options=options)
    return SwingModel(data, still_tail_law).fit([added_mass_parameter(data)], exact=True)


def robot_log(cn, angle, wind_speed, kp, duration=2.0):
    """The robot's tail let go under its motor, with a constant C_N; only the counts of its angle
    are not exact.
    """
    scenario = load_rig_scenario("robot").varied(
        experiment={"angle": angle, "wind_speed": wind_speed, "duration": duration, "rest": 0.0},
        robot={"kp": kp},
    )
    air = air_torque(scenario, NormalForceLaw(cn))
    return _log(scenario, [air, known_friction(scenario), motor_of(scenario)])


def _log(scenario, torques, added_mass=0.0, current=0.0, noise=0.0):
    count = round(scenario.experiment.duration * RATE) + 1
    current = np.full(count - 1, current)
    angle, rate = simulate_swing(
        PendulumModel.from_scenario(scenario),
        torques,
        (scenario.experiment.angle, 0.0),
        1.0 / RATE,
        count,
        motor=(-scenario.maxon.torque_constant * current).tolist(),
        added_mass=added_mass,
    )
    step = scenario.count_angle
    if scenario.is_robot:
        # Its position in a reply has 16 bits.
        step = 2.0 * scenario.robot_motor.position_range / (2**16 - 1)
    table = pd.DataFrame(
        {
            "time_s": np.arange(count) / RATE,
            "angle_rad": np.round(angle / step) * step,
            "angular_velocity_rad_per_s": rate,
            # The current of a step is logged at the end of that step.
            "current_a": np.append(0.0, current + noise),
        }
    )
    return run_log_from_metadata(table, rig_log_metadata(scenario, truth={}))
