"""What a frame costs: encoding and decoding against `struct` with the same checks, and against
cantools.
"""

import math
import struct
import time
from collections.abc import Callable, Iterator

import cantools
from cantools.database.can import Database

from aerodima.hardware.protocol import ak70, radio, teensy
from aerodima.hardware.protocol.ak70 import AK70_10_V1_0_8 as PROFILE
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.workbench.core.resources import model_path
from tests.benchmarks.rows import BenchRow

_CALLS = 20_000
_REPEATS = 7
_COMMAND = ak70.MitCommand(-1.5, 8.0, 17.0, 5.0, 0.25)
_REPLY = CanFrame(0, bytes.fromhex("0170A39478051E00"))
_TEENSY_REPLY = b"1;-1.50000;8.0000;0.2500;2;0.00000;0.0000;0.0000;90.000;7;31;0;7;31;0;1000;0;*A9|"


def _cost(call: Callable[[], object]) -> float:
    """us per call: best of several runs."""
    best = math.inf
    for _ in range(_REPEATS):
        start = time.process_time()
        for _ in range(_CALLS):
            call()
        best = min(best, time.process_time() - start)
    return best / _CALLS * 1e6


def _struct_encode() -> bytes:
    """The least that `struct` needs: five values scaled, rounded, packed; no checks."""
    position = int((_COMMAND.position + 12.5) * 2621.4 + 0.5)
    velocity = int((_COMMAND.velocity + 50.0) * 40.95 + 0.5)
    kp = int(_COMMAND.kp * 8.19 + 0.5)
    kd = int(_COMMAND.kd * 819.0 + 0.5)
    torque = int((_COMMAND.torque + 25.0) * 81.9 + 0.5)
    return struct.pack(">Q", position << 48 | velocity << 36 | kp << 24 | kd << 12 | torque)


def _struct_decode() -> tuple[float, ...]:
    motor_id, position, high, middle, low, temperature, fault = struct.unpack(
        ">BHBBBBB", _REPLY.data
    )
    velocity = high << 4 | middle >> 4
    torque = (middle & 15) << 8 | low
    return (
        motor_id,
        position / 2621.4 - 12.5,
        velocity / 40.95 - 50.0,
        torque / 81.9 - 25.0,
        temperature,
        fault,
    )


def bench_motor_frames() -> Iterator[BenchRow]:
    """A command and a reply of a tail motor; the goal is against cantools, which serves any DBC."""
    database = cantools.database.load_file(model_path("ak70_10.dbc"))
    assert isinstance(database, Database)
    command = database.get_message_by_name("motor_1_command")
    reply = database.get_message_by_name("motor_reply")
    values = {
        name: getattr(_COMMAND, name) for name in ("position", "velocity", "kp", "kd", "torque")
    }
    encode = _cost(lambda: ak70.make_command(1, _COMMAND, PROFILE))
    decode = _cost(lambda: ak70.decode_reply(_REPLY, PROFILE))
    yield BenchRow(
        "mit_command_encode_vs_cantools",
        encode,
        "us",
        "<= 1",
        _cost(lambda: command.encode(values)),
    )
    yield BenchRow(
        "mit_reply_decode_vs_cantools",
        decode,
        "us",
        "<= 1",
        _cost(lambda: reply.decode(_REPLY.data)),
    )
    yield BenchRow("mit_command_encode_vs_struct", encode, "us", "", _cost(_struct_encode))
    yield BenchRow("mit_reply_decode_vs_struct", decode, "us", "", _cost(_struct_decode))


def bench_strings_and_radio() -> Iterator[BenchRow]:
    """A command and a reply of the Teensy and a radio frame; one of each per 10 ms cycle."""
    orders = (
        teensy.MotorOrder(1, teensy.MotorRequest.COMMAND, _COMMAND),
        teensy.MotorOrder(2, teensy.MotorRequest.EXIT, ak70.NEUTRAL),
    )
    command = teensy.TeensyCommand(orders, 1500, 1600)
    frame = radio.make_command(radio.OperatorCommand(radio.RadioMode.MANUAL, 0.5, -0.25, 1.0, -1.5))
    encode = _cost(lambda: teensy.make_command(command))
    decode = _cost(lambda: teensy.decode_reply(_TEENSY_REPLY))
    yield BenchRow("teensy_command_encode", encode, "us", "<= 100")
    yield BenchRow("teensy_reply_decode", decode, "us", "<= 100")
    yield BenchRow(
        "radio_decode_vs_struct",
        _cost(lambda: radio.decode(frame)),
        "us",
        "",
        _cost(lambda: struct.unpack("<BBffff", frame)),
    )
