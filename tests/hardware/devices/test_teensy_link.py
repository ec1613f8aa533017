"""Motors, pulses, attitude and sail through the Teensy's strings, with the same checks as on the
CAN bus.
"""

import math
from types import SimpleNamespace

import pytest

from aerodima.hardware.devices import teensy_link
from aerodima.hardware.devices.device_states import MotorFault, MotorState, SourceFault
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.protocol.ak70 import (
    PROFILES,
    MitReply,
    decode_reply,
    make_enter,
    make_exit,
    make_neutral,
)
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.protocol.teensy import (
    Attitude,
    MotorReport,
    MotorRequest,
    TeensyStatus,
)
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.fake_motors import PERIOD, PROFILE, hold, settings
from tests.hardware.fake_serial import FakeLink
from tests.hardware.fake_teensy import FakeTeensy
from tests.refusals import assert_refused


class Car:
    """The computer's side of the bridge wiring, and its loop in simulated time."""

    def __init__(self):
        self.teensy = FakeTeensy()
        self.wire = FakeLink(self.teensy.answer)
        self.link = TeensyLink(self.wire, (1, 2), PROFILE)
        self.group = MotorGroup((settings("tail pitch", 1), settings("tail roll", 2)), self.link)

    def turn(self, cycles, command=None):
        for _ in range(cycles):
            self.wire.now += PERIOD
            self.teensy.advance(PERIOD)
            self.group.step(self.wire.now)
            if command is not None:
                for motor in self.group.motors:
                    motor.set_command(command, self.wire.now)
            self.link.commit()

    def run(self):
        self.turn(10)
        self.group.set_enter(self.wire.now)
        self.turn(40)
        self.turn(20, hold(0.0))
        assert self.states() == {MotorState.RUNNING}, self.group.fault_text
        return self

    def states(self):
        return {motor.state for motor in self.group.motors}

    def requests(self, since=0):
        return [
            order.request for command in self.teensy.commands[since:] for order in command.motors
        ]

    def assert_switched_off_within(self, cycles, since):
        assert self.states() == {MotorState.FAULTED}
        assert set(self.requests(since + cycles)) == {MotorRequest.EXIT}


@pytest.fixture
def car(monkeypatch):
    car = Car()
    monkeypatch.setattr(teensy_link, "time", SimpleNamespace(monotonic=lambda: car.wire.now))
    return car


def test_motors_are_entered_moved_and_exited_through_the_strings(car):
    car.run()
    car.turn(100, hold(0.4))
    assert car.group.ready, car.group.fault_text
    assert car.teensy.motors[2].position == pytest.approx(0.4, abs=0.05)
    assert car.group.motors[1].temperature == 30.0
    car.group.set_exit(car.wire.now)
    assert car.link.flush()
    assert not any(motor.entered for motor in car.teensy.motors.values())


def test_motor_that_nobody_asked_anything_is_ordered_to_exit(car):
    car.turn(5)
    assert set(car.requests()) == {MotorRequest.EXIT}
    assert car.group.motors[0].position == pytest.approx(0.0, abs=1e-3), (
        "known before it is entered"
    )


def test_sail_and_pulses_pass_through(car):
    car.teensy.sail = 270.0
    car.link.set_pulses(1612, 1700)
    car.turn(5)
    assert car.link.sail == pytest.approx(-math.pi / 2, abs=1e-4)
    assert (car.teensy.commands[-1].servo, car.teensy.commands[-1].throttle) == (1612, 1700)


@pytest.mark.parametrize("place", range(3), ids=["roll", "pitch", "time"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_attitude_that_is_not_finite_is_not_passed_on_and_the_last_one_grows_old(
    car, place, value
):
    car.turn(1)
    assert car.teensy.commands[-1].attitude is None
    car.link.set_attitude(0.1, -0.2, car.wire.now - 0.004)
    car.turn(1)
    assert car.teensy.commands[-1].attitude == Attitude(0.1, -0.2, 14)
    broken = [0.3, 0.4, car.wire.now]
    broken[place] = value
    car.link.set_attitude(*broken)
    car.turn(1)
    assert car.teensy.commands[-1].attitude == Attitude(0.1, -0.2, 24)


def test_time_of_sending_is_the_teensys(car):
    car.turn(2)
    car.wire.now += 0.003  # the last reply waits on its way
    car.turn(30)
    assert car.link.age(car.wire.now) == pytest.approx(PERIOD)
    assert car.link.sent_time == pytest.approx(car.wire.now - PERIOD - 0.003, abs=1e-3)


def test_order_of_a_cycle_is_exit_before_enter_before_command(car):
    neutral = make_neutral(1, PROFILE)
    for frames, expected in (
        ((neutral, make_enter(1), neutral), MotorRequest.ENTER),
        ((make_exit(1), make_enter(1), neutral), MotorRequest.EXIT),
    ):
        assert all(map(car.link.send, frames))
        car.link.commit()
        assert car.requests()[-2] is expected


def test_forgotten_motor_keeps_its_command_for_a_short_while_only(car):
    car.link.send(make_neutral(1, PROFILE))
    for _ in range(25):
        car.link.commit()
    assert car.requests()[::2] == [MotorRequest.COMMAND] * 21 + [MotorRequest.EXIT] * 4


def test_zero_frame_and_foreign_frames_are_not_passed_on(car):
    for frame in (
        CanFrame(1, bytes.fromhex("FFFFFFFFFFFFFFFE")),
        make_neutral(3, PROFILE),
        CanFrame(1, bytes(8), extended=True),
    ):
        assert not car.link.send(frame)


def test_motor_that_falls_silent_behind_a_living_teensy_is_noticed(car):
    car.run()
    since = len(car.teensy.commands)
    car.teensy.deaf.add(2)
    car.turn(30, hold(0.0))
    assert car.group.motors[1].fault is MotorFault.NO_REPLY
    car.assert_switched_off_within(7, since)


def test_replies_go_on_when_their_counter_runs_over(car):
    car.run()
    car.turn(600, hold(0.0))
    assert car.group.ready, car.group.fault_text
    assert car.group.motors[1].missed == 0


def test_a_position_beyond_the_profile_is_no_reply(car):
    state = MitReply(1, 12.6, 0.0, 0.0, temperature=30, fault=0)
    assert car.link._frame_of(MotorReport(state, 99)) is None
    inside = MotorReport(state._replace(position=0.0), 100)
    assert car.link._frame_of(inside).data[1:3] == make_neutral(1, PROFILE).data[:2]


@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
@pytest.mark.parametrize("health", [(31, 2), (None, None)])
def test_a_reply_has_the_form_of_its_profile_and_unknown_stays_unknown(profile, health):
    link = TeensyLink(FakeLink(), (1, 2), profile)
    frame = link._frame_of(MotorReport(MitReply(1, 0.5, 1.0, 0.5, *health), 1))
    reply = decode_reply(frame, profile)
    known = 8 in profile.reply_lengths
    assert (reply.temperature, reply.fault) == (health if known else (None, None))
    assert reply.position == pytest.approx(0.5, abs=2e-3)


def test_a_teensy_counts_as_silent_a_tenth_of_a_second_after_it_was_asked(car):
    """A computer that paused has asked for nothing."""
    car.turn(2)
    car.wire.now += 0.5
    car.link.poll()
    assert car.link.fault is SourceFault.NONE
    car.teensy.damage = lambda text: b""
    car.link.commit()
    begin = car.wire.now
    for silent, fault in ((0.099, SourceFault.NONE), (0.101, SourceFault.SILENT)):
        car.wire.now = begin + silent
        car.link.poll()
        assert car.link.fault is fault


@pytest.mark.parametrize(
    "damage", [lambda text: b"", lambda text: text.replace(b"90", b"91"), lambda text: text[:-8]]
)
def test_silent_or_damaged_teensy_switches_the_motors_off(car, damage):
    car.run()
    since = len(car.teensy.commands)
    car.teensy.damage = damage
    car.turn(40, hold(0.0))
    car.assert_switched_off_within(7, since)
    assert car.link.fault is SourceFault.SILENT
    car.teensy.damage = lambda text: text
    car.turn(20, hold(0.0))
    assert car.link.fault is SourceFault.NONE
    assert car.states() == {MotorState.FAULTED}, "nothing is re-armed by itself"


def test_watchdog_of_the_teensy_is_a_fault(car):
    car.run()
    car.teensy.status = TeensyStatus.WATCHDOG_ACTED
    car.turn(5, hold(0.0))
    assert car.link.fault is SourceFault.REPORTED
    assert {motor.fault for motor in car.group.motors} == {MotorFault.BUS}


def test_a_lost_port_switches_the_motors_off_and_one_that_is_back_re_arms_nothing(car):
    car.run()
    since = len(car.teensy.commands)
    car.wire.fault = "no such device"
    car.turn(5, hold(0.0))
    assert car.link.fault is SourceFault.LOST
    car.wire.fault = ""
    car.turn(60, hold(0.0))
    assert car.link.fault is SourceFault.NONE
    car.assert_switched_off_within(2, since)


def test_motors_are_not_entered_before_the_teensy_has_answered(car):
    assert_refused(lambda: car.group.set_enter(car.wire.now), HardwareError, "Teensy")
