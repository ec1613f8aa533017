"""The law that follows steering, roll and roll rate: directions, limits, return, and what it does
without signals.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.control.feedback_law import (
    GYRO_X,
    GYRO_Z,
    ROLL,
    FeedbackLaw,
    FeedbackSignals,
    respond,
)
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.swing_machine import SwingLaw
from aerodima.workbench.control.tail_law import Observation
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import IMU

NUMBERS = {
    "lean_gain": -2.0, "roll_gain": 3.0, "roll_rate_gain": 0.5, "yaw_rate_gain": 0.4, "grip": 4.5,
    "most_roll": 1.3,
    "out_speed": 15.0, "return_speed": 2.0, "kp": 14.0, "kd": 2.0, "pitch_angle": 0.1,
}  # fmt: skip
SCENARIO = load_scenario(
    "entry_turn",
    ["controller.law=feedback", *(f"feedback.{name}={value}" for name, value in NUMBERS.items())],
)
LAW = law_of_scenario(SCENARIO)
assert isinstance(LAW, FeedbackLaw)
GAINS = LAW.gains


def seen(roll=0.0, roll_rate=0.0, yaw=0.0, steering=0.0, **changes):
    imu = [0.0] * IMU.size
    imu[ROLL] = roll
    imu[GYRO_X] = roll_rate
    imu[GYRO_Z] = yaw
    found = Observation(
        1.0, yaw, 0.0, 0.0, 0.0, True, imu=tuple(imu), speed=4.0, steering_angle=steering
    )
    return replace(found, **changes)


def step(observation, memory=None):
    return LAW.step(np.zeros(1) if memory is None else memory, observation)


def rested(observation):
    """Where the reference comes to rest, rad."""
    memory = np.zeros(1)
    for _ in range(200):
        memory, *_ = step(observation, memory)
    return float(memory[0])


def test_the_scenario_chooses_the_law_and_a_held_tail_has_the_other_one():
    assert isinstance(law_of_scenario(load_scenario("entry_turn")), SwingLaw)
    assert isinstance(
        law_of_scenario(load_scenario("entry_turn", ["controller.law=feedback", "tail.mode=held"])),
        SwingLaw,
    )


def test_the_tail_leans_to_the_inside_of_a_turn_and_towards_the_side_to_which_the_car_rolls():
    """Inside: its weight stands against the roll.

    Towards the roll: the reaction of the motor turns the car back.
    """
    assert rested(seen(steering=0.3)) < -0.5  # left turn, tail to the left
    _, _, command, state = step(seen(roll_rate=2.0))
    assert command[0] > 0.0
    assert state == SwingState.SWING


def test_lean_is_the_sum_of_prediction_roll_roll_rate_and_yaw_rate():
    wheelbase = SCENARIO.car.wheelbase
    predicted = math.tanh(16.0 * math.tan(0.05) / (wheelbase * GAINS.grip))
    expected = GAINS.lean_gain * predicted + GAINS.roll_gain * 0.05 + GAINS.roll_rate_gain * 0.2
    expected += GAINS.yaw_rate_gain * (0.9 - 4.0 * math.tan(0.05) / wheelbase)
    assert rested(seen(0.05, 0.2, 0.9, 0.05)) == pytest.approx(expected)
    assert rested(seen(steering=0.5, yaw=GAINS.grip / 4.0)) == pytest.approx(-GAINS.most_roll), (
        "the floor limits"
    )


def test_a_mirrored_car_gets_the_mirrored_command():
    for roll, rate, yaw, steering, tail in (
        (0.3, 1.0, 0.1, 0.2, 0.4),
        (0.02, 0.1, 0, 0, -0.8),
        (0.2, 3, 1, -0.5, 1.3),
    ):
        after, pitch, command, state = step(seen(roll, rate, yaw, steering), np.array([tail]))
        other, same_pitch, mirrored, same_state = step(
            seen(-roll, -rate, -yaw, -steering), np.array([-tail])
        )
        assert_allclose(mirrored[:2], -command[:2], atol=1e-12)
        assert_array_equal(mirrored[2:], command[2:])
        assert_allclose(other, -after, atol=1e-12)
        assert_array_equal(pitch, same_pitch)
        assert state == same_state


def test_the_reference_goes_out_and_comes_back_at_its_speeds_and_waits_upright():
    memory, _, command, _ = step(seen(steering=0.5))
    assert command[0] == pytest.approx(-GAINS.out_speed / LAW.rate)
    memory, _, command, state = step(seen(), np.array([-0.5]))
    assert state == SwingState.RECOCK
    assert command[0] == pytest.approx(-0.5 + GAINS.return_speed / LAW.rate)
    for _ in range(100):
        memory, _, command, state = step(seen(), memory)
    assert command.tolist() == [0.0, 0.0, GAINS.kp, GAINS.kd, 0.0]
    assert state == SwingState.HOLD


def test_a_reversed_turn_swings_through_the_middle():
    memory = np.array([-0.5])
    way = []
    for _ in range(20):
        memory, *_ = step(seen(steering=-0.5), memory)
        way.append(float(memory[0]))
    assert np.all(np.diff(way) >= 0.0)
    assert way[-1] == pytest.approx(GAINS.most_roll)
    assert way[5] - way[4] == pytest.approx(GAINS.out_speed / LAW.rate)


def test_noise_of_the_imu_is_no_swing():
    rng = np.random.default_rng(1)
    memory = np.zeros(1)
    for roll, rate in rng.normal(0.0, [0.005, 0.02], (200, 2)):
        memory, _, _, state = step(seen(roll, rate), memory)
        assert state == SwingState.HOLD


def test_a_frozen_or_late_imu_makes_the_law_hold_the_tail_still():
    memory = np.array([0.7])
    for _ in range(30):
        memory, _, command, _ = step(seen(0.3, 3.0, steering=0.5, imu_valid=False), memory)
        assert command.tolist() == [0.7, 0.0, GAINS.kp, GAINS.kd, 0.0]


def test_unknown_signals_command_nothing_wild():
    nan = math.nan
    _, pitch, command, state = step(seen(roll_angle=nan), LAW.start())
    assert state == SwingState.OFF
    assert not command.any()
    assert not pitch.any()
    memory, *_ = step(seen(roll_angle=0.2, imu_valid=False), LAW.start())
    assert memory[0] == 0.2, "the tail begins where it is"
    assert rested(seen(0.1, yaw=1.5, steering=0.5, speed=nan)) == pytest.approx(
        GAINS.roll_gain * 0.1
    )


def test_arrays_of_cars_get_what_each_car_gets():
    rng = np.random.default_rng(1)
    roll, rate, yaw, steering = rng.normal(0.0, [[0.2], [1.0], [2.0], [0.3]], (4, 50))
    tail = rng.uniform(-1.4, 1.4, 50)
    together = respond(
        GAINS, 0.27, 100.0, tail, FeedbackSignals(roll, rate, yaw, 4.0, steering, np.ones(50, bool))
    )
    for k in range(50):
        own = respond(
            GAINS,
            0.27,
            100.0,
            tail[k],
            FeedbackSignals(roll[k], rate[k], yaw[k], 4.0, steering[k], True),
        )
        assert [float(value) for value in own] == pytest.approx(
            [float(values[k]) for values in together]
        )
