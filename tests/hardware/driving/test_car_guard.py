"""What reaches the car and when it stops, tick by tick in simulated time."""

import math

import numpy as np
import pytest

from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import CarCommand
from aerodima.hardware.devices.device_states import MotorFault, SourceFault
from aerodima.hardware.devices.radio_link import IDLE
from aerodima.hardware.driving.car_guard import CarGuard, Stage
from aerodima.hardware.protocol.radio import OperatorCommand, OperatorPrompt, RadioMode
from aerodima.hardware.protocol.teensy import SWITCHED_OFF, TeensyStatus
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.driving.fake_wiring import PERIOD, FakeWiring
from tests.refusals import assert_refused

SAFETY = load_drive_safety()
FORWARD = CarCommand(
    0.1, 0.05, np.array([0.0, 0.0, 17.0, 5.0, 0.0]), np.array([-1.57, 0.0, 17.0, 5.0, 0.0])
)
STOP = CarCommand()


class Car:
    def __init__(self):
        self.wiring = FakeWiring()
        self.guard = CarGuard(self.wiring, SAFETY)
        self.now = 100.0

    def turn(self, command=FORWARD, count=1, late=0.0):
        for _ in range(count):
            self.now += PERIOD
            self.guard.read(self.now, self.now - late)
            self.guard.write(command, self.now)
        return self

    def driving(self, command=FORWARD):
        self.turn(count=2)
        self.guard.arm(self.now)
        self.turn(count=2)
        self.guard.drive(RadioMode.AUTO, self.now)
        return self.turn(command, count=3)

    @property
    def last(self):
        return self.wiring.commands[-1]


def same(a, b):
    return (a.steering_angle, a.throttle) == (b.steering_angle, b.throttle) and np.array_equal(
        a.tail_roll, b.tail_roll
    )


@pytest.fixture
def car():
    return Car()


@pytest.mark.parametrize("mode", [RadioMode.AUTO, RadioMode.MANUAL, RadioMode.CONTROL])
def test_a_switch_that_stands_on_a_mode_from_before_is_not_obeyed_until_it_was_in_idle(car, mode):
    car.wiring.operator = OperatorCommand(mode, 1.0)
    car.wiring.stubborn = True
    car.turn(count=2)
    car.guard.arm(car.now)
    car.turn(count=100)
    assert car.wiring.prompt is OperatorPrompt.RETURN_TO_IDLE
    assert_refused(lambda: car.guard.drive(mode, car.now), HardwareError, "IDLE")
    car.turn()
    assert all(same(command, STOP) for command in car.wiring.commands)
    car.wiring.operator = IDLE
    car.turn(count=2)
    assert car.wiring.prompt is OperatorPrompt.SELECT_MODE
    car.wiring.operator = OperatorCommand(mode, 1.0)
    car.turn()
    car.guard.drive(mode, car.now)
    car.turn()
    assert same(car.last, FORWARD)
    assert car.wiring.prompt is OperatorPrompt.NONE


def test_an_idle_that_is_older_than_the_holding_motors_does_not_count(car):
    car.wiring.operator = IDLE
    car.wiring.ages["operator"] = 0.2
    car.turn(count=2)
    car.guard.arm(car.now)
    car.turn(count=15)
    assert car.wiring.prompt is OperatorPrompt.RETURN_TO_IDLE
    car.turn(count=10)
    assert car.wiring.prompt is OperatorPrompt.SELECT_MODE


def soft(source, code, text=""):
    return lambda car: car.wiring.set_fault(source, code, text)


SOFT = {
    "operator silent": soft("operator", SourceFault.SILENT),
    "radio lost": soft("operator", SourceFault.LOST),
    "imu silent": soft("imu", SourceFault.SILENT),
    "imu error": soft("imu", SourceFault.REPORTED),
    "gps silent": soft("speed", SourceFault.SILENT),
    "left AUTO": lambda car: setattr(car.wiring, "operator", OperatorCommand(RadioMode.IDLE)),
    "took over": lambda car: setattr(
        car.wiring, "operator", OperatorCommand(RadioMode.MANUAL, 1.0)
    ),
    "run over": lambda car: car.guard.stop("the run is over", car.now),
}


def slow_ticks(car):
    for _ in range(SAFETY.most_slow_ticks):
        car.guard.note_computing(SAFETY.slow_tick + 0.001, car.now)


BROKEN = CarCommand(throttle=math.nan)
PUSHES = CarCommand(tail_pitch=np.array([0.0, 0.0, -0.1, 0.0, 0.0]))
HELD_WHILE_MOVING = {
    "roll motor": lambda car: car.wiring.motor_fault(),
    "roll motor beyond range": lambda car: car.wiring.motor_fault(code=MotorFault.OUT_OF_RANGE),
    "slow controller": slow_ticks,
    "late loop": lambda car: car.turn(late=0.03, count=SAFETY.most_overruns),
    "NaN": lambda car: car.guard.write(BROKEN, car.now),
    "negative gain": lambda car: car.guard.write(PUSHES, car.now),
}


def finish(car):
    """Turns until the motors are off; how long they were held, s."""
    while car.guard.stage is Stage.HOLDING:
        car.turn()
    held = car.now - car.guard.stop_time
    car.turn(count=round(SAFETY.after_exit / PERIOD) + 1)
    assert car.guard.finished
    assert not car.guard.hard
    return held


HELD = SOFT | HELD_WHILE_MOVING


@pytest.mark.parametrize("cause", HELD.values(), ids=HELD)
@pytest.mark.parametrize("gps", [True, False])
def test_a_car_that_moves_cuts_the_throttle_at_once_holds_the_tail_then_exits(car, cause, gps):
    if not gps:
        car.wiring.faults["speed"] = SourceFault.NOT_FITTED
    car.driving()
    cause(car)
    car.turn()
    assert car.guard.stage is Stage.HOLDING
    assert (car.last.steering_angle, car.last.throttle) == (0.0, 0.0)
    assert not np.any(car.last.tail_roll)
    assert car.wiring.calls == ["arm", "hold"]
    posture = "roll limp" if "tail_roll" in car.wiring.faults else "roll to the middle"
    assert posture in car.wiring.posture
    assert finish(car) == pytest.approx(SAFETY.max_tail_hold, abs=1.5 * PERIOD)
    assert car.wiring.calls == ["arm", "hold", "disarm"]
    assert posture in car.guard.posture
    assert all(same(command, STOP) for command in car.wiring.commands[-20:])


@pytest.mark.parametrize("cause", HELD.values(), ids=HELD)
def test_the_tail_of_a_car_that_comes_to_rest_is_held_until_then(car, cause):
    car.driving()
    cause(car)
    car.turn(count=100)
    car.wiring.speed = SAFETY.rest_speed - 0.1
    known = "speed" not in car.wiring.faults
    held = 1.0 + SAFETY.speed_time if known else SAFETY.max_tail_hold
    assert finish(car) == pytest.approx(held, abs=3.5 * PERIOD)
    assert ("at rest" in car.guard.posture) is known


@pytest.mark.parametrize("cause", HELD.values(), ids=HELD)
def test_at_rest_a_broken_part_switches_the_motors_off_at_once(car, cause):
    car.wiring.speed = 0.1
    car.turn(count=50)
    car.driving()
    cause(car)
    car.turn()
    at_once = cause in HELD_WHILE_MOVING.values()
    assert car.guard.stage is (Stage.EXITING if at_once else Stage.HOLDING)
    assert car.guard.hard is at_once
    if not at_once and "speed" not in car.wiring.faults:
        assert finish(car) == pytest.approx(SAFETY.tail_hold, abs=1.5 * PERIOD)


@pytest.mark.parametrize(("throttle", "stage"), [(0.1, Stage.HOLDING), (0.0, Stage.EXITING)])
def test_a_car_whose_speed_is_unknown_moves_once_its_throttle_was_opened(car, throttle, stage):
    car.wiring.faults["speed"] = SourceFault.NOT_FITTED
    car.driving(CarCommand(0.1, throttle))
    slow_ticks(car)
    assert car.guard.stage is stage


HARD = {
    "emergency stop": soft("operator", SourceFault.STOPPED),
    "pitch motor": lambda car: car.wiring.motor_fault("pitch"),
    "teensy silent": soft("sail", SourceFault.SILENT),
    "teensy watchdog": soft("sail", SourceFault.REPORTED),
    "teensy fallen": soft("sail", SourceFault.REPORTED, SWITCHED_OFF[TeensyStatus.ATTITUDE]),
    "motors went off": lambda car: setattr(car.wiring, "armed", False),
    "signal": lambda car: car.guard.stop("SIGINT", car.now, "signal"),
}


@pytest.mark.parametrize("cause", HARD.values(), ids=HARD)
def test_a_hard_reason_exits_at_once(car, cause):
    car.driving()
    cause(car)
    car.turn()
    assert car.wiring.calls[-1] == "disarm"
    assert same(car.last, STOP)
    car.turn(count=round(SAFETY.after_exit / PERIOD) + 1)
    assert car.guard.finished
    assert car.guard.hard
    assert car.guard.reason


@pytest.mark.parametrize("place", ["steering_angle", "throttle", "tail_pitch", "tail_roll"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_command_that_is_not_finite_never_reaches_the_car(car, place, value):
    car.driving()
    values = {
        "steering_angle": 0.1,
        "throttle": 0.05,
        "tail_pitch": np.ones(5),
        "tail_roll": np.ones(5),
    }
    values[place] = (
        value if place in ("steering_angle", "throttle") else np.array([0.0, value, 1.0, 1.0, 0.0])
    )
    car.turn(CarCommand(**values))
    assert same(car.last, STOP)
    assert car.guard.stage is Stage.HOLDING


def test_emergency_stop_latches(car):
    car.driving()
    car.wiring.faults["operator"] = SourceFault.STOPPED
    car.turn(count=30)
    assert car.guard.finished
    car.wiring.faults.clear()
    car.turn(count=200)
    assert same(car.last, STOP)
    assert "arm" not in car.wiring.calls[1:]
    assert_refused(lambda: car.guard.arm(car.now), HardwareError, car.guard.reason)


@pytest.mark.parametrize("causes", [["signal"], []])
def test_a_reason_to_stop_before_arming_forbids_it(car, causes):
    car.turn(count=2)
    car.guard.stop("SIGINT", car.now, *causes)
    assert car.guard.finished
    car.turn(count=20)
    assert_refused(lambda: car.guard.arm(car.now), HardwareError, "SIGINT")
    assert "arm" not in car.wiring.calls


def test_a_signal_while_the_car_is_being_armed_or_let_go_switches_it_off(car):
    car.turn(count=2)
    arm = car.wiring.arm

    def interrupted():
        arm()
        car.guard.stop("SIGTERM", car.now, "signal")

    car.wiring.arm = interrupted
    car.guard.arm(car.now)
    assert car.guard.stage is Stage.EXITING
    assert car.wiring.calls == ["arm", "disarm"]
    assert_refused(lambda: car.guard.drive(RadioMode.AUTO, car.now), HardwareError, "SIGTERM")


def test_a_device_that_is_silent_or_a_missing_watchdog_test_forbids_arming(car):
    def arm():
        car.turn()
        car.guard.arm(car.now)

    assert_refused(lambda: car.guard.drive(RadioMode.AUTO, car.now), HardwareError, "not armed")
    car.wiring.faults["imu"] = SourceFault.SILENT
    assert_refused(arm, HardwareError, "imu")
    car.wiring.faults.clear()
    car.wiring.refuse = "no watchdog test"
    assert_refused(arm, HardwareError, car.wiring.refuse)
    assert car.guard.stage is Stage.READY
    car.wiring.faults["operator"] = SourceFault.STOPPED
    car.turn()
    car.wiring.faults.clear()
    car.wiring.refuse = ""
    assert_refused(arm, HardwareError, "STOPPED")


def test_a_hard_reason_while_holding_exits_at_once(car):
    car.driving()
    car.guard.stop("the operator is silent", car.now)
    car.turn(count=3)
    car.wiring.motor_fault("roll")
    car.turn()
    assert car.guard.stage is Stage.HOLDING
    car.wiring.motor_fault("pitch")
    car.turn()
    assert car.guard.stage is Stage.EXITING
    assert car.guard.reason.startswith("the operator is silent; then ")
    assert "pitch" in car.guard.reason
    assert car.guard.hard, "it does not end in order"
    assert car.guard.posture.startswith("pitch held, roll limp for 0.05 s")


def test_late_cycles_are_counted_and_too_many_in_a_row_stop_the_car(car):
    car.driving()
    car.turn(late=0.03, count=SAFETY.most_overruns - 1)
    car.turn()
    assert car.guard.stage is Stage.DRIVING
    assert car.guard.overruns == SAFETY.most_overruns - 1
    car.turn(late=0.03, count=SAFETY.most_overruns)
    assert car.guard.stage is Stage.HOLDING
    assert "30 ms" in car.guard.reason


@pytest.mark.parametrize(
    ("pause", "cause", "named"),
    [
        (
            0.05,
            HELD_WHILE_MOVING["roll motor"],
            "the computer fell behind by 50 ms: tail roll: no reply",
        ),
        (0.06, SOFT["imu silent"], "the computer fell behind by 60 ms: imu SILENT"),
        (0.04, SOFT["imu silent"], "imu SILENT"),
        (0.08, HARD["teensy watchdog"], "the computer fell behind by 80 ms: sail REPORTED"),
        (0.08, HARD["teensy fallen"], "sail REPORTED"),
        (0.05, HARD["emergency stop"], "operator STOPPED"),
        (0.05, SOFT["imu error"], "imu REPORTED"),
        (0.0, HELD_WHILE_MOVING["roll motor"], "tail roll: no reply"),
    ],
)
def test_silence_after_a_pause_of_the_computer_is_its_own_fault(car, pause, cause, named):
    car.driving()
    car.now += pause
    car.wiring.ages["imu"] = SAFETY.imu_silence
    car.turn(count=5)
    cause(car)
    car.turn()
    assert car.guard.reason.startswith(named)


def test_too_many_slow_ticks_within_a_second_stop_the_car_and_a_single_one_is_counted(car):
    car.driving()
    slow = SAFETY.slow_tick + 0.001
    for gap in (0.0, 1.0):  # s without a slow tick
        car.turn(count=round(gap / PERIOD) + 1)
        car.guard.note_computing(SAFETY.slow_tick, car.now)
        for _ in range(SAFETY.most_slow_ticks - 1):
            car.turn()
            car.guard.note_computing(slow, car.now)
    assert car.guard.stage is Stage.DRIVING
    assert len(car.guard.slow_ticks) == 2 * (SAFETY.most_slow_ticks - 1)
    car.turn()
    car.guard.note_computing(slow, car.now)
    assert car.guard.stage is Stage.HOLDING
    assert f"{SAFETY.most_slow_ticks}" in car.guard.reason


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_more_current_than_the_fuse_has_stops_the_car_and_a_tail_that_brakes_does_not(car, way):
    car.driving()
    read = car.wiring.read

    def powerful(now):
        reading = read(now)
        reading.tail_state[4], reading.tail_torque[1] = 35.0, way * 24.0  # 840 W
        return reading

    car.wiring.read = powerful
    car.turn()
    assert car.guard.stage is (Stage.HOLDING if way > 0.0 else Stage.DRIVING)
    assert ("35 A" in car.guard.reason) is (way > 0.0)


def test_a_car_without_a_tail_drives_without_armed_motors(car):
    car.guard = CarGuard(car.wiring, SAFETY, has_tail=False)
    car.turn()
    car.guard.arm(car.now)
    car.wiring.armed = False
    car.wiring.faults |= {"tail_roll": SourceFault.NOT_FITTED, "tail_pitch": SourceFault.NOT_FITTED}
    car.turn(count=2)
    car.guard.drive(RadioMode.AUTO, car.now)
    car.turn()
    assert same(car.last, FORWARD)


@pytest.mark.parametrize("heard", [True, False])
def test_an_operator_who_leaves_the_mode_and_falls_silent_was_lost(car, heard):
    car.driving()
    car.wiring.operator = IDLE  # by hand, or by the console whose page has gone
    car.turn(count=10)
    assert (car.guard.stage, car.guard.left) == (Stage.HOLDING, True)
    if not heard:
        car.wiring.faults["operator"] = SourceFault.SILENT
    car.turn(count=250)
    assert car.guard.finished
    assert (car.guard.left, car.guard.hard) == (heard, False)
    assert "IDLE" in car.guard.reason
