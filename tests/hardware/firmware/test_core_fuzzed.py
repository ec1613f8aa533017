"""Anything at all on the core's three inputs: it never crashes, never leaves its ranges, and falls
silent in time.
"""

import random

import pytest

from aerodima.hardware.car.safety_settings import load_teensy_timing
from aerodima.hardware.car.wiring import WIRINGS
from aerodima.hardware.firmware.teensy_core import TeensyCore
from aerodima.hardware.firmware.teensy_firmware import FirmwareSettings
from aerodima.hardware.protocol.ak70 import AK70_10_V1_0_8 as PROFILE
from aerodima.hardware.protocol.ak70 import MAX_ID, NEUTRAL, MitCommand
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.protocol.teensy import (
    SERVO_PULSES,
    THROTTLE_PULSES,
    Attitude,
    MotorOrder,
    MotorRequest,
    TeensyCommand,
    TeensyStatus,
    make_command,
)

STEPS = 10_000
TIMING = load_teensy_timing()
ZERO = bytes([0xFF] * 7 + [0xFE])
"""The frame that makes the present angle of a motor its zero."""
LEVEL = Attitude(0.0, 0.0, 8)
CHARACTERS = b"0123456789;|-+. *\r\n\0\xff" + bytes(range(32, 64))


class Chaos:
    """Draws what comes in next."""

    def __init__(self, seed):
        self.draw = random.Random(seed)

    def command(self):
        draw = self.draw
        if draw.random() < 0.2:  # what its watchdog lets go at
            orders = tuple(MotorOrder(motor_id, MotorRequest.EXIT, NEUTRAL) for motor_id in (1, 2))
            return make_command(TeensyCommand(orders, SERVO_PULSES[1], THROTTLE_PULSES[1], LEVEL))
        values = (
            draw.uniform(-13, 13),
            draw.uniform(-50, 50),
            draw.uniform(0, 500),
            draw.uniform(0, 5),
        )
        orders = tuple(
            MotorOrder(
                motor_id,
                draw.choice(list(MotorRequest)),
                MitCommand(*values, draw.uniform(-26, 26)),
            )
            for motor_id in draw.choices([(1, 2), (2, 1), (7, 63)], (20, 1, 1))[0]
        )
        pulses = (
            draw.randint(SERVO_PULSES[0], SERVO_PULSES[2]),
            draw.randint(THROTTLE_PULSES[0], THROTTLE_PULSES[2]),
        )
        angles = draw.uniform(-3.1, 3.1), draw.uniform(-1.5, 1.5)
        witnesses = draw.uniform(0.0, 3.1), draw.uniform(-0.5, 0.5)
        tilted = Attitude(*angles, draw.randint(0, 1000), *witnesses)
        attitude = draw.choices([LEVEL, tilted, None], (40, 1, 1))[0]
        return make_command(TeensyCommand(orders, *pulses, attitude))

    def damaged(self):
        text = bytearray(self.command())
        draw = self.draw
        for _ in range(draw.randint(1, 4)):
            place = draw.randrange(len(text))
            text[place : place + draw.randint(0, 3)] = bytes(
                draw.choices(CHARACTERS, k=draw.randint(0, 3))
            )
        return bytes(text)

    def noise(self):
        draw = self.draw
        if draw.random() < 0.1:  # longer than any buffer
            return bytes(draw.choices(b"0;", k=draw.randint(100, 3000))) + b"|" * draw.randint(0, 9)
        return bytes(draw.choices(CHARACTERS, k=draw.randint(0, 60)))

    def frame(self):
        draw = self.draw
        ids = draw.choice([0, 1, 2, 3, 63, draw.randint(0, 0x7FF), draw.randint(0x780, 0x7FF)])
        data = draw.randbytes(draw.choice([0, 1, 4, 6, 6, 7, 8, 8, 8]))
        if data and draw.random() < 0.7:
            data = bytes([draw.choice([1, 2])]) + data[1:]
        return CanFrame(ids, data, draw.random() < 0.1)


@pytest.mark.parametrize("wiring", WIRINGS)
def test_anything_at_all_leaves_it_within_its_ranges(wiring):
    chaos = Chaos(f"{wiring} checked")
    draw, now = chaos.draw, 2**32 / 1000 - 20.0  # its clock runs over on the way
    core = TeensyCore(FirmwareSettings(wiring, PROFILE), now)
    valid = now
    obeyed = acted = 0
    for step in range(STEPS):
        what = draw.random()
        if what < 0.7 and step % 300 >= 200:  # a computer of which only noise is left
            core.feed(chaos.noise().replace(b"|", b""), now)
        elif what < 0.7:
            core.feed(
                chaos.command()
                if what < 0.45
                else chaos.damaged()
                if what < 0.6
                else chaos.noise(),
                now,
            )
            valid = now
        elif what < 0.9:
            core.receive(chaos.frame())
        else:
            core.set_sail_word(draw.getrandbits(32))
        now += (
            draw.choice([0.0, 0.001, 0.002, 0.01])
            if draw.random() < 0.99
            else draw.uniform(0.0, 0.4)
        )
        core.step(now)
        if draw.random() < 0.8:  # sometimes the bus takes nothing, and the queue runs over
            for frame in core.frames():
                assert frame.data != ZERO
                assert 0 < frame.arbitration_id <= (MAX_ID if wiring != "watched_can" else 0x7FF)
        if draw.random() < 0.8:
            reply = core.reply()
            assert not reply or reply.endswith(b"|")
        state = core.state
        assert SERVO_PULSES[0] <= state.servo <= SERVO_PULSES[2]
        assert THROTTLE_PULSES[0] <= state.throttle <= THROTTLE_PULSES[2]
        obeyed += state.servo != SERVO_PULSES[1]
        if now - valid > TIMING.watchdog_timeout + 0.002:
            acted += 1
            assert (state.servo, state.throttle) == (SERVO_PULSES[1], THROTTLE_PULSES[1])
            assert state.status is not TeensyStatus.RUNNING
    assert obeyed > STEPS / 50  # it was awake to be disturbed
    assert acted > STEPS / 50
