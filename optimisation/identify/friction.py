"""Friction of bar and robot tail from free or motor-driven swings (thesis eq. 4.12 corrected, Tables 4.7 and 6.2)."""

from __future__ import annotations

from aerodima.optimisation.fit.fit_pipeline import FitResult
from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.published_tables import published
from aerodima.optimisation.identify.robot_tail import motor_of
from aerodima.optimisation.identify.swing_fit import SwingModel, friction_of, friction_parameters
from aerodima.optimisation.identify.swing_log import SwingData
from aerodima.optimisation.identify.swing_model import Pendulum, air_torque
from aerodima.workbench.errors import FitError


def friction_seed(robot: bool) -> tuple[float, float]:
    """Coulomb (N m) and viscous (N m s/rad) seed: Table 4.7 for the bar, Table 6.2 for the robot's tail."""
    table = published("robot_tail_friction" if robot else "bar_friction")
    record = "published_final_value" if robot else "seed"
    row = table[table.record == record].iloc[0]
    return float(row.coulomb_friction_n_m), float(row.viscous_friction_n_m_s_per_rad)


def friction_model(data: SwingData) -> SwingModel:
    """The rollout with the friction of the values; air and motor as in the scenario."""
    scenario = data.scenario
    air = air_torque(scenario)
    fixed = [air] if air is not None else []
    if scenario.is_robot:
        fixed.append(motor_of(scenario))
    gain = scenario.robot_friction.tanh_gain if scenario.is_robot else scenario.friction.tanh_gain
    return SwingModel(data, Pendulum.of(scenario), lambda values: [*fixed, friction_of(values, gain)], friction_model)


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
    model = friction_model(data)
    seed = friction_seed(scenario.is_robot)
    facts = {"model": "stribeck" if stribeck else "smooth"}
    large = {"coulomb": 0.5 * seed[0], "breakaway_excess": seed[0], "stribeck_speed": 1.0}
    starts = [large] if stribeck else []
    return model.fit(friction_parameters(*seed, stribeck), starts, facts=facts, options=options)
