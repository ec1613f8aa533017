"""C_N of the robot tail over the relative speed, from its swings (what the thesis tuned by hand, section 6.3.3)."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from aerodima.optimisation.fit.fit_parameters import Parameter
from aerodima.optimisation.fit.fit_pipeline import FitResult
from aerodima.optimisation.fit.least_squares import Problem
from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.swing_fit import SwingModel, normal_force_law
from aerodima.optimisation.identify.swing_log import SwingData
from aerodima.optimisation.identify.swing_model import Pendulum, Torque, air_torque, friction_torque
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.errors import FitError

Shape = Literal["constant", "line", "bins"]
BIN = 2.0
"""Distance of the nodes of a table over the relative speed, m/s."""
_SEED, _LOW, _HIGH = 2.0, 0.0, 10.0


def motor_of(scenario: RigScenario) -> Torque:
    """The AK70-10 in MIT mode after the release: tau = kp (target - q) - kd w, within its torque (design section 6)."""
    kp, kd, goal = scenario.robot.kp, scenario.robot.kd, scenario.experiment.target
    limit = scenario.robot_motor.torque_limit

    def torque(angle: float, rate: float) -> float:
        return min(max(kp * (goal - angle) - kd * rate, -limit), limit)

    return torque


def speed_range(data: SwingData) -> tuple[float, float]:
    """Lowest and highest relative speed at the middle of the sail, m/s."""
    tail, wind = data.scenario.robot_tail, data.scenario.experiment.wind_speed
    middle = tail.length - 0.5 * tail.sail_length
    tip = middle * np.gradient(data.angle, data.time)
    # Downstream is -y: the tail's own speed across the wind takes away from it.
    speed = np.hypot(wind - tip * np.cos(data.angle), tip * np.sin(data.angle))
    return float(np.min(speed)), float(np.max(speed))


def shape_parameters(shape: Shape, data: SwingData) -> list[Parameter]:
    """The unknowns of a shape; nodes of `bins` stand every 2 m/s over the speeds of the swing."""
    if shape == "constant":
        return [Parameter("cn", "1", _SEED, _LOW, _HIGH, scale=1.0)]
    if shape == "line":
        # Line over 160 published values: ERRATA E26.
        return [
            Parameter("cn_slope", "s/m", 0.0449, -2.0, 2.0, scale=0.1),
            Parameter("cn_intercept", "1", 1.581, -10.0, 10.0, scale=1.0),
        ]
    low, high = speed_range(data)
    nodes = np.arange(BIN * math.floor(low / BIN), BIN * math.ceil(high / BIN) + 0.5 * BIN, BIN)
    return [Parameter(f"cn_at_{node:g}", "1", _SEED, _LOW, _HIGH, scale=1.0) for node in nodes]


def robot_tail_model(data: SwingData, shape: Shape) -> SwingModel:
    """The rollout whose air has C_N of a shape; friction and motor as in the scenario."""
    scenario = data.scenario
    if not scenario.is_robot:
        raise FitError(f"{data.name}: is not a swing of the robot tail")
    friction = scenario.robot_friction
    fixed = [friction_torque(friction.coulomb, friction.viscous, friction.tanh_gain), motor_of(scenario)]
    low, high = speed_range(data)
    speeds = (0.5 * low, 1.5 * high)

    def torques(values: dict[str, float]) -> list[Torque]:
        air = air_torque(scenario, normal_force_law(shape, values, speeds))
        assert air is not None
        return [air, *fixed]

    return SwingModel(data, Pendulum.of(scenario), torques, lambda other: robot_tail_model(other, shape))  # type: ignore[arg-type]


def robot_tail_problem(data: SwingData, shape: Shape) -> Problem:
    """The least-squares problem of one swing."""
    return robot_tail_model(data, shape).problem(shape_parameters(shape, data))


def fit_robot_tail(data: SwingData, shape: Shape = "constant", options: FitOptions = FREE) -> FitResult:
    """C_N of one swing as a constant, a line over the relative speed, or a table of bins.

    Raises:
        FitError: not a robot swing, or no rollout exists.
    """
    low, high = speed_range(data)
    facts = {"shape": shape, "kp": data.scenario.robot.kp, "least_speed_m_per_s": low, "most_speed_m_per_s": high}
    return robot_tail_model(data, shape).fit(shape_parameters(shape, data), facts=facts, options=options)
