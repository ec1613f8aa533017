"""Fits of swings: friction of bar and robot tail, added mass of a cheetah tail, C_N of
the robot tail.

Friction is fitted to free or motor-driven swings (thesis eq. 4.12 corrected, Tables 4.7 and 6.2).
Added mass is fitted to the position only (section 4.9). C_N over the relative speed is the quantity
that the thesis tuned by hand (section 6.3.3).
"""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.fit_result import FitResult
from aerodima.optimisation.identify.least_squares import Parameter
from aerodima.optimisation.identify.swing_fit import SwingModel, TorqueLaw
from aerodima.optimisation.identify.swing_log import SwingData, swing_data
from aerodima.workbench.aero.section_laws import NormalForceLaw, SpeedTable, speed_line
from aerodima.workbench.car.tail_plant import ADDED_MASS_PARTS, MIN_INERTIA_FRACTION
from aerodima.workbench.core.array_types import Pair, Values
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.resources import published_table
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.rig.pendulum import (
    PendulumModel,
    Torque,
    air_torque,
    friction_torque,
    known_friction,
)
from aerodima.workbench.scenario.rig_scenario import RigScenario

Shape = Literal["constant", "line", "bins"]
BIN = 2.0
"""Distance of the nodes of a table over the relative speed, m/s."""
_NODE = "cn_at_"
_INITIAL = 2.0
"""Initial value of a normal-force coefficient."""
_LOW = 0.0
"""Lower bound of a normal-force coefficient."""
_HIGH = 10.0
"""Upper bound of a normal-force coefficient."""
_MAX_ADDED_MASS = 1.0
"""Largest added mass, kg per part: twice the bound of Table 4.12, at which one published swing
stopped."""
_SCANNED = 24
"""Number of masses that are scanned."""
_SCANNED_LENGTH = 1.0
"""Length of the swing over which they are scanned, s."""


def fit_friction_log(path: str | Path, *, options: FitOptions = FREE) -> FitResult:
    """Fit Coulomb and viscous friction of a bar swing or a robot swing, see `fit_friction`.

    Raises:
        UserError: something is wrong with the log or the options.
    """
    log = read_run_log(path)
    kind = log.kind if log.kind in ("bar_swing", "robot_swing") else "bar_swing"
    return fit_friction(swing_data(log, kind, options=options), options)


def fit_added_mass_log(path: str | Path, *, options: FitOptions = FREE) -> FitResult:
    """Fit the added mass per part of a swing (kg), see `fit_added_mass`.

    Raises:
        UserError: something is wrong with the log or the options.
    """
    return fit_added_mass(swing_data(read_run_log(path), "swing", options=options), options)


def fit_robot_tail_log(
    path: str | Path, *, shape: Shape = "constant", options: FitOptions = FREE
) -> FitResult:
    """Fit the normal-force coefficient of a robot swing over the relative speed, see
    `fit_robot_tail`.
    """
    return fit_robot_tail(
        swing_data(read_run_log(path), "robot_swing", options=options), shape, options
    )


def fit_friction(data: SwingData, options: FitOptions = FREE) -> FitResult:
    """Fit Coulomb and viscous friction of one swing.

    Args:
        data: bar swing, or robot swing, whose air and motor are taken from its scenario.
        options: loss and bounds of the fit.

    Raises:
        FitError: no rollout exists.
    """
    return SwingModel(data, friction_law).fit(
        friction_parameters(data.scenario.is_robot), options=options
    )


def friction_parameters(robot: bool = False) -> list[Parameter]:
    """Make the parameters of Coulomb and viscous friction, with initial values of Table 4.7 (bar)
    or Table 6.2 (the robot's tail).
    """
    name, record = "bar_friction", "seed"
    if robot:
        name, record = "robot_tail_friction", "published_final_value"
    table = published_table(name)
    row = table[table.record == record].iloc[0]
    coulomb = float(row.coulomb_friction_n_m)
    viscous = float(row.viscous_friction_n_m_s_per_rad)
    return [
        Parameter("coulomb", "N m", coulomb, 0.0, 2.0, scale=0.05),
        Parameter("viscous", "N m s/rad", viscous, 0.0, 1.0, scale=0.02),
    ]


def friction_law(data: SwingData) -> TorqueLaw:
    """Make the law with the friction of the values; air and motor are as in the scenario."""
    scenario = data.scenario
    fixed = _air(scenario)
    if scenario.is_robot:
        fixed.append(motor_of(scenario))
    gain = scenario.joint_friction.tanh_gain
    return lambda values: [*fixed, friction_torque(values["coulomb"], values["viscous"], gain)]


def motor_of(scenario: RigScenario) -> Torque:
    """Make the AK70-10 in MIT mode after the release: tau = kp (target - q) - kd w, within its
    torque (design section 6).
    """
    kp = scenario.robot.kp
    kd = scenario.robot.kd
    goal = scenario.experiment.target
    limit = scenario.robot_motor.torque_limit

    def torque(angle: float, rate: float) -> float:
        return min(max(kp * (goal - angle) - kd * rate, -limit), limit)

    return torque


def potential_flow_mass(data: SwingData) -> float:
    """Compute rho pi R^2 times the length of one part (eq. 2.6), kg: a cylinder of the mean
    width.
    """
    tail = data.scenario.cheetah_tail
    density = data.scenario.environment.air_density
    radius = 0.25 * (tail.major_axis + tail.minor_axis)
    return density * math.pi * radius**2 * tail.length / ADDED_MASS_PARTS


def still_tail_law(data: SwingData) -> TorqueLaw:
    """Make the law with the quasi-steady coefficients of the tail and the published friction, which
    no values change.
    """
    torques = [known_friction(data.scenario), *_air(data.scenario)]
    return lambda values: torques


def _air(scenario: RigScenario) -> list[Torque]:
    """Make the torque of the air on the tail; none where there is no wind or tail."""
    air = air_torque(scenario)
    return [] if air is None else [air]


def added_mass_parameter(data: SwingData) -> Parameter:
    """Make the parameter of the added mass, from 0, up to 1 kg per part; it may be negative, but at
    least 3 % of the inertia must be left.
    """
    least = (1.0 - MIN_INERTIA_FRACTION) * PendulumModel.from_scenario(data.scenario).min_added_mass
    return Parameter("added_mass", "kg", 0.0, least, _MAX_ADDED_MASS, scale=0.02)


def fit_added_mass(data: SwingData, options: FitOptions = FREE) -> FitResult:
    """Fit the added mass per part of one swing from zero, Table 4.12 at the nearest wind, and a
    scan; the start that ends lowest counts.

    The published mass is no start where it takes away more inertia than the tail has (tail 1 at
    10 m/s).

    Raises:
        FitError: no rollout exists.
    """
    model = SwingModel(data, still_tail_law)
    (free,) = options.bounded([added_mass_parameter(data)])
    table = published_table("added_mass_seeds")
    nearest = np.argmin(np.abs(table.wind_speed_m_per_s - data.scenario.experiment.wind_speed))
    starts = [float(table.x0_kg.iloc[int(nearest)]), coarse_scan(model, free.lower, free.upper)]
    starts = [mass for mass in starts if free.lower <= mass <= free.upper]
    result = model.fit([free], [{"added_mass": mass} for mass in starts], options=options)
    none = replace(free, initial=0.0, fixed=True)
    without = model.fit([none], options=replace(options, bounds=()), exact=True)
    facts = {
        "times_potential_flow": result["added_mass"].value / potential_flow_mass(data),
        "angle_rms_without_rad": without.residual_rms["angle"],
        "angle_rms_with_rad": result.residual_rms["angle"],
    }
    return replace(result, facts={**result.facts, **facts})


def coarse_scan(model: SwingModel, low: float, high: float) -> float:
    """Find the mass (kg) of the least cost over the first second of the swing, among masses whose
    frequencies are evenly spaced.

    Later, a swing of another frequency has slipped by a whole period, where the cost has other
    minima.
    """
    data = model.data
    pendulum = model.pendulum
    inertia = np.array([pendulum.total_inertia(low), pendulum.total_inertia(high)])
    frequencies = np.linspace(inertia[1] ** -0.5, inertia[0] ** -0.5, _SCANNED)
    masses = np.clip((frequencies**-2.0 - pendulum.inertia) / pendulum.added_arms, low, high)
    count = min(int(_SCANNED_LENGTH / data.step) + 1, len(data.time))
    start = {"start_angle": data.angle[0], "start_rate": data.start_rate}

    def cost(mass: float) -> float:
        try:
            angles, _ = model.motion({"added_mass": mass, **start}, count)
        except FitError:
            return math.inf
        return float(np.sum(np.square(angles - data.angle[:count])))

    return float(min(masses.tolist(), key=cost))


def fit_robot_tail(
    data: SwingData, shape: Shape = "constant", options: FitOptions = FREE
) -> FitResult:
    """Fit C_N of one swing as a constant, a line over the relative speed, or a table of bins.

    Args:
        data: robot swing.
        shape: shape of C_N over the relative speed: `constant`, `line` or `bins`.
        options: loss and bounds of the fit.

    Raises:
        FitError: no rollout exists.
    """
    low, high = speed_range(data)
    facts = {
        "shape": shape,
        "kp": data.scenario.robot.kp,
        "least_speed_m_per_s": low,
        "most_speed_m_per_s": high,
    }
    model = SwingModel(data, partial(robot_tail_law, shape))
    return model.fit(shape_parameters(shape, data), facts=facts, options=options)


def speed_range(data: SwingData) -> Pair:
    """Find the lowest and highest relative speed at the middle of the sail, m/s."""
    tail = data.scenario.robot_tail
    wind = data.scenario.experiment.wind_speed
    middle = tail.length - 0.5 * tail.sail_length
    tip = middle * np.gradient(data.angle, data.time)
    # Downstream is -y: the tail's own speed across the wind takes away from it.
    speed = np.hypot(wind - tip * np.cos(data.angle), tip * np.sin(data.angle))
    return float(np.min(speed)), float(np.max(speed))


def shape_parameters(shape: Shape, data: SwingData) -> list[Parameter]:
    """Make the unknowns of a shape; nodes of `bins` stand every 2 m/s over the speeds of the
    swing.
    """
    if shape == "constant":
        return [Parameter("cn", "1", _INITIAL, _LOW, _HIGH, scale=1.0)]
    if shape == "line":
        # Line over 160 published values: ERRATA E26.
        return [
            Parameter("cn_slope", "s/m", 0.0449, -2.0, 2.0, scale=0.1),
            Parameter("cn_intercept", "1", 1.581, -10.0, 10.0, scale=1.0),
        ]
    low, high = speed_range(data)
    nodes = np.arange(BIN * math.floor(low / BIN), BIN * math.ceil(high / BIN) + 0.5 * BIN, BIN)
    return [Parameter(f"{_NODE}{node:g}", "1", _INITIAL, _LOW, _HIGH, scale=1.0) for node in nodes]


def normal_force_law(shape: Shape, values: Values, speeds: Pair) -> NormalForceLaw:
    """Make C_N as `constant`, `line` or `bins` over the relative speed."""
    if shape == "constant":
        return NormalForceLaw(values["cn"])
    if shape == "line":
        return NormalForceLaw(speed_line(values["cn_slope"], values["cn_intercept"], speeds))
    names = [name for name in values if name.startswith(_NODE)]
    speeds_of_nodes = tuple(float(name.removeprefix(_NODE)) for name in names)
    return NormalForceLaw(SpeedTable(speeds_of_nodes, tuple(values[name] for name in names)))


def robot_tail_law(shape: Shape, data: SwingData) -> TorqueLaw:
    """Make the law of the air with C_N of a shape; friction and motor are as in the scenario."""
    scenario = data.scenario
    fixed = [known_friction(scenario), motor_of(scenario)]
    low, high = speed_range(data)

    def torques(values: Values) -> list[Torque]:
        air = air_torque(scenario, normal_force_law(shape, values, (0.5 * low, 1.5 * high)))
        assert air is not None
        return [air, *fixed]

    return torques
