"""What the firmware stops and limits by itself: attitude, throttle, the heartbeat on the bus,
torque and range.
"""

import math
import random
from dataclasses import replace

import numpy as np
import pytest

from aerodima.hardware.car.bus_watch import HeartbeatState, decode_answer, make_heartbeat
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.motor_limits import MotorLoad
from aerodima.hardware.devices.motor_limits import limit_command as limit_on_the_computer
from aerodima.hardware.driving.drive_limits import DriveLimits
from aerodima.hardware.firmware.teensy_firmware import motor_limits
from aerodima.hardware.protocol.ak70 import MitCommand, make_exit
from aerodima.hardware.protocol.teensy import Attitude, MotorRequest, TeensyStatus
from tests.hardware.devices.test_motor_limits import settings as joint
from tests.hardware.firmware.core_functions import limit_command
from tests.hardware.firmware.test_core_watchdog import LEVEL, MS, PUSH, TIMING, Bench

SAFETY = load_drive_safety()
MOUNTING = load_mounting()
HEARTBEAT = make_heartbeat(HeartbeatState.ARMED, 7)
OVER = Attitude(SAFETY.attitude_limit + 0.02, 0.0, 8)


def commanding(bench, seconds, **what):
    """A drive that goes on commanding; when the Teensy switched everything off, s after the
    beginning.
    """
    begin = bench.now
    acted = math.inf
    for _ in range(round(seconds / 0.01)):
        bench.write(MotorRequest.COMMAND, PUSH, **{"throttle": 1520, **what})
        for _ in range(10):
            bench.wait(MS)
            if bench.core.state.status != TeensyStatus.RUNNING:
                acted = min(acted, bench.now - begin)
    return acted


@pytest.mark.parametrize(
    "attitude",
    [
        OVER,
        Attitude(-3.1, 0.0, 8),
        Attitude(0.0, 1.2, 8),
        Attitude(0.0, -1.2, 8),
        Attitude(0.0, 0.0, 8, lean=SAFETY.attitude_limit + 0.02),
    ],
)
def test_a_car_on_its_side_is_stopped_although_the_drive_goes_on_commanding(attitude):
    bench = Bench().drive()
    begin = bench.now
    acted = commanding(bench, 1.0, attitude=attitude)
    assert TIMING.attitude_time <= acted <= TIMING.attitude_time + 0.011
    assert (bench.core.state.servo, bench.core.state.throttle) == (1500, 1500)
    assert bench.core.state.status == TeensyStatus.ATTITUDE
    assert bench.last_reply().status is TeensyStatus.ATTITUDE
    for motor_id in (1, 2):
        exits = bench.exits(motor_id, since=begin)
        assert exits[0] - begin == pytest.approx(acted, abs=2 * MS)
        assert len(exits) >= TIMING.exit_burst + 1


@pytest.mark.parametrize("seed", range(24))
def test_computer_and_firmware_judge_a_car_alike(seed):
    """The same rule, with the times of the firmware; the throttle needs no time."""
    draw = random.Random(seed)
    times = {name: getattr(TIMING, name) for name in ("attitude_time", "straight_time")}
    safety = SAFETY.model_copy(update={**times, "throttle_rate": 100.0})
    limits = DriveLimits(safety)
    steering = draw.choice([0.0, 0.39, 0.41, -0.52])
    throttle = draw.choice([0.28, 0.32, -0.5])
    state = [draw.choice([0.0, 0.0, 1.0, 1.1]), 0.0, 0.0, draw.choice([0.09, -0.2])]
    state[:3] = draw.sample(state[:3], 3)
    roll, pitch, lean, yaw_rate = state
    reading = CarReading(
        imu=np.array([roll, pitch, 0.0, 0.0, 0.0, yaw_rate, 0.0, 0.0, 0.0]), lean=lean
    )
    for now in (0.0, 0.01):
        limits.throttle(throttle, now)
    reasons = [
        limits.tilt(reading, 0.01 * tick) or limits.straight(reading, steering, 0.01 * tick)
        for tick in range(150)
    ]
    stopped = next((0.01 * tick for tick, reason in enumerate(reasons) if reason), math.inf)
    pulses = {
        "throttle": MOUNTING.throttle_pulse(throttle),
        "servo": MOUNTING.servo_pulse(steering),
    }
    attitude = Attitude(roll, pitch, 8, lean, yaw_rate)
    acted = commanding(Bench(safety=safety).drive(), 1.5, attitude=attitude, **pulses)
    assert acted == pytest.approx(stopped, abs=0.021)


def test_a_car_that_rocks_is_not_stopped():
    bench = Bench().drive()
    for _ in range(20):
        assert math.isinf(commanding(bench, TIMING.attitude_time - 0.02, attitude=OVER))
        assert math.isinf(commanding(bench, 0.02))


@pytest.mark.parametrize(
    "attitude", [None, Attitude(0.0, 0.0, round(1000 * TIMING.attitude_age) + 1)]
)
def test_the_car_does_not_drive_with_an_attitude_that_is_old_or_unknown(attitude):
    bench = Bench().drive()
    assert commanding(bench, 0.05, attitude=attitude) <= 0.002
    assert bench.core.state.status == TeensyStatus.ATTITUDE


@pytest.mark.parametrize("attitude", [None, Attitude(0.0, 0.0, 60000)])
def test_motors_alone_may_be_moved_without_an_attitude(attitude):
    bench = Bench().drive()
    assert math.isinf(commanding(bench, 0.5, attitude=attitude, throttle=1500))


def test_an_old_attitude_on_the_side_still_stops_the_tail():
    bench = Bench().drive()
    assert (
        commanding(bench, 0.5, attitude=replace(OVER, age=60000), throttle=1500)
        < TIMING.attitude_time + 0.011
    )


@pytest.mark.parametrize("wiring", ["teensy_bridge", "watched_can"])
@pytest.mark.parametrize(("asked", "end"), [(1900, 1700), (1100, 1300)])
def test_a_throttle_step_is_clipped_and_comes_on_slowly(wiring, asked, end):
    bench = Bench(wiring)

    def reached(throttle):
        """Distance from neutral, us."""
        bench.wait(0.01)
        bench.write(MotorRequest.EXIT, throttle=throttle)
        return abs(bench.core.state.throttle - 1500)

    reached(1500)
    pulses = [reached(asked) for _ in range(300)]
    assert pulses[0] <= SAFETY.throttle_start * 400 + 2
    assert max(np.diff(pulses)) <= math.ceil(SAFETY.throttle_rate * 400 * 0.01)
    assert bench.core.state.throttle == end
    expected = (SAFETY.throttle_limit - SAFETY.throttle_start) / SAFETY.throttle_rate
    assert 0.01 * pulses.index(abs(end - 1500)) == pytest.approx(expected, abs=0.05)
    other_way = reached(3000 - asked)
    assert other_way <= SAFETY.throttle_start * 400 + 1, "the other way begins anew"
    assert reached(1500) == 0, "back at once"


class BusBench(Bench):
    """A drive on its own adapter with the Teensy on the same bus."""

    def __init__(self):
        super().__init__("watched_can")
        self.counter = 0

    def beat(self, state, seconds, strings=True, throttle=1520, attitude=LEVEL):
        for _ in range(round(seconds / 0.01)):
            self.counter += 1
            self.core.receive(make_heartbeat(state, self.counter))
            if strings:
                armed = state is HeartbeatState.ARMED
                pulse = throttle if armed else 1500
                self.write(MotorRequest.EXIT, throttle=pulse, attitude=attitude)
            self.wait(0.01)

    def answers(self, since):
        return [
            decode_answer(frame)
            for when, frame in self.sent
            if when >= since and frame.arbitration_id == 0x7A1
        ]


def driving_on_the_bus():
    bench = BusBench()
    bench.beat(HeartbeatState.OFF, 0.05)
    bench.beat(HeartbeatState.ARMED, 0.5)
    return bench


def test_on_the_bus_it_answers_every_beat_and_sends_nothing_else_while_all_is_well():
    bench = driving_on_the_bus()
    begin = bench.now
    bench.beat(HeartbeatState.ARMED, 0.2)
    assert bench.answers(begin) == [
        (TeensyStatus.RUNNING, (bench.counter - 19 + i) % 256) for i in range(20)
    ]
    assert {frame.arbitration_id for when, frame in bench.sent if when >= begin} == {0x7A1}


def test_on_the_bus_a_car_on_its_side_is_stopped_at_neutral_throttle_too():
    """Its tail is held for 2 s after a fault, at neutral throttle: the motors are on."""
    bench = driving_on_the_bus()
    begin = bench.now
    bench.beat(HeartbeatState.ARMED, 0.5, throttle=1500, attitude=OVER)
    assert bench.exits(1, since=begin)[0] - begin == pytest.approx(TIMING.attitude_time, abs=0.021)
    assert bench.core.state.status == TeensyStatus.ATTITUDE


@pytest.mark.parametrize("strings", [True, False])
def test_a_heartbeat_that_stops_while_armed_switches_the_motors_off(strings):
    bench = driving_on_the_bus()
    last = bench.now - 0.01
    for _ in range(30):
        if strings:
            bench.write(MotorRequest.EXIT, throttle=1520)
        bench.wait(0.01)
    first = bench.exits(1, since=last)[0]
    assert first - last == pytest.approx(TIMING.watchdog_timeout, abs=0.012)
    assert len(bench.exits(2, since=last)) >= TIMING.exit_burst + TIMING.exit_cycles
    assert bench.core.state.throttle == 1500
    if strings:
        assert bench.core.state.status == TeensyStatus.HEARTBEAT_STOPPED


@pytest.mark.parametrize("length", [1, 40])
def test_beats_that_repeat_themselves_are_no_life(length):
    bench = driving_on_the_bus()
    begin = bench.now
    for index in range(30):
        counter = bench.counter + 1 - length + index % length
        bench.core.receive(make_heartbeat(HeartbeatState.ARMED, counter))
        bench.write(MotorRequest.EXIT, throttle=1520)
        bench.wait(0.01)
    assert bench.exits(1, since=begin)


def test_an_orderly_end_of_the_heartbeat_sends_nothing():
    bench = driving_on_the_bus()
    bench.beat(HeartbeatState.OFF, 0.1)
    begin = bench.now
    for _ in range(50):
        bench.write(MotorRequest.EXIT)
        bench.wait(0.01)
    assert not bench.exits(1, since=begin)


def test_a_computer_that_asks_for_help_gets_it_at_once():
    bench = driving_on_the_bus()
    begin = bench.now
    bench.core.receive(make_heartbeat(HeartbeatState.TRIP, bench.counter + 1))
    bench.wait(MS)
    assert len(bench.exits(2, since=begin)) == TIMING.exit_burst


def test_it_is_not_released_before_its_exit_frames_are_out_nor_while_the_beats_say_armed():
    bench = driving_on_the_bus()
    bench.wait(TIMING.watchdog_timeout + 0.01)
    bench.write(MotorRequest.EXIT)
    assert bench.core.state.status != TeensyStatus.RUNNING
    bench.beat(HeartbeatState.ARMED, 0.3)
    assert bench.core.state.status != TeensyStatus.RUNNING
    bench.beat(HeartbeatState.OFF, 0.3)
    assert bench.core.state.status == TeensyStatus.RUNNING


@pytest.mark.parametrize(
    "frame",
    [
        replace(HEARTBEAT, arbitration_id=0x7A2),
        replace(HEARTBEAT, data=HEARTBEAT.data + b"\0"),
        replace(HEARTBEAT, data=b"\xad\x01\x07\x00"),
        replace(HEARTBEAT, extended=True),
        make_exit(1),
    ],
)
def test_other_frames_are_no_heartbeat(frame):
    bench = BusBench()
    begin = bench.now
    bench.core.receive(frame)
    bench.wait(MS)
    assert bench.answers(begin) == []


def test_torque_and_range_are_limited_as_on_the_computer():
    motor = joint()
    limits = motor_limits(motor)
    random = np.random.default_rng(7)
    for _ in range(400):
        command = MitCommand(
            *(
                random.uniform(low, high)
                for low, high in ((-6, 6), (-50, 50), (0, 500), (0, 5), (-25, 25))
            )
        )
        position = random.uniform(-1.85, 1.85)
        speed = random.uniform(-30, 30)
        load = MotorLoad(motor.safety.rated_torque, motor.safety.overload)
        replies = []
        for k in range(int(random.integers(1, 30))):
            torque = float(random.uniform(-25, 25))
            when = 0.1 * k
            load.add(torque, when)
            replies.append((position, speed, torque, when))
        ours = limit_on_the_computer(
            command, position, speed, motor, load.allowed(motor.torque_limit)
        )
        theirs = limit_command(command, replies, limits)
        for name in ("position", "velocity", "kp", "kd", "torque"):
            assert getattr(theirs, name) == pytest.approx(
                getattr(ours, name), rel=1e-9, abs=1e-9
            ), (name, command)


@pytest.mark.parametrize("position", [-1.9, 1.9, 6.0])
def test_a_motor_far_beyond_its_range_gets_no_torque(position):
    """Its zero is wrong: the way back into the range is not known."""
    limits = motor_limits(joint())
    limited = limit_command(
        MitCommand(0.0, 1.0, 500.0, 5.0, 20.0), [(position, 0.0, 0.0, 0.0)], limits
    )
    assert (limited.velocity, limited.kp, limited.kd, limited.torque) == (0.0, 0.0, 0.0, 0.0)


def test_a_motor_that_has_not_answered_gets_no_torque():
    limited = limit_command(MitCommand(9.0, 1.0, 500.0, 5.0, 20.0), [], motor_limits(joint()))
    assert (limited.velocity, limited.kp, limited.kd, limited.torque) == (0.0, 0.0, 0.0, 0.0)
