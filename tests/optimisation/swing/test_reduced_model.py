"""The reduced model: signs, limits of physics, with and without pitch, agreement with the full car."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from aerodima.optimisation.swing import reduced_model as model
from aerodima.optimisation.swing.full_car import drive, varied
from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.turn_profile import turn_profile
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import SwingError
from aerodima.workbench.stations.car_air import sail_law
from tests.optimisation.swing.turn import car

STRAIGHT = np.array([0.0, 0.0, 4.5, 0.0, 0.0, 0.0])
STANDING = np.zeros(6)
UPRIGHT = np.zeros(())


def roll_acceleration(
    angle: float, rate: float = 0.0, acceleration: float = 0.0, inputs: np.ndarray = STRAIGHT, roll: float = 0.0
) -> float:
    tail = tuple(np.array([value]) for value in (angle, rate, acceleration))
    return float(model.motion(np.array(roll), UPRIGHT, tail, inputs, car())[0])


def test_a_tail_on_the_left_rolls_the_car_to_the_left_and_mirrored() -> None:
    left, right = (roll_acceleration(angle, inputs=STANDING) for angle in (-np.pi / 2, np.pi / 2))
    assert left < -1.0
    assert right > 1.0


def test_drag_beside_the_car_yaws_it_and_the_rear_tyres_hold_that_and_roll_it_outwards() -> None:
    # A tail on the left that faces the wind brakes the left side; the rear tyres push to the left to keep the course.
    assert roll_acceleration(-np.pi / 2) > roll_acceleration(-np.pi / 2, inputs=STANDING) + 5.0
    assert roll_acceleration(np.pi / 2) < roll_acceleration(np.pi / 2, inputs=STANDING) - 5.0


def test_a_tail_that_is_thrown_to_the_right_pushes_the_car_to_the_left() -> None:
    assert roll_acceleration(0.0, acceleration=50.0) < roll_acceleration(0.0) - 1.0


def test_air_on_a_tail_that_moves_to_the_right_pushes_the_car_to_the_left() -> None:
    assert roll_acceleration(0.0, rate=8.0) < roll_acceleration(0.0) - 1.0


def test_a_left_turn_rolls_the_car_to_the_right() -> None:
    assert roll_acceleration(0.0, inputs=np.array([0.7, 0.0, 4.5, 0.0, 1.0, 0.0])) > 5.0


def test_a_lifted_car_falls_back_below_its_tipping_angle_and_over_beyond_it() -> None:
    c = car()
    tipping = np.arctan2(c.half_track, c.com_height)
    below, beyond = (roll_acceleration(0.0, roll=share * tipping, inputs=STANDING) for share in (0.5, 1.4))
    assert below < 0.0 < beyond


def test_a_held_tail_asks_for_its_weight() -> None:
    c = car()
    tail = (np.array([-np.pi / 2]), np.zeros(1), np.zeros(1))
    _, torque = model.motion(UPRIGHT, UPRIGHT, tail, np.zeros(6), c)
    weight = c.tail_mass * c.tail_com * c.gravity
    assert torque[0] > 0.0
    assert 0.4 * weight < torque[0] < 1.1 * weight  # less what the car gives way to it


def test_linearisation_is_that_of_finite_differences() -> None:
    generator = np.random.default_rng(0)
    state = generator.normal(size=(5, 4)) * [0.1, 1.0, 0.5, 5.0]
    control, inputs = generator.normal(size=(5, 1)), np.tile([0.7, 0.05, 4.5, 0.1, 1.0, 0.1], (5, 1))
    A, B = model.linearise(state, control, inputs, car())
    for column in range(4):
        step = 1e-6 * np.eye(4)[column]
        ahead, behind = (model.derivative(state + sign * step, control, inputs, car()) for sign in (1, -1))
        assert np.allclose(A[..., column], (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-3)
    assert np.allclose(
        B[..., 0],
        model.derivative(state, control + 1, inputs, car()) - model.derivative(state, control, inputs, car()),
    )


def test_derivative_and_prescribed_motion_are_one_model() -> None:
    generator = np.random.default_rng(1)
    roll, rate = generator.normal(size=(2, 9)) * 0.1
    tail = tuple(generator.normal(size=(9, 1)) * size for size in (1.0, 5.0, 40.0))
    inputs = np.tile([0.7, 0.05, 4.5, 0.1, 1.0, 0.1], (9, 1))
    acceleration, torque = model.motion(roll, rate, tail, inputs, car())
    state = np.column_stack([roll, tail[0][:, 0], rate, tail[1][:, 0]])
    slope = model.derivative(state, torque, inputs, car())
    assert np.allclose(slope[:, 2], acceleration)
    assert np.allclose(slope[:, 3], tail[2][:, 0])


def test_a_pitch_at_zero_is_no_pitch() -> None:
    generator = np.random.default_rng(2)
    roll, rate = generator.normal(size=(2, 20)) * [[0.1], [0.5]]
    tail = tuple(generator.normal(size=(20, 1)) * size for size in (1.0, 5.0, 40.0))
    inputs = np.tile([0.7, 0.05, 4.5, 0.1, 1.0, 0.1], (20, 1))
    flat_acceleration, flat_torque = model.motion(roll, rate, tail, inputs, car())
    both = tuple(np.hstack([values, 0 * values]) for values in tail)
    acceleration, torque = model.motion(roll, rate, both, inputs, car())
    assert np.allclose(acceleration, flat_acceleration, rtol=1e-10)
    assert np.allclose(torque[:, 0], flat_torque[:, 0], rtol=1e-10)


def test_a_sail_pitched_forward_on_the_inside_is_pressed_down_by_the_wind() -> None:
    tail = lambda pitch: (np.array([-np.pi / 2, pitch]), np.zeros(2), np.zeros(2))  # noqa: E731
    steady = np.array([0.0, 0.0, 6.0, 0.0, 0.0, 0.0])
    torques = [model.motion(UPRIGHT, UPRIGHT, tail(p), steady, car())[1][0] for p in (-0.7, 0.0, 0.7)]
    assert torques[0] < torques[1] < torques[2]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["tail.mode=none"], "no tail"),
        (["tail.sail=free"], "locked"),
        (["tail.added_mass=0.02"], "added_mass"),
        (["wind.mean_x=2"], "still air"),
        (["tail.coefficients=robot_tail_line"], "constants"),
    ],
)
def test_a_car_that_the_models_do_not_know_is_refused(settings: list[str], words: str) -> None:
    with pytest.raises(SwingError, match=words):
        ReducedCar.of(load_scenario("turn_swing", settings))


def test_the_model_explains_the_full_car_and_rolls_like_it() -> None:
    """Between turn-in and turn-out, on two wheels: what the model lacks is small, and with it the roll is the same."""
    friction = 0.70
    scenario = varied(
        load_scenario("turn_designed"),
        manoeuvre={"speed": 4.5},
        car={"tyre_friction": friction},
        controller={"swing_speed": 5.0, "trigger_yaw_rate": 0.5},
    )
    log = drive(scenario, all_signals=True)
    c = ReducedCar.of(scenario)
    profile = turn_profile(log, c, 2.0, friction)
    time = np.arange(0.0, 0.45, 0.005)
    inputs = profile.at(time)
    weight = (c.mass + c.tail_mass) * c.gravity
    turning = time > 0.15
    assert np.sqrt(np.mean(inputs[turning, 5] ** 2)) < 0.1 * weight * c.half_track
    columns = ("tail_roll_angle_rad", "tail_roll_rate_rad_per_s")
    tail = [np.interp(time, log.time - 2.0, log.signal(name)) for name in columns]
    tail.append(np.gradient(tail[1], time))

    def slope(t: float, state: np.ndarray) -> list[float]:
        now = tuple(np.array([np.interp(t, time, values)]) for values in tail)
        turn = np.array([np.interp(t, time, column) for column in inputs.T])
        acceleration, _ = model.motion(np.array(state[0]), np.array(state[1]), now, turn, c)
        return [state[1], float(acceleration)]

    run = solve_ivp(slope, (0.0, time[-1]), profile.state_at(0.0), t_eval=time, method="LSODA", rtol=1e-4, atol=1e-5)
    measured = np.interp(time, profile.time, profile.roll)
    assert np.max(np.abs(run.y[0] - measured)) < 0.002


@pytest.mark.parametrize("rate", [-6.0, 6.0])
def test_hollow_and_round_side_of_the_sail_push_as_the_law_of_the_full_car_says(rate: float) -> None:
    """What the motor must add when the air is there: an upright tail on a car too heavy to give way."""
    scenario = load_scenario("turn_swing", ["tail.coefficients=half_cylinder", "tail.sail=locked"])
    law, _ = sail_law(scenario.tail)
    c = replace(ReducedCar.of(scenario), mass=1e9, inertia=1e9)
    assert c.force_along != c.force_against
    calm = replace(c, force_along=0.0, force_against=0.0)
    normal, up = (0.0, c.normal_side, 0.0), (0.0, 0.0, 1.0)
    sections = zip(c.section_distances, c.section_areas, strict=True)
    expected = sum(
        s * law.section_force((-STRAIGHT[2], s * rate, 0.0), up, normal, area, c.air_density)[1] for s, area in sections
    )
    for joints in (1, 2):
        tail = tuple(value * np.eye(joints)[0] for value in (0.0, rate, 0.0))
        torque = [model.motion(UPRIGHT, UPRIGHT, tail, STRAIGHT, which)[1][0] for which in (c, calm)]
        assert torque[0] - torque[1] == pytest.approx(expected, rel=1e-6)
        assert np.sign(expected) == np.sign(rate)
