"""CONTROL: the operator steers and drives, the tail swings by its law for the turn that is
steered.
"""

import math

import numpy as np
import pytest

from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.driving.plain_loop import ControlPilot
from aerodima.hardware.protocol.radio import OperatorCommand, RadioMode
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.scenario.signal_table import IMU, STATUS
from tests.hardware.driving.fake_wiring import quick_turn

SCENARIO = quick_turn()
PERIOD = 0.01
GYRO_Z = IMU.index("gyro_z")


class NotingLaw:
    """The law of a scenario that keeps what it was shown."""

    def __init__(self):
        self._law = law_of_scenario(SCENARIO)
        self.rate = self._law.rate
        self.memory_size = self._law.memory_size
        self.seen = []

    def start(self):
        return self._law.start()

    def step(self, memory, observation):
        self.seen.append(observation)
        return self._law.step(memory, observation)


def reading(steering, roll, yaw_rate=0.0, throttle=0.2, **operator):
    imu = np.zeros(9)
    imu[GYRO_Z] = yaw_rate
    return CarReading(
        tail_state=np.array([0.0, roll, 0.0, 0.0, 0.0, 0.0]),
        imu=imu,
        status=np.zeros(STATUS.size),
        operator=OperatorCommand(RadioMode.CONTROL, throttle, steering, **operator),
    )


def drive(steering, yaw_rate, ticks=300, turn_at=100):
    """A tail without mass that waits where the law wants it; the car yaws from `turn_at` on."""
    pilot = ControlPilot(SCENARIO)
    roll = -math.copysign(math.pi / 2, steering)
    steps = []
    pilot.start()
    for tick in range(ticks):
        step = pilot.step(
            tick * PERIOD, reading(steering, roll, yaw_rate if tick >= turn_at else 0.0)
        )
        position, velocity, kp, _, _ = step.command.tail_roll
        roll += PERIOD * (velocity if kp == 0.0 else 10.0 * (position - roll))
        steps.append((step, roll))
    return steps


def test_steering_and_throttle_are_the_operators_within_the_servo():
    pilot = ControlPilot(SCENARIO)
    for asked, limited in (
        (0.1, 0.1),
        (-0.1, -0.1),
        (3.0, SCENARIO.servo.limit),
        (-3.0, -SCENARIO.servo.limit),
    ):
        command = pilot.step(0.0, reading(asked, 0.0, throttle=-0.3)).command
        assert (command.steering_angle, command.throttle) == (limited, -0.3)


def test_the_rollover_control_limits_the_operator():
    pilot = ControlPilot(SCENARIO.varied(rollover_control={"gain": 4.0, "start": 0.1, "lead": 0.0}))
    shares = []
    for tick, lean in enumerate((0.0, 0.2, 0.5)):
        seen = reading(0.4, 0.0)
        seen.imu[0] = lean
        shares.append(pilot.step(tick * PERIOD, seen).command.steering_angle / 0.4)
    assert shares == pytest.approx([1.0, 0.6, 0.0])


def test_the_law_is_shown_the_turn_that_was_steered_one_tick_before():
    law = NotingLaw()
    pilot = ControlPilot(SCENARIO, law)
    steered = (0.0, 0.3, 0.3, -0.2, 0.0)
    plans = [
        pilot.step(tick * PERIOD, reading(angle, 0.0)).planned_turn
        for tick, angle in enumerate(steered)
    ]
    assert plans == [0.0, 1.0, 1.0, -1.0, 0.0]
    assert [seen.planned_turn for seen in law.seen] == [0.0, *plans[:-1]]
    assert [seen.steering_angle for seen in law.seen] == [0.0, *steered[:-1]]


def test_sticks_of_the_tail_are_not_obeyed():
    def commands(**sticks):
        pilot = ControlPilot(SCENARIO)
        steps = [pilot.step(tick * PERIOD, reading(0.3, -1.5, **sticks)) for tick in range(50)]
        return [[*step.command.tail_pitch, *step.command.tail_roll] for step in steps]

    assert commands(pitch_tail=0.5, roll_tail=1.0) == commands()


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
def test_the_tail_waits_inside_and_swings_to_the_outside_of_the_turn_that_is_steered(side):
    steps = drive(side * 0.4, side * 2.0)
    states = [step.state for step, _ in steps]
    before = steps[99]
    after = steps[-1]
    assert before[0].state == SwingState.HOLD
    assert before[1] == pytest.approx(-side * math.pi / 2, abs=0.01)
    swinging = [step.command.tail_roll[1] for step, _ in steps if step.state == SwingState.SWING]
    assert swinging
    assert np.all(side * np.array(swinging) == SCENARIO.controller.swing_speed)
    assert states[-1] == SwingState.SETTLE
    assert side * after[1] > 0.6


def test_a_yaw_against_the_steering_swings_nothing():
    assert SwingState.SWING not in {step.state for step, _ in drive(0.4, -2.0)}
