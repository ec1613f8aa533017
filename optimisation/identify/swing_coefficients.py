"""What swings are fitted for: friction of bar and robot tail, and C_N of the robot tail over the relative speed.

Friction from free or motor-driven swings: thesis eq. 4.12 corrected, Tables 4.7 and 6.2. C_N is what the thesis tuned
by hand (section 6.3.3).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np

from aerodima.optimisation.identify.fit_parameters import Parameter
from aerodima.optimisation.identify.fit_pipeline import FitResult
from aerodima.optimisation.identify.log_rig import FREE, FitOptions
from aerodima.optimisation.identify.pendulum import Pendulum, Torque, air_torque, friction_torque
from aerodima.optimisation.identify.swing_fit import SwingModel, Values
from aerodima.optimisation.identify.swing_log import SwingData, swing_data
from aerodima.workbench.aero.laws import NormalForceLaw, SpeedLine, SpeedTable
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.resources import published_table

Shape = Literal["constant", "line", "bins"]
BIN = 2.0
"""Distance of the nodes of a table over the relative speed, m/s."""
_NODE = "cn_at_"
_SEED, _LOW, _HIGH = 2.0, 0.0, 10.0


def fit_friction_log(path: str | Path, *, stribeck: bool = False, options: FitOptions = FREE) -> FitResult:
    """Coulomb and viscous friction of a free swing, see `fit_friction`; of a bar swing or a robot swing.

    Raises:
        UserError: what is wrong with the log or the options.
    """
    log = read_run_log(path)
    kind = log.kind if log.kind in ("bar_swing", "robot_swing") else "bar_swing"
    return fit_friction(swing_data(log, kind, options=options), stribeck, options)


def fit_robot_tail_log(path: str | Path, *, shape: Shape = "constant", options: FitOptions = FREE) -> FitResult:
    """Normal-force coefficient of a robot swing as a function of the relative speed, see `fit_robot_tail`."""
    return fit_robot_tail(swing_data(read_run_log(path), "robot_swing", options=options), shape, options)


def fit_friction(data: SwingData, stribeck: bool = False, options: FitOptions = FREE) -> FitResult:
    """Coulomb and viscous friction of one swing.

    Args:
        data: a bar swing, or a robot swing (its air and motor are taken from its scenario).
        stribeck: also a breakaway torque that dies out with speed. It shows in the last swings before the tail stops:
            without one its speed is not determined and is named so. Two starts, with a small and with a large part.

    Raises:
        FitError: another kind of swing, or no rollout exists.
    """
    scenario = data.scenario
    if scenario.has_cheetah_tail:
        raise FitError(f"{data.name}: friction is fitted on bar or robot swings, not with a cheetah tail in the wind")
    coulomb, viscous = friction_seed(scenario.is_robot)
    facts = {"model": "stribeck" if stribeck else "smooth"}
    large = {"coulomb": 0.5 * coulomb, "breakaway_excess": coulomb, "stribeck_speed": 1.0}
    parameters = friction_parameters(coulomb, viscous, stribeck)
    return friction_model(data).fit(parameters, [large] if stribeck else [], facts=facts, options=options)


def friction_seed(robot: bool) -> tuple[float, float]:
    """Coulomb (N m) and viscous (N m s/rad) seed: Table 4.7 for the bar, Table 6.2 for the robot's tail."""
    table = published_table("robot_tail_friction" if robot else "bar_friction")
    record = "published_final_value" if robot else "seed"
    row = table[table.record == record].iloc[0]
    return float(row.coulomb_friction_n_m), float(row.viscous_friction_n_m_s_per_rad)


def friction_parameters(coulomb: float, viscous: float, stribeck: bool = False) -> list[Parameter]:
    """Cf and Vf from seeds; with `stribeck` also breakaway excess and Stribeck speed."""
    found = [
        Parameter("coulomb", "N m", coulomb, 0.0, 2.0, scale=0.05),
        Parameter("viscous", "N m s/rad", viscous, 0.0, 1.0, scale=0.02),
    ]
    if stribeck:
        found.append(Parameter("breakaway_excess", "N m", 0.01, 0.0, 2.0, scale=0.05))
        found.append(Parameter("stribeck_speed", "rad/s", 0.5, 0.02, 10.0, scale=0.5))
    return found


def friction_model(data: SwingData) -> SwingModel:
    """The rollout with the friction of the values; air and motor as in the scenario."""
    scenario = data.scenario
    air = air_torque(scenario)
    fixed = [air] if air is not None else []
    if scenario.is_robot:
        fixed.append(motor_of(scenario))
    gain = (scenario.robot_friction if scenario.is_robot else scenario.friction).tanh_gain

    def torques(values: Values) -> list[Torque]:
        stribeck = (values["breakaway_excess"], values["stribeck_speed"]) if "breakaway_excess" in values else ()
        return [*fixed, friction_torque(values["coulomb"], values["viscous"], gain, stribeck)]

    return SwingModel(data, Pendulum.of(scenario), torques, friction_model)


def motor_of(scenario: RigScenario) -> Torque:
    """The AK70-10 in MIT mode after the release: tau = kp (target - q) - kd w, within its torque (design section 6)."""
    kp, kd, goal = scenario.robot.kp, scenario.robot.kd, scenario.experiment.target
    limit = scenario.robot_motor.torque_limit

    def torque(angle: float, rate: float) -> float:
        return min(max(kp * (goal - angle) - kd * rate, -limit), limit)

    return torque


def fit_robot_tail(data: SwingData, shape: Shape = "constant", options: FitOptions = FREE) -> FitResult:
    """C_N of one swing as a constant, a line over the relative speed, or a table of bins.

    Raises:
        FitError: not a robot swing, or no rollout exists.
    """
    low, high = speed_range(data)
    facts = {"shape": shape, "kp": data.scenario.robot.kp, "least_speed_m_per_s": low, "most_speed_m_per_s": high}
    return robot_tail_model(data, shape).fit(shape_parameters(shape, data), facts=facts, options=options)


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
    return [Parameter(f"{_NODE}{node:g}", "1", _SEED, _LOW, _HIGH, scale=1.0) for node in nodes]


def normal_force_law(shape: Shape, values: Values, speeds: tuple[float, float]) -> NormalForceLaw:
    """C_N as `constant`, `line` or `bins` over the relative speed."""
    if shape == "constant":
        return NormalForceLaw(values["cn"])
    if shape == "line":
        return NormalForceLaw(SpeedLine(values["cn_slope"], values["cn_intercept"], speeds))
    nodes = {float(name.removeprefix(_NODE)): value for name, value in values.items() if name.startswith(_NODE)}
    return NormalForceLaw(SpeedTable(tuple(nodes), tuple(nodes.values())))


def robot_tail_model(data: SwingData, shape: Shape) -> SwingModel:
    """The rollout whose air has C_N of a shape; friction and motor as in the scenario."""
    scenario = data.scenario
    if not scenario.is_robot:
        raise FitError(f"{data.name}: is not a swing of the robot tail")
    friction = scenario.robot_friction
    fixed = [friction_torque(friction.coulomb, friction.viscous, friction.tanh_gain), motor_of(scenario)]
    low, high = speed_range(data)

    def torques(values: Values) -> list[Torque]:
        air = air_torque(scenario, normal_force_law(shape, values, (0.5 * low, 1.5 * high)))
        assert air is not None
        return [air, *fixed]

    return SwingModel(data, Pendulum.of(scenario), torques, lambda other: robot_tail_model(other, shape))
