"""Every state of a motor and every way between them."""

import math
from itertools import pairwise

import pytest

from aerodima.hardware.devices.device_states import MotorFault, MotorState
from aerodima.hardware.devices.tail_motor import Motor
from aerodima.hardware.protocol.ak70 import (
    MitCommand,
    make_enter,
    make_exit,
    make_neutral,
)
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.fake_motors import PERIOD, PROFILE, Bench, FakePort, hold, settings
from tests.refusals import assert_refused

ENTER, EXIT = make_enter(2), make_exit(2)


@pytest.fixture
def bench():
    return Bench(settings())


def frames(bench):
    return [frame for _, frame in bench.port.sent]


def test_motor_that_is_off_sends_nothing(bench):
    bench.cycle(hold(0.5), count=20)
    assert frames(bench) == []
    assert bench.motors[0].state is MotorState.OFF
    assert bench.motors[0].age(bench.now) == math.inf


def test_entering_begins_and_ends_with_zero_gains(bench):
    bench.group.set_enter(bench.now)
    neutral = make_neutral(2, PROFILE)
    assert frames(bench) == [neutral, ENTER, neutral]
    assert bench.motors[0].state is MotorState.ENTERING
    bench.cycle()
    assert all(command.kp == command.kd == 0 for _, command in bench.commands(2)[:-1])


def test_entering_ends_in_holding_at_the_measured_position():
    bench = Bench(settings(), positions=[-0.7])
    bench.to_holding()
    bench.cycle(count=100)
    held = bench.commands(2)[-1][1]
    assert held.position == pytest.approx(
        -0.7, abs=0.03
    )  # where it went while its direction was tried
    assert (held.kp, held.kd) == (pytest.approx(17.0, abs=0.1), pytest.approx(5.0, abs=0.01))
    assert bench.fakes[0].position == pytest.approx(held.position, abs=0.01)


def test_gains_come_on_slowly_from_zero(bench):
    bench.to_holding()
    bench.cycle(count=40)
    gains = [command.kp for _, command in bench.commands(2)]
    assert gains == sorted(gains)
    assert gains[0] == 0.0
    assert gains[-1] == pytest.approx(17.0, abs=0.1)
    assert max(b - a for a, b in pairwise(gains)) <= 17.0 * PERIOD / 0.3 + 500 / 4095


def test_first_command_is_reached_by_a_ramp_from_the_measured_position():
    bench = Bench(settings(), positions=[-0.7])
    bench.to_holding()
    start = bench.now
    bench.cycle(hold(0.5), count=200)
    ramp = [
        (when, command.position)
        for when, command in bench.commands(2)
        if when > start and command.kp > 0
    ]
    steps = [b[1] - a[1] for a, b in pairwise(ramp)]
    assert ramp[0][1] == pytest.approx(-0.7, abs=0.03)
    assert max(steps) <= 1.0 * PERIOD + 25 / 65535  # 1 rad/s
    assert ramp[-1][1] == pytest.approx(0.5, abs=1e-3)
    assert bench.fakes[0].position == pytest.approx(0.5, abs=0.02)
    whole = 0.5 - ramp[0][1]  # rad, at 1 rad/s
    assert whole <= next(when for when, place in ramp if place > 0.499) - start < whole + 0.15


def test_once_caught_up_a_new_command_passes_at_once():
    bench = Bench(settings()).to_running(hold(0.0))
    bench.cycle(hold(0.9))
    assert bench.commands(2)[-1][1].position == pytest.approx(0.9, abs=1e-3)


def test_velocity_command_without_position_gain_needs_no_ramp(bench):
    bench.to_holding()
    bench.cycle(hold(0.0), count=40)
    bench.cycle(MitCommand(0.0, 8.0, 0.0, 3.0, 0.0), count=5)
    command = bench.commands(2)[-1][1]
    assert (command.velocity, command.kp, command.kd) == pytest.approx((8.0, 0.0, 3.0), abs=0.02)


def test_running_without_commands_falls_back_to_holding_where_it_is(bench):
    bench.to_running(hold(0.3))
    bench.cycle(hold(0.3), count=200)
    bench.cycle(count=11)
    assert bench.motors[0].state is MotorState.HOLDING
    assert bench.commands(2)[-1][1].position == pytest.approx(bench.fakes[0].position, abs=0.02)


def test_hold_by_hand_stops_a_swing_where_it_is(bench):
    bench.to_running(hold(-1.5))
    bench.cycle(hold(-1.5), count=200)
    bench.cycle(MitCommand(0.0, 8.0, 0.0, 3.0, 0.0), count=10)
    for motor in bench.motors:
        motor.set_hold(bench.now)
    assert bench.motors[0].state is MotorState.HOLDING
    bench.cycle(count=50)
    assert abs(bench.fakes[0].speed) < 0.2


def test_exit_goes_out_at_once_and_again_and_ends_off(bench):
    bench.to_running()
    start = bench.now
    bench.group.set_exit(bench.now)
    assert frames(bench)[-3:] == [EXIT] * 3
    assert bench.motors[0].state is MotorState.EXITING
    bench.cycle(hold(1.0), count=20)
    assert bench.motors[0].state is MotorState.OFF
    assert len(bench.port.exits(2, start)) == 3 + 10
    assert not bench.fakes[0].entered
    assert all(frame.data[7] != 0xFC for when, frame in bench.port.sent if when > start)


REACH = {
    MotorState.OFF: lambda bench: None,
    MotorState.ENTERING: lambda bench: bench.group.set_enter(bench.now),
    MotorState.HOLDING: Bench.to_holding,
    MotorState.RUNNING: Bench.to_running,
    MotorState.FAULTED: lambda bench: (
        bench.to_holding().motors[0].set_fault(MotorFault.BUS, "test", bench.now)
    ),
    MotorState.EXITING: lambda bench: bench.to_holding().motors[0].set_exit(bench.now),
}


@pytest.mark.parametrize("state", REACH)
def test_exit_goes_out_from_every_state_without_waiting_for_replies(bench, state):
    REACH[state](bench)
    motor = bench.motors[0]
    assert motor.state is state
    bench.fakes[0].respond = lambda frame: []
    before = len(bench.port.exits(2))
    motor.set_exit(bench.now)
    assert len(bench.port.exits(2)) >= before + 3


def test_fault_stays_and_the_motor_is_not_entered_any_more(bench):
    bench.to_running()
    bench.motors[0].set_fault(MotorFault.NO_REPLY, "gone", bench.now)
    start = bench.now
    bench.group.set_exit(bench.now)
    bench.cycle(hold(0.0), count=300)
    assert bench.motors[0].state is MotorState.FAULTED
    assert ENTER not in [frame for when, frame in bench.port.sent if when > start]
    assert_refused(lambda: bench.group.set_enter(bench.now), HardwareError, "tail roll", "gone")


def test_faulted_motor_is_reminded_for_as_long_as_it_is_faulted(bench):
    bench.to_running()
    bench.motors[0].set_fault(MotorFault.NO_REPLY, "gone", bench.now)
    start = bench.now
    bench.cycle(count=500)
    exits = bench.port.exits(2, start)
    assert max(b - a for a, b in pairwise(exits)) < 0.12
    assert bench.now - exits[-1] < 0.12


def test_first_fault_counts(bench):
    bench.to_running()
    bench.motors[0].set_fault(MotorFault.NO_REPLY, "first", bench.now)
    bench.motors[0].set_fault(MotorFault.BUS, "second", bench.now)
    assert bench.motors[0].fault is MotorFault.NO_REPLY
    assert "first" in bench.motors[0].fault_text


def test_zero_frame_is_never_sent():
    bench = Bench(settings()).to_running()
    bench.group.set_exit(bench.now)
    bench.cycle(count=30)
    bench.to_running()
    bench.motors[0].set_fault(MotorFault.BUS, "test", bench.now)
    bench.cycle(count=30)
    assert CanFrame(2, bytes.fromhex("FFFFFFFFFFFFFFFE")) not in frames(bench)


def test_direction_and_zero_turn_the_joint_into_the_motor():
    bench = Bench(settings(direction=-1, zero=0.4), positions=[0.4 - 0.5])
    bench.to_holding()
    assert bench.motors[0].position == pytest.approx(0.5, abs=0.03)
    bench.cycle(hold(-1.0), count=300)
    assert bench.fakes[0].position == pytest.approx(0.4 + 1.0, abs=0.02)
    bench.cycle(MitCommand(0.0, 3.0, 0.0, 3.0, 0.0), count=10)
    assert bench.commands(2)[-1][1].velocity == pytest.approx(-3.0, abs=0.02)
    assert bench.motors[0].speed > 0.5
    assert bench.fakes[0].speed < -0.5
    # the torque of the joint has the sign that accelerates the joint
    assert bench.motors[0].torque * bench.fakes[0].torque < 0


def test_sink_that_raises_is_a_fault_and_no_exception():
    port = FakePort([])
    motor = Motor(settings(), port)
    motor.set_enter(0.0)
    port.send_error = OSError("gone")
    motor.step(0.01)
    assert motor.fault is MotorFault.BUS
    motor.set_exit(0.02)


def test_a_command_beyond_the_range_is_reached_at_its_end(bench):
    bench.to_holding()
    bench.cycle(hold(3.0), count=200)  # 1.57 rad at 1 rad/s
    bench.cycle(hold(1.0))
    assert bench.commands(2)[-1][1].position == pytest.approx(1.0, abs=1e-3)
