"""One cycle of the wired car: readings in the station's units, commands as pulses and frames, and
the way out.
"""

import math
import time

import numpy as np
import pytest

from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import CarCommand
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.device_states import MotorFault, MotorState, SourceFault
from aerodima.hardware.devices.ublox import GpsSample
from aerodima.hardware.driving.car_guard import CarGuard
from aerodima.hardware.protocol.ak70 import make_exit
from aerodima.hardware.protocol.radio import decode_report
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.quantity import STANDARD_GRAVITY
from aerodima.workbench.scenario.signal_table import STATUS
from tests.hardware.car.fake_devices import CarOnTheBench
from tests.refusals import assert_refused

SAFETY = load_drive_safety()
HOLD = CarCommand(
    0.0, 0.0, np.array([0.0, 0.0, 17.0, 5.0, 0.0]), np.array([-1.5, 0.0, 17.0, 5.0, 0.0])
)


@pytest.fixture
def bench(monkeypatch):
    bench = CarOnTheBench()
    monkeypatch.setattr(time, "monotonic", lambda: bench.now)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    bench.car.start()
    return bench


def status(reading):
    return STATUS.read(reading.status)


def armed(bench):
    bench.cycle(CarCommand(), 2)
    bench.car.arm()
    while not status(bench.cycle(CarCommand())).armed:
        pass
    return bench


def test_a_motor_whose_command_was_under_way_on_another_thread_is_switched_off(bench):
    roll = armed(bench).car.motors[1]
    bench.car.disarm(bench.now)
    roll.state = MotorState.RUNNING  # by the command
    bench.cycle(HOLD)
    assert roll.state is MotorState.EXITING


def test_readings_have_the_units_and_signs_of_the_station(bench):
    armed(bench)
    bench.imu.newest = (bench.now, bench.imu.newest[1])
    reading = bench.cycle(HOLD)
    pitch, roll, sail, *_ = reading.tail_state
    assert (pitch, roll) == (pytest.approx(0.05, abs=0.03), pytest.approx(-1.5, abs=0.03))
    assert sail == 0.0  # no reply of the Teensy with a time yet
    bench.teensy.sent_time = bench.now
    assert bench.cycle(HOLD).tail_state[2] == pytest.approx(2 * math.pi - 0.2)
    np.testing.assert_allclose(
        reading.imu, [0.0, 0.0, 0.0, 0.1, -0.2, 0.9, 1.0, 2.0, 3.0], atol=1e-12
    )
    assert reading.speed == pytest.approx([3.3])
    named = status(reading)
    assert (named.armed, named.tail_roll_fault, named.imu_fault, named.speed_fault) == (
        1.0,
        0.0,
        0.0,
        0.0,
    )
    assert named.operator_age == 0.05
    assert bench.imu.aligned == pytest.approx(bench.now + 0.01)


def test_steering_left_and_driving_forward_are_longer_pulses(bench):
    bench.cycle(CarCommand(0.5236, 1.0))
    assert bench.teensy.pulses[-1] == (2050, 1900)
    bench.cycle(CarCommand(-0.2618, -0.5))
    assert bench.teensy.pulses[-1] == (1225, 1300)
    bench.cycle(CarCommand(-9.0, 9.0))
    assert bench.teensy.pulses[-1] == (950, 1900)


def test_speed_keeps_its_last_value_without_a_fix_and_says_so(bench):
    bench.cycle(CarCommand())
    bench.gps.newest = (bench.now, GpsSample(math.nan, fix=False))
    reading = bench.cycle(CarCommand())
    assert reading.speed == pytest.approx([3.3])
    assert status(reading).speed_fault == SourceFault.NO_FIX


def test_arming_is_refused_without_a_watchdog_test_and_nothing_is_sent(monkeypatch):
    bench = CarOnTheBench(authorised=False)
    bench.car.start()
    bench.cycle(CarCommand(), 2)
    assert_refused(bench.car.arm, HardwareError, "watched_can")
    assert bench.port.sent == []
    assert "arm" not in bench.watchdog.calls


def test_the_watchdog_is_armed_before_the_motors_and_beaten_in_every_cycle(bench):
    armed(bench)
    assert bench.watchdog.calls.index("arm") < bench.watchdog.calls.index("beat")
    beats = bench.watchdog.calls.count("beat")
    bench.cycle(HOLD, 5)
    assert bench.watchdog.calls.count("beat") == beats + 5


def test_a_watchdog_that_died_switches_the_motors_off(bench):
    armed(bench)
    bench.watchdog.reason = "the Teensy does not answer: watchdog"
    reading = bench.cycle(HOLD)
    assert status(reading).tail_roll_fault == MotorFault.BUS
    assert bench.watchdog.reason in reading.fault_text
    assert bench.port.exits(2, bench.now)


@pytest.mark.parametrize(
    "broken", [CarCommand(throttle=math.nan), CarCommand(tail_roll=np.full(5, math.inf))]
)
def test_a_command_that_is_not_finite_exits_both_motors_and_centres_the_pulses(bench, broken):
    armed(bench)
    bench.cycle(CarCommand(0.3, 0.5), 1)
    bench.cycle(broken)
    assert bench.teensy.pulses[-1] == (1500, 1500)
    assert bench.port.exits(1, bench.now)
    assert bench.port.exits(2, bench.now)
    assert status(bench.cycle(HOLD)).armed == 0.0


def test_a_command_of_zeros_leaves_the_tail_held(bench):
    armed(bench)
    bench.cycle(HOLD, 30)
    bench.car.hold(bench.now)
    bench.cycle(CarCommand(), 5)
    last = bench.port.motors[1].command
    assert (last.kp, last.kd) == (pytest.approx(17.0, rel=0.4), pytest.approx(5.0, rel=0.4))
    assert bench.port.motors[1].entered


def test_stop_sends_exit_frames_and_idle_pulses_several_times_whatever_fails(bench):
    armed(bench)
    bench.cycle(CarCommand(0.3, 0.5), 1)
    bench.teensy.commit = lambda: bench.teensy.pulses.append(bench.teensy.noted) or 1 / 0
    before = len(bench.teensy.pulses)
    bench.car.stop("test")
    bench.car.stop("again")
    assert bench.teensy.pulses[before:] == [(1500, 1500)] * 5
    exits = [frame for _, frame in bench.port.sent if frame in (make_exit(1), make_exit(2))]
    assert len(exits) >= 10
    assert bench.closed == [1]
    assert bench.watchdog.calls[-1] == "disarm"
    assert bench.car.stop_reason == "test"
    assert status(bench.car.read(bench.now)).armed == 0.0
    assert_refused(bench.car.arm, HardwareError, "watched_can", "test")
    sent = len(bench.port.sent)
    bench.car.hold(bench.now)
    bench.car.disarm(bench.now)
    assert len(bench.port.sent) == sent


def test_the_watchdog_waits_until_the_motors_have_answered_the_exit_frames(bench):
    armed(bench)
    bench.car.disarm(bench.now)
    assert bench.watchdog.calls[-1] == "beat"
    bench.cycle(CarCommand())
    assert bench.watchdog.calls[-1] == "disarm"
    assert "trip" not in bench.watchdog.calls


def test_exit_frames_that_nobody_answers_are_left_to_the_watchdog_too(bench):
    armed(bench)
    bench.port.motors[1].respond = lambda frame: []
    bench.car.disarm(bench.now)
    bench.cycle(CarCommand(), 8)
    assert bench.watchdog.calls[-1] == "beat"
    bench.cycle(CarCommand(), 8)
    assert bench.watchdog.calls[-1] == "trip"
    assert "disarm" not in bench.watchdog.calls[bench.watchdog.calls.index("arm") :]


@pytest.mark.parametrize("broken", ["silent motor", "blocked bus", "bus with a fault"])
def test_an_end_on_a_broken_bus_asks_the_watchdog_to_act(bench, broken):
    armed(bench)
    if broken == "silent motor":
        bench.port.motors[0].respond = lambda frame: []
    elif broken == "blocked bus":
        bench.port.flush = lambda timeout=0.2: False
    else:
        bench.port.fault = 3
    bench.car.stop("an exception in the controller")
    assert bench.watchdog.calls[-1] == "trip"


def test_an_emergency_stop_is_named_before_everything_else(bench):
    bench.radio.stopped = True
    bench.teensy.fault = SourceFault.SILENT
    bench.teensy.fault_text = "the Teensy is silent"
    reading = bench.cycle(CarCommand())
    assert status(reading).operator_fault == SourceFault.STOPPED
    assert status(reading).sail_fault == SourceFault.SILENT
    assert reading.fault_text != bench.teensy.fault_text


class Driving:
    """A car on the bench that drives at `speed`, m/s, under its guard; roll is to the side."""

    def __init__(self, bench, speed=3.3):
        self.bench = bench
        self.guard = CarGuard(bench.car, SAFETY)
        self.at(speed)
        self.turn(2)
        self.guard.arm(bench.now)
        self.turn(60)
        self.guard.drive(bench.radio.command.mode, bench.now)
        self.turn(50)

    def at(self, speed):
        self.bench.gps.newest = (self.bench.now, GpsSample(speed, True, 10.0))

    def turn(self, count=1):
        bench = self.bench
        for _ in range(count):
            bench.now += 0.01
            bench.port.now = bench.now
            for motor in bench.port.motors:
                motor.advance(0.01)
            self.guard.read(bench.now)
            self.guard.write(HOLD, bench.now)

    def after(self, fault, seconds=3.0):
        """Times from a fault to the first exit frames of pitch and roll, s."""
        begin = self.bench.now
        fault(self.bench)
        self.turn(round(seconds / 0.01))
        assert self.guard.finished
        return [self.bench.port.exits(motor_id, begin)[0] - begin for motor_id in (1, 2)]


def test_the_guard_on_the_wired_car_disarms_when_the_operator_falls_silent(bench):
    driving = Driving(bench)
    off = driving.after(lambda bench: setattr(bench.radio, "silence", 0.26))
    assert off == pytest.approx([SAFETY.max_tail_hold] * 2, abs=0.03)
    assert "0.26 s" in driving.guard.reason
    assert "roll to the middle" in driving.guard.posture
    assert bench.port.motors[1].position == pytest.approx(0.0, abs=0.1), "it was held out before"


def test_a_lost_imu_in_mid_drive_leaves_the_pitch_motor_on_and_takes_roll_to_the_middle(bench):
    driving = Driving(bench)
    lost = bench.now
    bench.imu.code = SourceFault.SILENT
    driving.turn(round(SAFETY.max_tail_hold / 0.01) - 2)
    pitch, roll = bench.port.motors
    assert bench.port.exits(1, lost) == bench.port.exits(2, lost) == []
    assert (pitch.entered, pitch.command.kp) == (True, pytest.approx(17.0, rel=0.1))
    assert (roll.position, roll.speed) == (pytest.approx(0.0, abs=0.05), pytest.approx(0, abs=0.1))
    assert set(bench.teensy.pulses[-round(SAFETY.max_tail_hold / 0.01) + 4 :]) == {(1500, 1500)}
    assert "roll to the middle" in decode_report(bench.radio.reports[-1]).text
    driving.turn(5)
    assert bench.port.exits(1, lost)[0] - lost == pytest.approx(SAFETY.max_tail_hold, abs=0.03)


def mute(joint):
    return lambda bench: setattr(bench.port.motors[joint], "respond", lambda frame: [])


def test_a_roll_motor_that_fails_is_off_and_pitch_is_held(bench):
    driving = Driving(bench)
    pitch, roll = driving.after(mute(1))
    assert roll < 0.08
    assert pitch == pytest.approx(roll + SAFETY.max_tail_hold, abs=0.03)
    assert "roll limp" in driving.guard.posture
    assert "tail roll" in driving.guard.reason
    armed = bench.watchdog.calls.index("arm")
    off = bench.watchdog.calls.index("trip")
    assert off - armed > SAFETY.max_tail_hold / 0.01, "not before pitch is off"


@pytest.mark.parametrize(
    ("fault", "speed", "within"),
    [
        (mute(1), 0.0, 0.08),
        (mute(0), 3.3, 0.08),
        (lambda bench: setattr(bench.port.motors[0], "fault", 2), 3.3, 0.03),
        (lambda bench: setattr(bench.radio, "stopped", True), 3.3, 0.02),
    ],
)
def test_both_motors_go_off_at_once(bench, fault, speed, within):
    driving = Driving(bench, speed)
    assert max(driving.after(fault, 0.5)) <= within
    assert driving.guard.posture == "motors off at once"


def test_a_car_without_a_tail_has_no_motors_and_says_so():
    bench = CarOnTheBench(
        "tail.mode=none", authorised=False
    )  # a watchdog test would need the motors of a tail
    bench.car.authorise()
    bench.car.start()
    named = status(bench.cycle(CarCommand(), 3))
    assert (named.tail_pitch_fault, named.tail_roll_fault) == (
        SourceFault.NOT_FITTED,
        SourceFault.NOT_FITTED,
    )
    assert named.armed == 0.0
    bench.car.arm()
    assert bench.port.sent == []
    assert status(bench.cycle(CarCommand(), 6)).armed == 1.0, "throttle and steering take commands"
    told = decode_report(bench.radio.reports[-1])
    assert (told.armed, told.has_tail) == (True, False)
    bench.car.disarm(bench.now)
    assert status(bench.cycle(CarCommand(), 2)).armed == 0.0


def test_the_lean_is_that_of_the_accelerometer_whatever_the_attitude_says(bench):
    """An attitude that hangs upright: in a turn at 1.2 g, and while the car lies on its side."""
    limit = load_drive_safety().attitude_limit
    for felt, cycles in (((0.0, 12.0, 0.0), 200), ((0.0, STANDARD_GRAVITY, -STANDARD_GRAVITY), 25)):
        sample = Bno055Sample((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), felt)
        leans = []
        for _ in range(cycles):
            bench.imu.newest = (bench.now, sample)
            leans.append(bench.cycle(CarCommand()).lean)
        assert (max(leans) > limit) is (felt[2] != 0.0)
    assert bench.teensy.attitude[3:] == (leans[-1], 0.0)


def test_the_attitude_goes_to_the_teensy_with_its_time_and_the_sail_rate_is_of_its_clock(bench):
    bench.imu.newest = (9.99, mounted(0.3, -0.2))
    bench.cycle(CarCommand())
    assert bench.teensy.attitude[:3] == pytest.approx((0.3, -0.2, 9.99))
    bench.imu.code = SourceFault.REPORTED
    bench.imu.newest = (10.0, mounted(0.0, 0.0))
    bench.cycle(CarCommand())
    assert bench.teensy.attitude[2] == 9.99, "one that is not believed is not passed on"
    rates = []
    for step in range(30):  # over the half turn of the encoder and the whole turn of the sail
        bench.teensy.sent_time = 5.0 + 0.01 * step
        bench.teensy.sail = math.remainder(3.0 + 0.2 * step, 2.0 * math.pi)
        rates.append(bench.cycle(CarCommand()).tail_state[5])
    assert rates[1:] == pytest.approx([20.0] * 29)


def mounted(roll, pitch):
    """The chip's sample of a car that stands like that."""
    return load_mounting().imu_sample(np.array([roll, pitch, 0.0, *[0.0] * 6]))
