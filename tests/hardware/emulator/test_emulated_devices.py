"""Motors, slcan adapter, Teensy and radio of the emulator, without processes and in simulated
time.
"""

import math

import numpy as np
import pytest

from aerodima.hardware.car.car_ports import read_events
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.devices.bno055 import (
    Mode,
    Register,
    decode_sample,
    make_read,
    make_sample_request,
    make_write,
)
from aerodima.hardware.emulator.emulated_bus import (
    DRIFT_RATE,
    ENCODER_JUMP,
    HOT,
    EmulatedBus,
    EmulatedMotor,
    SlcanAdapter,
    read_frame,
    write_frame,
)
from aerodima.hardware.emulator.emulated_devices import EmulatedImu
from aerodima.hardware.emulator.fault_script import (
    EventLog,
    FaultBoard,
    Script,
)
from aerodima.hardware.protocol.ak70 import AK70_10_V1_0_8 as PROFILE
from aerodima.hardware.protocol.ak70 import (
    NEUTRAL,
    MitCommand,
    decode_reply,
    make_command,
    make_enter,
    make_exit,
    make_neutral,
)
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.workbench.core.quantity import STANDARD_GRAVITY
from tests.refusals import assert_refused

PUSH = MitCommand(0.4, 0.0, 17.0, 5.0, 1.0)


class NoLog:
    """Keeps the messages that a traffic log would write."""

    def __init__(self):
        self.messages = []

    def add(self, message):
        self.messages.append(message)


class Bench:
    """Two motors on a bus, and a clock that the script follows."""

    def __init__(self, folder, *faults, zero=0.0, direction=1):
        self.path = folder / "events.jsonl"
        self.events = EventLog(self.path)
        self.board = FaultBoard(
            Script.model_validate({"clock": "start", "faults": faults}), self.events
        )
        self.board.begin("start", 0.0)
        self.board.update(0.0)
        common = (self.board, self.events, zero, direction)
        self.motors = [
            EmulatedMotor("tail_pitch", 1, *common),
            EmulatedMotor("tail_roll", 2, *common),
        ]
        self.log = NoLog()
        self.bus = EmulatedBus(self.motors, self.board, self.log)

    def ask(self, frame):
        (answer,) = self.bus.carry(frame)
        return decode_reply(answer, PROFILE)

    def names(self):
        return [event["event"] for event in read_events(self.path)]


def roll(**fault):
    return {"time": 0.0, "part": "tail_roll", **fault}


def test_a_motor_makes_torque_between_enter_and_exit_only(tmp_path):
    bench = Bench(tmp_path)
    motor = bench.motors[1]
    bench.ask(make_command(2, PUSH, PROFILE))
    assert motor.joint_command == NEUTRAL
    bench.ask(make_enter(2))
    bench.board.update(1e6)
    assert motor.joint_command.position == pytest.approx(0.4, abs=4e-4), "jumps to the last one"
    bench.ask(make_exit(2))
    assert motor.joint_command == NEUTRAL
    assert bench.names() == ["script_begins", "entered", "off"]


def test_angles_and_signs_of_the_motor_are_those_of_its_mounting(tmp_path):
    bench = Bench(tmp_path, zero=1.0, direction=-1)
    bench.motors[1].set_joint(0.3, 2.0, 5.0)
    reply = bench.ask(make_neutral(2, PROFILE))
    assert (reply.position, reply.velocity, reply.torque) == pytest.approx(
        (0.7, -2.0, -5.0), abs=0.02
    )
    bench.ask(make_enter(2))
    bench.ask(make_command(2, PUSH, PROFILE))
    command = bench.motors[1].joint_command
    assert (command.position, command.torque) == pytest.approx((0.6, -1.0), abs=0.01)


def test_the_zero_frame_zeroes_silently(tmp_path):
    bench = Bench(tmp_path)
    bench.motors[0].set_joint(0.5, 0.0, 0.0)
    assert bench.ask(CanFrame(1, bytes.fromhex("FFFFFFFFFFFFFFFE"))).position == pytest.approx(
        0.0, abs=4e-4
    )


def test_positions_wrap_at_the_range_of_the_profile(tmp_path):
    bench = Bench(tmp_path)
    bench.motors[0].set_joint(13.0, 0.0, 0.0)
    assert bench.ask(make_neutral(1, PROFILE)).position == pytest.approx(-12.0, abs=4e-4)


@pytest.mark.parametrize(
    "fault", ["v3_frame", "foreign_id", "reply_corrupted", "reply_short", "reply_long"]
)
def test_frames_that_are_no_reply_are_refused_by_the_decoder(tmp_path, fault):
    bench = Bench(tmp_path, roll(fault=fault))
    (answer,) = bench.bus.carry(make_neutral(2, PROFILE))
    if fault == "foreign_id":
        assert answer.arbitration_id not in (0, 1, 2)
    assert_refused(lambda: decode_reply(answer, PROFILE), FrameError)
    assert bench.ask(make_neutral(1, PROFILE)).motor_id == 1, "the other motor is well"


def test_lost_and_doubled_replies(tmp_path):
    bench = Bench(
        tmp_path,
        roll(fault="reply_lost", count=1),
        {**roll(fault="double_id"), "part": "tail_pitch"},
    )
    assert bench.bus.carry(make_neutral(2, PROFILE)) == []
    assert len(bench.bus.carry(make_neutral(2, PROFILE))) == 1
    assert len(bench.bus.carry(make_neutral(1, PROFILE))) == 2


def test_replies_that_report_something_wrong(tmp_path):
    bench = Bench(
        tmp_path,
        roll(fault="over_temperature"),
        roll(fault="motor_fault", code=3),
        roll(fault="encoder_jump"),
        {**roll(fault="out_of_range"), "part": "tail_pitch"},
    )
    bench.motors[1].entered = True
    reply = bench.ask(make_neutral(2, PROFILE))
    assert (reply.temperature, reply.fault) == (HOT, 3)
    assert reply.position == pytest.approx(ENCODER_JUMP, abs=4e-4)
    assert not bench.motors[1].entered, "a motor with a fault of its own makes no torque"
    bench.board.update(0.5)
    assert bench.ask(make_neutral(1, PROFILE)).position == pytest.approx(0.5 * DRIFT_RATE, abs=4e-4)


def test_an_attitude_that_is_stuck_leaves_gravity_in_the_acceleration(tmp_path):
    bench = Bench(tmp_path, {"time": 1.0, "fault": "attitude_stuck"})
    imu = EmulatedImu(load_mounting(), bench.board)
    imu.set_reading(np.zeros(9))
    bench.board.update(1.0)
    imu.set_reading(np.array([math.pi / 2, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0]))
    imu.feed(make_write(Register.MODE, bytes([Mode.IMU])) + make_sample_request(), 1.0)
    reading = load_mounting().imu_reading(decode_sample(imu.poll(1.0)[4:]))
    expected = [0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0, STANDARD_GRAVITY, -STANDARD_GRAVITY]
    np.testing.assert_allclose(reading, expected, atol=0.01)


def test_answers_of_the_imu_come_in_order_after_a_late_one(tmp_path):
    bench = Bench(tmp_path, {"time": 0.0, "fault": "answer_late", "delay": 0.06, "count": 1})
    imu = EmulatedImu(load_mounting(), bench.board)
    for now in (1.0, 1.01):
        imu.feed(make_read(Register.CHIP_ID, 1), now)
    assert [len(imu.poll(now)) for now in (1.05, 1.06)] == [0, 6]


def test_every_frame_is_in_the_traffic_log(tmp_path):
    bench = Bench(tmp_path)
    bench.bus.carry(make_exit(1))
    assert [(message.is_rx, bytes(message.data[:1])) for message in bench.log.messages] == [
        (False, b"\xff"),
        (True, b"\x01"),
    ]


def test_the_adapter_passes_frames_while_its_channel_is_open(tmp_path):
    bench = Bench(tmp_path)
    adapter = SlcanAdapter(bench.bus, bench.board)
    line = write_frame(make_enter(1))
    assert adapter.feed(line) == b"\a"
    assert adapter.feed(b"C\rS8\rO\r") == b"\r\r\r"
    answer = adapter.feed(line[:7]) + adapter.feed(line[7:])
    assert decode_reply(read_frame(answer[:-1]), PROFILE).motor_id == 1
    assert bench.motors[0].entered
    assert adapter.feed(b"O\rX\rt001\rt0019" + b"00" * 9 + b"\r") == b"\a\a\a\a"


def test_bus_off_ends_when_the_channel_is_opened_anew(tmp_path):
    bench = Bench(tmp_path, {"time": 1.0, "fault": "bus_off"})
    adapter = SlcanAdapter(bench.bus, bench.board)
    adapter.feed(b"O\r")
    bench.board.update(1.0)
    assert adapter.feed(write_frame(make_exit(1))) == b"\a"
    assert adapter.feed(b"C\rO\r" + write_frame(make_exit(1)))[2:4] == b"t0"
    assert len(bench.log.messages) == 2


@pytest.mark.parametrize(
    "line", [b"", b"t", b"t001", b"t0011", b"tXYZ100", b"t001100FF", b"T0000010", b"t0011\xff\xff"]
)
def test_lines_that_are_no_frame(line):
    assert read_frame(line) is None


def test_lines_carry_standard_and_extended_frames():
    for frame in (CanFrame(0x7F, b"\x01\x02"), CanFrame(0x2901, b"", extended=True)):
        assert read_frame(write_frame(frame)[:-1]) == frame
