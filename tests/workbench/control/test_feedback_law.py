"""The law that swings the tail as the steering starts and leans it by the car's state: directions,
times, limits, return, and what it does without signals.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.control.feedback_law import (
    GYRO_X,
    GYRO_Z,
    OVER,
    ROLL,
    FeedbackLaw,
    FeedbackSignals,
    LawMemory,
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
    "kick_roll": 0.0, "kick_time": 0.0, "counter_roll": 0.0, "counter_time": 0.0,
    "min_demand": 0.3, "zero_time": 1.0,
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


STARTED = LawMemory(0.0, 0.0, OVER, 0.0, 0.0)
"""Memory of a law whose tail waits in the middle."""
SWING = {
    "lean_gain": 0.0, "most_roll": 1.5, "out_speed": 50.0, "return_speed": 50.0,
    "kick_roll": 1.2, "kick_time": 0.2, "counter_roll": 0.7, "counter_time": 0.1,
}  # fmt: skip
BOTH = replace(LAW, gains=GAINS.model_copy(update=SWING))
"""A law that swings and leans."""
NO_STATE = {"roll_gain": 0.0, "roll_rate_gain": 0.0, "yaw_rate_gain": 0.0}
KICK = replace(LAW, gains=GAINS.model_copy(update=SWING | NO_STATE))
"""A law that swings alone, and whose reference is where it should be after at most three ticks."""


def step(observation, law=LAW, **memory):
    return law.step(np.array(STARTED._replace(**memory)), observation)


def follow(observations, law=LAW, **memory):
    """Returns the references of the roll after each observation (n,), rad, and the last memory."""
    kept = np.array(STARTED._replace(**memory))
    references = []
    for one in observations:
        kept, *_ = law.step(kept, one)
        references.append(kept[0])
    return np.array(references), LawMemory(*kept)


def rested(observation):
    """Where the reference comes to rest, rad."""
    references, _ = follow([observation] * 200)
    return float(references[-1])


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
    assert rested(seen(steering=0.02, roll_rate=1.0)) > rested(seen(steering=0.02)) + 0.05


def test_lean_is_the_sum_of_prediction_roll_roll_rate_and_yaw_rate():
    """The state counts by the level, which with wheels that are turned for long is the demand."""
    wheelbase = SCENARIO.car.wheelbase
    demand = math.tanh(16.0 * math.tan(0.05) / (wheelbase * GAINS.grip))
    by_state = GAINS.roll_gain * 0.05 + GAINS.roll_rate_gain * 0.2
    by_state += GAINS.yaw_rate_gain * (0.9 - 4.0 * math.tan(0.05) / wheelbase)
    expected = GAINS.lean_gain * demand + demand * by_state
    assert rested(seen(0.05, 0.2, 0.9, 0.05)) == pytest.approx(expected)
    assert rested(seen(steering=0.5, yaw=GAINS.grip / 4.0)) == pytest.approx(-GAINS.most_roll), (
        "the floor limits"
    )


def test_a_swing_goes_inside_as_the_steering_starts_then_outside_and_back():
    """A left turn for 0.5 s at full demand: 0.2 s inside (left, negative), 0.1 s outside."""
    turned = [seen(steering=0.5)] * 50
    references, memory = follow(turned, KICK)
    assert references[3:19] == pytest.approx(-1.2, abs=1e-3)
    assert references[24:29] == pytest.approx(0.7, abs=1e-3)
    assert references[34:] == pytest.approx(0.0, abs=1e-3)
    assert memory.side == 1.0
    mirrored, _ = follow([seen(steering=-0.5)] * 50, KICK)
    assert mirrored == pytest.approx(-references)


def test_a_counter_roll_below_zero_keeps_the_tail_on_the_inside():
    """The shipped numbers have one: in a left turn the tail stays at the left (negative)."""
    numbers = load_scenario("entry_turn").feedback.model_dump() | NO_STATE | {"lean_gain": 0.0}
    shipped = replace(LAW, gains=GAINS.model_copy(update=numbers))
    assert shipped.gains.counter_roll < 0.0 < shipped.gains.kick_roll
    for steering in (0.5, -0.5):
        references, memory = follow([seen(steering=steering)] * 70, shipped)
        inside = -np.sign(steering) * memory.level
        assert references[20] == pytest.approx(inside * shipped.gains.kick_roll)
        assert references[-1] == pytest.approx(inside * -shipped.gains.counter_roll)


def test_a_swing_goes_on_when_the_wheels_are_straight_again_and_the_next_needs_them_straight():
    pulse = [seen(steering=0.5)] * 5 + [seen()] * 45
    references, memory = follow(pulse, KICK)
    assert references[10:19] == pytest.approx(-1.2, abs=1e-3), "the level of the pulse is kept"
    assert memory.side == 0.0
    held, memory = follow([seen(steering=0.5)] * 100, KICK)
    assert np.count_nonzero(np.abs(held) > 0.1) <= 33, "one swing in a long turn"
    other, memory = follow([seen(steering=-0.5)] * 10, KICK, **memory._asdict())
    assert memory.side == -1.0
    assert other[-1] == pytest.approx(1.2, abs=1e-3), "the other side has a swing of its own"


def test_steering_to_the_other_side_ends_a_swing_and_begins_the_next():
    """A fishhook: left at full demand, after 0.1 s right at half of it."""
    asked = math.atanh(0.5) * GAINS.grip
    right = -math.atan(asked * SCENARIO.car.wheelbase / 4.0**2)
    turned = [seen(steering=0.5)] * 10 + [seen(steering=right)] * 40
    references, memory = follow(turned, KICK)
    assert references[3:10] == pytest.approx(-1.2, abs=1e-3)
    assert references[13:29] == pytest.approx(0.6, abs=1e-3), "the level of the second demand"
    assert references[34:39] == pytest.approx(-0.35, abs=1e-3)
    assert memory.side == -1.0


def test_steering_below_the_least_demand_releases_nothing():
    speed = 4.0
    asked = math.atanh(0.9 * GAINS.min_demand) * GAINS.grip
    steering = math.atan(asked * SCENARIO.car.wheelbase / speed**2)
    references, memory = follow([seen(steering=steering)] * 50, KICK)
    assert not references.any()
    assert memory.side == 0.0


def test_a_smaller_demand_has_a_smaller_swing():
    speed = 4.0
    asked = math.atanh(0.5) * GAINS.grip
    steering = math.atan(asked * SCENARIO.car.wheelbase / speed**2)
    references, _ = follow([seen(steering=steering)] * 15, KICK)
    assert references[-1] == pytest.approx(-0.6, abs=1e-3)


def test_a_mirrored_car_gets_the_mirrored_command():
    for roll, rate, yaw, steering, tail in (
        (0.3, 1.0, 0.1, 0.2, 0.4),
        (0.02, 0.1, 0, 0, -0.8),
        (0.2, 3, 1, -0.5, 1.3),
    ):
        after, pitch, command, state = step(
            seen(roll, rate, yaw, steering), BOTH, reference=tail, zero=0.01
        )
        other, same_pitch, mirrored, same_state = step(
            seen(-roll, -rate, -yaw, -steering), BOTH, reference=-tail, zero=-0.01
        )
        assert_allclose(mirrored[:2], -command[:2], atol=1e-12)
        assert_array_equal(mirrored[2:], command[2:])
        assert_allclose(other, [-1.0, -1.0, 1.0, 1.0, -1.0] * after, atol=1e-12)
        assert_array_equal(pitch, same_pitch)
        assert state == same_state


def test_the_reference_goes_out_and_comes_back_at_its_speeds_and_waits_upright():
    _, _, command, _ = step(seen(steering=0.5))
    assert command[0] == pytest.approx(-GAINS.out_speed / LAW.rate)
    memory, _, command, state = step(seen(), reference=-0.5)
    assert state == SwingState.RECOCK
    assert command[0] == pytest.approx(-0.5 + GAINS.return_speed / LAW.rate)
    for _ in range(100):
        memory, _, command, state = LAW.step(memory, seen())
    assert command.tolist() == [0.0, 0.0, GAINS.kp, GAINS.kd, 0.0]
    assert state == SwingState.HOLD


def test_a_reversed_turn_swings_through_the_middle():
    way, _ = follow([seen(steering=-0.5)] * 20, reference=-0.5, side=1.0)
    assert np.all(np.diff(way) >= 0.0)
    assert way[-1] == pytest.approx(GAINS.most_roll)
    assert way[5] - way[4] == pytest.approx(GAINS.out_speed / LAW.rate)


def test_nothing_of_the_imu_moves_the_tail_on_the_straight():
    rng = np.random.default_rng(1)
    noisy = [seen(*row) for row in rng.normal(0.0, [0.05, 0.2, 0.2], (200, 3))]
    references, _ = follow(noisy, BOTH)
    assert not references.any()


def test_the_zero_of_the_roll_is_the_first_one_and_follows_it_on_the_straight_alone():
    memory, *_ = LAW.step(LAW.start(), seen(roll=0.03, roll_angle=0.0))
    assert LawMemory(*memory).zero == 0.03
    _, after = follow([seen(roll=0.03)] * round(GAINS.zero_time * LAW.rate))
    assert after.zero == pytest.approx(0.03 * (1.0 - math.exp(-1.0)), rel=0.01)
    _, after = follow([seen(roll=0.03, steering=0.5)] * 100)
    assert after.zero == 0.0
    offset, _ = follow([seen(roll=0.05, steering=0.5)] * 60, zero=0.05)
    centred, _ = follow([seen(steering=0.5)] * 60)
    assert offset == pytest.approx(centred)


def test_without_an_imu_the_swing_is_played_and_the_state_does_not_count():
    blind = [seen(0.3, 3.0, 2.0, steering=0.5, imu_valid=False)] * 20
    references, memory = follow(blind, KICK)
    assert references[-1] == pytest.approx(-1.2, abs=1e-3)
    assert memory.zero == 0.0
    memory, *_ = LAW.step(LAW.start(), seen(roll_angle=0.0, imu_valid=False))
    assert LawMemory(*memory).zero == 0.0


def test_unknown_signals_command_nothing_wild():
    nan = math.nan
    _, pitch, command, state = LAW.step(LAW.start(), seen(roll_angle=nan))
    assert state == SwingState.OFF
    assert not command.any()
    assert not pitch.any()
    memory, *_ = LAW.step(LAW.start(), seen(roll_angle=0.05, imu_valid=False))
    assert memory[0] == pytest.approx(0.05 - GAINS.return_speed / LAW.rate), (
        "the tail begins where it is"
    )
    assert rested(seen(0.1, yaw=1.5, steering=0.5, speed=nan)) == 0.0


def test_arrays_of_cars_get_what_each_car_gets():
    rng = np.random.default_rng(1)
    roll, rate, yaw, steering = rng.normal(0.0, [[0.2], [1.0], [2.0], [0.3]], (4, 50))
    memory = LawMemory(
        rng.uniform(-1.4, 1.4, 50),
        rng.integers(-1, 2, 50).astype(float),
        rng.uniform(0.0, 0.5, 50),
        rng.uniform(0.0, 1.0, 50),
        rng.normal(0.0, 0.05, 50),
    )
    signals = FeedbackSignals(roll, rate, yaw, 4.0, steering, np.ones(50, bool))
    together = respond(BOTH.gains, 0.27, 100.0, memory, signals)
    for k in range(50):
        own = respond(
            BOTH.gains,
            0.27,
            100.0,
            LawMemory(*(values[k] for values in memory)),
            FeedbackSignals(roll[k], rate[k], yaw[k], 4.0, steering[k], True),
        )
        assert [float(value) for value in own] == pytest.approx(
            [float(values[k]) for values in together]
        )
