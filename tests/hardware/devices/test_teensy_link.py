"""Motors, pulses and sail through the Teensy's strings on a pseudo-terminal, with the same checks
as on the CAN bus.
"""

import math
import time

import pytest

from aerodima.hardware.devices.device_states import MotorFault, MotorState, SourceFault
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.teensy_link import TeensyLink, pulse
from aerodima.hardware.protocol.ak70 import make_enter, make_exit, make_neutral
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.hardware.protocol.teensy import (
    SERVO_PULSES,
    THROTTLE_PULSES,
    MotorRequest,
    TeensyStatus,
)
from aerodima.hardware.transport.serial_link import SerialLink, SerialSettings, open_serial
from aerodima.workbench.errors import HardwareError
from tests.hardware.fake_can import wait_until
from tests.hardware.fake_motors import PERIOD, PROFILE, hold, settings
from tests.hardware.fake_teensy import FakeTeensy

pytestmark = pytest.mark.realtime  # threads and deadlines on the wall clock


class Car:
    """The computer's side of the bridge wiring, and the loop in real time."""

    def __init__(self):
        self.teensy = FakeTeensy()
        self.serial = SerialLink(lambda: open_serial(SerialSettings(path=self.teensy.path)))
        self.link = TeensyLink(self.serial, (1, 2), PROFILE)
        self.group = MotorGroup((settings("tail pitch", 1), settings("tail roll", 2)), self.link)

    def turn(self, cycles, command=None):
        due = time.monotonic()
        for _ in range(cycles):
            now = time.monotonic()
            self.group.step(now)
            if command is not None:
                for motor in self.group.motors:
                    motor.set_command(command, now)
            self.link.commit()
            due += PERIOD
            time.sleep(max(0.0, due - time.monotonic()))

    def run(self):
        self.turn(10)
        self.group.set_enter(time.monotonic())
        self.turn(20)
        self.turn(20, hold(0.0))
        assert [motor.state for motor in self.group.motors] == [MotorState.RUNNING] * 2, (
            self.group.fault_text
        )
        return self

    def first_exit(self, motor, since):
        times = [
            when
            for when, command in self.teensy.commands
            if when >= since and command.motors[motor].request is MotorRequest.EXIT
        ]
        return times[0] - since if times else math.inf

    def close(self):
        self.serial.close()
        self.teensy.unplug()


@pytest.fixture
def car():
    car = Car()
    yield car
    car.close()


def test_motors_are_entered_moved_and_exited_through_the_strings(car):
    car.run()
    car.turn(100, hold(0.4))
    assert car.group.ready, car.group.fault_text
    assert car.teensy.motors[2].position == pytest.approx(0.4, abs=0.15)
    assert car.group.motors[1].temperature == 30.0
    car.group.set_exit(time.monotonic())
    assert car.link.flush()
    assert wait_until(
        lambda: not car.teensy.motors[1].entered and not car.teensy.motors[2].entered, 0.5
    )


def test_motor_that_nobody_asked_anything_is_ordered_to_exit(car):
    car.turn(5)
    assert {order.request for _, command in car.teensy.commands for order in command.motors} == {
        MotorRequest.EXIT
    }
    assert car.group.motors[0].position == pytest.approx(
        0.0, abs=1e-3
    )  # its position is known before it is entered


def test_sail_and_pulses_pass_through(car):
    car.teensy.sail = 270.0
    car.link.set_pulses(1612, 1700)
    car.turn(5)
    assert car.link.sail == pytest.approx(-math.pi / 2, abs=1e-4)
    assert (car.teensy.commands[-1][1].servo, car.teensy.commands[-1][1].throttle) == (1612, 1700)
    with pytest.raises(FrameError, match="servo pulse 3000"):
        car.link.set_pulses(3000, 1500)
    car.turn(1)
    assert car.teensy.commands[-1][1].servo == 1612


def test_time_of_sending_is_the_teensys(car):
    car.turn(30)
    assert car.link.age(time.monotonic()) < 0.1
    # the counter has a resolution of 1 ms; transport takes at least nothing
    assert abs(car.link.sent_time - car.teensy.commands[-1][0]) < 2 * PERIOD + 0.05


def test_order_of_a_cycle_is_exit_before_enter_before_command(car):
    link = car.link
    for frame in (make_neutral(1, PROFILE), make_enter(1), make_neutral(1, PROFILE)):
        assert link.send(frame)
    link.commit()
    assert wait_until(lambda: car.teensy.commands)
    assert car.teensy.commands[-1][1].motors[0].request is MotorRequest.ENTER
    for frame in (make_exit(1), make_enter(1), make_neutral(1, PROFILE)):
        link.send(frame)
    link.commit()
    assert wait_until(lambda: len(car.teensy.commands) == 2)
    assert car.teensy.commands[-1][1].motors[0].request is MotorRequest.EXIT


def test_forgotten_motor_keeps_its_command_for_a_short_while_only(car):
    car.link.send(make_neutral(1, PROFILE))
    for count in range(25):
        car.link.commit()
        assert wait_until(lambda count=count: len(car.teensy.commands) > count)
    requests = [command.motors[0].request for _, command in car.teensy.commands]
    assert requests == [MotorRequest.COMMAND] * 21 + [MotorRequest.EXIT] * 4


def test_zero_frame_and_foreign_frames_are_not_passed_on(car):
    assert not car.link.send(CanFrame(1, bytes.fromhex("FFFFFFFFFFFFFFFE")))
    assert not car.link.send(make_neutral(3, PROFILE))
    assert not car.link.send(CanFrame(0x2901, bytes(8), extended=True))


def test_motor_that_falls_silent_behind_a_living_teensy_is_noticed(car):
    car.run()
    start = time.monotonic()
    car.teensy.deaf.add(2)
    car.turn(30, hold(0.0))
    assert car.group.motors[1].fault is MotorFault.NO_REPLY
    assert max(car.first_exit(0, start), car.first_exit(1, start)) < 7 * PERIOD + 0.05


def test_motor_fault_comes_through(car):
    car.run()
    car.teensy.motors[1].fault = 5
    car.turn(10, hold(0.0))
    assert car.group.motors[0].fault_text == "tail pitch: reports encoder"


@pytest.mark.parametrize(
    "damage", [lambda text: b"", lambda text: text.replace(b"90", b"91"), lambda text: text[:-8]]
)
def test_silent_or_damaged_teensy_switches_the_motors_off(car, damage):
    car.run()
    start = time.monotonic()
    car.teensy.damage = damage
    car.turn(40, hold(0.0))
    assert {motor.state for motor in car.group.motors} == {MotorState.FAULTED}
    assert car.link.fault is SourceFault.SILENT
    assert max(car.first_exit(0, start), car.first_exit(1, start)) < 7 * PERIOD + 0.05
    car.teensy.damage = lambda text: text
    car.turn(20, hold(0.0))
    assert car.link.fault is SourceFault.NONE
    assert {motor.state for motor in car.group.motors} == {
        MotorState.FAULTED
    }  # nothing is re-armed by itself


def test_watchdog_of_the_teensy_is_a_fault(car):
    car.run()
    car.teensy.status = TeensyStatus.WATCHDOG_ACTED
    car.turn(5, hold(0.0))
    assert car.link.fault is SourceFault.REPORTED
    assert {motor.fault for motor in car.group.motors} == {MotorFault.BUS}


def test_noise_between_the_strings_does_not_matter(car):
    car.run()
    for _ in range(20):
        car.teensy.write(b"\xff;;7|")
        car.turn(2, hold(0.0))
    assert car.group.ready, car.group.fault_text
    assert car.link._stream.rejected > 10


def test_cable_pulled_and_put_back_reconnects_and_re_arms_nothing(car):
    car.run()
    car.teensy.unplug()
    start = time.monotonic()
    car.turn(20, hold(0.0))
    assert time.monotonic() - start < 0.5  # the loop was not held up
    assert car.link.fault is SourceFault.LOST
    assert {motor.state for motor in car.group.motors} == {MotorState.FAULTED}
    car.teensy.plug_in()
    before = len(car.teensy.commands)
    car.turn(60, hold(0.0))
    assert car.serial.losses == 1
    assert car.link.fault is SourceFault.NONE
    after = [
        order.request for _, command in car.teensy.commands[before:] for order in command.motors
    ]
    assert after
    assert set(after) == {MotorRequest.EXIT}
    car.group.reset(time.monotonic())
    car.run()


def test_motors_are_not_entered_before_the_teensy_has_answered():
    car = Car()
    with pytest.raises(HardwareError, match="the Teensy has not answered yet"):
        car.group.set_enter(time.monotonic())
    car.close()


def test_missing_device_is_one_line():
    with pytest.raises(
        HardwareError, match=r"/dev/ttyNOT_THERE: cannot be opened: there is no such device"
    ):
        SerialLink.open(SerialSettings(path="/dev/ttyNOT_THERE"))


def test_port_in_use_is_one_line(car):
    with pytest.raises(HardwareError, match="cannot be opened"):
        open_serial(SerialSettings(path=car.teensy.path))


@pytest.mark.parametrize(
    ("share", "pulses", "expected"),
    [
        (0.0, SERVO_PULSES, 1500),
        (1.0, SERVO_PULSES, 2050),
        (-1.0, SERVO_PULSES, 950),
        (1.0, THROTTLE_PULSES, 1900),
        (-1.0, THROTTLE_PULSES, 1100),
        (0.25, THROTTLE_PULSES, 1600),
    ],
)
def test_share_of_a_pulse(share, pulses, expected):
    assert pulse(share, pulses) == expected


@pytest.mark.parametrize("share", [math.nan, 1.01, -2.0])
def test_share_out_of_range_is_refused(share):
    with pytest.raises(FrameError, match="allowed is -1 to 1"):
        pulse(share, SERVO_PULSES)


def test_motors_that_never_answered_have_no_position(car):
    car.teensy.deaf = {1, 2}
    car.turn(20)
    assert car.link.fault is SourceFault.NONE
    assert [motor.age(time.monotonic()) for motor in car.group.motors] == [math.inf, math.inf]
