"""The designed tail: the scenario that ships follows from the calculation, and the calculation from physics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from aerodima.optimisation.swing.tail_design import design_tail
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.plants.tail import arm_inertia

SCENARIO = load_scenario("turn_designed")


def test_scenario_that_ships_is_the_design() -> None:
    design = design_tail()
    for name, value in design.tail_parameters().items():
        assert getattr(SCENARIO.tail, name) == pytest.approx(value), name
    # It is another tail than the built one, in sail and mass.
    built = load_scenario("turn_swing").tail
    assert SCENARIO.tail.sail == "facing"
    assert built.sail_length * built.sail_width < 0.2 * design.geometry.area


def test_figures_in_the_scenarios_comment_are_those_of_the_design() -> None:
    design = design_tail()
    assert design.demand.peak_torque == pytest.approx(12.6, abs=0.06)
    assert design.demand.rms_torque == pytest.approx(3.7, abs=0.06)
    assert design.mass == pytest.approx(0.205, abs=0.0025)


def test_inertia_is_that_of_the_arm_the_model_builds() -> None:
    design = design_tail()
    arm = arm_inertia(SCENARIO.tail, SCENARIO.tail_motor, SCENARIO.car)
    rotor = SCENARIO.tail_motor.rotor_inertia * SCENARIO.tail_motor.gear_ratio**2
    # The model's mass is rounded up to 5 g, its share to a hundredth.
    assert design.demand.inertia == pytest.approx(arm.roll + rotor, rel=0.03)


def test_air_of_a_narrow_sail_at_one_point_is_half_rho_cd_a_v_squared() -> None:
    # A sail of 1 cm at the tip, in still air: one point moves with rate x length.
    design = design_tail(inner_end=0.89, speed=0.0)
    area, arm = design.geometry.area, design.geometry.centre_of_pressure()[2]
    force = 0.5 * SCENARIO.environment.air_density * 2.0 * area * (8.0 * arm) ** 2
    assert design.demand.air_force == pytest.approx(force, rel=1e-3)
    assert design.demand.air_torque == pytest.approx(force * arm, rel=1e-3)
    # Over the swing: the torque all along, the force at the mount's height by the cosine of the roll angle.
    angle = np.linspace(-math.pi / 2, math.pi / 2, 1001)
    moment = design.demand.air_torque + design.demand.air_force * SCENARIO.tail.mount_height * np.cos(angle)
    assert design.demand.air_impulse == pytest.approx(np.trapezoid(moment, angle) / 8.0, rel=1e-4)


def test_faster_swings_and_more_wind_ask_more() -> None:
    designs = [design_tail(swing_rate=rate) for rate in (4.0, 6.0, 8.0)]
    assert np.all(np.diff([d.demand.peak_torque for d in designs]) > 0.0)
    assert design_tail(speed=4.5).demand.air_torque < design_tail(speed=6.0).demand.air_torque


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass_budget": 0.15}, r"mass \(kg\) is 0.2\d*; allowed: at most 0.15"),
        ({"swing_rate": 16.0}, r"peak torque with margin \(N m\) is .*; allowed: at most 24.8"),
        ({"rated_torque": 1.0}, r"torque over a cycle \(N m\)"),
        ({"length": 1.9}, "leaves no sail"),
        ({"lenght": 1.0}, "lenght: unknown; allowed: length,"),
    ],
)
def test_what_does_not_fit_is_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(FitError, match=message):
        design_tail(**changes)
