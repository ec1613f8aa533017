"""The law that follows steering, roll and roll rate: directions, limits, return, and what it does without signals."""

import math
from dataclasses import replace

import numpy as np
import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.signal_table import IMU
from aerodima.workbench.controllers.feedback_law import GYRO_X, ROLL, FeedbackLaw, Seen, respond
from aerodima.workbench.controllers.law_of_scenario import law_of_scenario
from aerodima.workbench.controllers.swing_law import SwingLaw, SwingState
from aerodima.workbench.controllers.tail_law import Observation

NUMBERS = {
    "steering_gain": -5.2,
    "roll_gain": 14,
    "roll_rate_gain": 3.3,
    "threshold": 1.9,
    "most_speed": 6.7,
    "most_roll": 1.4,
}
SCENARIO = load_scenario(
    "entry_turn", ["controller.law=feedback", *(f"feedback.{name}={value}" for name, value in NUMBERS.items())]
)
LAW = law_of_scenario(SCENARIO)
assert isinstance(LAW, FeedbackLaw)
GAINS = LAW.gains


def seen(roll: float = 0.0, roll_rate: float = 0.0, steering: float = 0.0, tail: float = 0.0, **changes) -> Observation:
    imu = [0.0] * IMU.size
    imu[ROLL], imu[GYRO_X] = roll, roll_rate
    found = Observation(1.0, 0.0, tail, 0.0, 0.0, True, imu=tuple(imu), speed=4.0, steering_angle=steering)
    return replace(found, **changes)


def step(observation: Observation, memory: np.ndarray | None = None):
    return LAW.step(LAW.start() if memory is None else memory, observation)


def test_the_scenario_chooses_the_law_and_a_held_tail_has_the_other_one() -> None:
    assert isinstance(law_of_scenario(load_scenario("entry_turn")), SwingLaw)
    assert isinstance(
        law_of_scenario(load_scenario("entry_turn", ["controller.law=feedback", "tail.mode=held"])), SwingLaw
    )


def test_a_rolling_car_swings_the_tail_to_the_side_to_which_it_rolls() -> None:
    """The reaction of the motor turns the car back: d(angular momentum of the tail) = -d(that of the car)."""
    for roll, rate in ((0.3, 0.0), (0.0, 2.0)):
        _, _, command, state = step(seen(roll, rate))
        assert state == SwingState.SWING
        assert command[1] > 0.0
        assert command[2] == 0.0
        assert command[3] == GAINS.swing_kd


def test_demand_is_the_sum_of_prediction_roll_and_roll_rate() -> None:
    _, _, command, _ = step(seen(0.5, 0.5, steering=0.1))
    predicted = math.tanh(16.0 * math.tan(0.1) / (SCENARIO.car.wheelbase * GAINS.grip))
    demand = GAINS.steering_gain * predicted + GAINS.roll_gain * 0.5 + GAINS.roll_rate_gain * 0.5
    assert GAINS.threshold < abs(demand) < GAINS.most_speed
    assert command[1] == pytest.approx(demand)


def test_a_mirrored_car_gets_the_mirrored_command() -> None:
    for roll, rate, steering, tail in ((0.3, 1.0, 0.2, 0.4), (0.02, 0.1, 0.0, -0.8), (0.2, 3.0, -0.5, 1.39)):
        memory = np.array([tail, tail])
        after, pitch, command, state = step(seen(roll, rate, steering, tail), memory)
        other, same_pitch, mirrored, same_state = step(seen(-roll, -rate, -steering, -tail), -memory)
        np.testing.assert_allclose(mirrored[:2], -command[:2], atol=1e-12)
        np.testing.assert_array_equal(mirrored[2:], command[2:])
        np.testing.assert_allclose(other, -after, atol=1e-12)
        np.testing.assert_array_equal(pitch, same_pitch)
        assert state == same_state


def test_a_swing_ends_in_position_control_at_its_limit_and_may_go_back_at_once() -> None:
    _, _, command, state = step(seen(0.5, tail=GAINS.most_roll - 0.001))
    assert state == SwingState.SETTLE
    assert command[0] == GAINS.most_roll
    assert command[2:4].tolist() == [GAINS.end_kp, GAINS.end_kd]
    _, _, command, state = step(seen(-0.5, tail=GAINS.most_roll - 0.001))
    assert state == SwingState.SWING
    assert command[1] < 0.0


def test_without_demand_the_tail_returns_at_its_speed_and_waits_upright() -> None:
    memory, tail, ticks = np.array([0.5, 0.5]), 0.5, 0
    while True:
        memory, _, command, state = step(seen(tail=tail), memory)
        tail = float(command[0])  # follows at once
        ticks += 1
        if state == SwingState.HOLD:
            break
        assert command[1] == (-GAINS.return_speed if command[0] > 0.0 else 0.0)
    assert ticks / LAW.rate == pytest.approx(0.5 / GAINS.return_speed, abs=0.02)
    assert command.tolist() == [0.0, 0.0, GAINS.return_kp, GAINS.return_kd, 0.0]


def test_a_frozen_or_late_imu_makes_the_law_hold_the_tail_still() -> None:
    memory, *_ = step(seen(0.3, tail=0.7))
    for _ in range(30):
        memory, _, command, _ = step(seen(0.3, 3.0, steering=0.5, tail=0.7, imu_valid=False), memory)
        assert command.tolist() == [0.7, 0.0, GAINS.return_kp, GAINS.return_kd, 0.0]


def test_unknown_signals_command_nothing_wild() -> None:
    nan = math.nan
    _, _, command, state = step(seen(tail=nan))
    assert state == SwingState.OFF
    assert not command.any()
    memory, *_ = step(seen(tail=0.2))
    _, _, command, state = step(seen(0.4, tail=nan), memory)
    assert command[1] == 0.0
    assert command[0] == pytest.approx(0.2, abs=0.02)
    _, _, command, _ = step(seen(0.3, steering=0.5, speed=nan))
    assert command[1] == pytest.approx(min(GAINS.most_speed, GAINS.roll_gain * 0.3))


def test_arrays_of_cars_get_what_each_car_gets() -> None:
    rng = np.random.default_rng(1)
    roll, rate, steering = rng.normal(0.0, 0.2, 50), rng.normal(0.0, 1.0, 50), rng.normal(0.0, 0.3, 50)
    tail = rng.uniform(-1.4, 1.4, 50)
    together = respond(GAINS, 0.27, 100.0, 0.9 * tail, Seen(roll, rate, 4.0, steering, tail, np.ones(50, bool)))
    for k in range(50):
        own = respond(GAINS, 0.27, 100.0, 0.9 * tail[k], Seen(roll[k], rate[k], 4.0, steering[k], tail[k], True))
        assert [float(value) for value in own] == [float(values[k]) for values in together]


def test_a_limit_beyond_that_of_the_tail_is_refused() -> None:
    from aerodima.workbench.errors import ScenarioError

    with pytest.raises(ScenarioError, match=r"feedback\.most_roll"):
        load_scenario("entry_turn", ["feedback.most_roll=2.0"])
