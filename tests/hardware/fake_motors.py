"""Tail motors that answer frames as an AK70-10 does, on a port without threads, in simulated
time.
"""

import dataclasses
import math
import time
from collections import deque

from aerodima.hardware.devices.device_states import MotorState
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.motor_settings import motor_settings
from aerodima.hardware.protocol.ak70 import (
    AK70_10_V1_0_8,
    NEUTRAL,
    MitCommand,
    MitReply,
    decode_command,
    is_special,
    make_reply,
)
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario_file import load_parameter_file
from aerodima.workbench.scenario.tail_parameters import TailMotorParameters

PERIOD = 0.01
PROFILE = AK70_10_V1_0_8
_INERTIA, _DAMPING = 0.05, 0.1
_SUBSTEPS = 10


def tail_motor_parameters():
    """`models/parameters/tail_motor.yaml`, read without Drake."""
    entries = load_parameter_file(model_path("parameters/tail_motor.yaml"), TailMotorParameters)
    return TailMotorParameters.model_validate({key: entry.value for key, entry in entries.items()})


def settings(
    name="tail roll", motor_id=2, low=-math.pi / 2, high=math.pi / 2, safety=None, **changes
):
    """Settings of a joint with the limits of the parameter files."""
    gains = changes.pop("hold_gains", (17.0, 5.0))
    profile = changes.pop("profile", PROFILE)
    made = motor_settings(
        name,
        motor_id,
        profile,
        tail_motor_parameters(),
        (low, high),
        gains,
        **changes,
    )
    return dataclasses.replace(made, safety=made.safety.model_copy(update=safety or {}))


class FakeMotor:
    """An inertia behind the loop of the motor. Everything is in the motor's own angle.

    Attributes:
        blocked: held by an outer force where `position` says.
        sign: -1 for one that turns against its torque.
        respond: called with the reply frame, returns the frames that go on the bus.
    """

    def __init__(self, motor_id, position=0.0):
        self.motor_id = motor_id
        self.position = position
        self.speed = 0.0
        self.torque = 0.0
        self.entered = self.blocked = False
        self.command = NEUTRAL
        self.temperature = 30.0
        self.fault = 0
        self.long_reply = True
        self.reading_offset = 0.0
        self.sign = 1.0
        self.respond = lambda frame: [frame]
        self.torques = []

    def receive(self, frame):
        if frame.data[:7] == b"\xff" * 7:
            self.entered = {0xFC: True, 0xFD: False}.get(frame.data[7], self.entered)
        else:
            self.command = decode_command(frame.data, PROFILE)
        return self.respond(self.reply())

    def reply(self):
        reading = math.remainder(self.position + self.reading_offset, 25.0)
        temperature, fault = (self.temperature, self.fault) if self.long_reply else (None, None)
        return make_reply(
            MitReply(self.motor_id, reading, self.speed, self.torque, temperature, fault), PROFILE
        )

    def advance(self, time):
        step = time / _SUBSTEPS
        for _ in range(_SUBSTEPS):
            command = self.command if self.entered else NEUTRAL
            torque = command.kp * (command.position - self.position) + command.kd * (
                command.velocity - self.speed
            )
            self.torque = max(-24.8, min(24.8, torque + command.torque)) if self.entered else 0.0
            self.torques.append(self.torque)
            if not self.blocked:
                self.speed += step * (self.sign * self.torque - _DAMPING * self.speed) / _INERTIA
                self.position += step * self.speed


class FakePort:
    """A bus that keeps every frame with its time: simulated, or real while nobody turns `now`."""

    def __init__(self, motors):
        self.motors = motors
        self.now = 0.0
        self._turned = time.monotonic()
        self.fault = 0
        self.fault_text = ""
        self.sent = []
        self.inbox = deque()
        self.send_error = None
        self.flushed = False

    def send(self, frame, urgent=False):
        if self.send_error is not None:
            raise self.send_error
        if self.now == 0.0:
            before = self._turned
            self._turned = time.monotonic()
            for motor in self.motors:
                motor.advance(min(self._turned - before, PERIOD))
        self.sent.append((self.now, frame))
        for motor in self.motors:
            if motor.motor_id == frame.arbitration_id:
                self.inbox.extend((self.now, reply) for reply in motor.receive(frame))
        return True

    def poll(self):
        frames = list(self.inbox)
        self.inbox.clear()
        return frames

    def flush(self, timeout=0.2):
        self.flushed = True
        return True

    def exits(self, motor_id, since=-math.inf):
        """Times of the exit frames to a motor."""
        return [
            when
            for when, frame in self.sent
            if frame.arbitration_id == motor_id
            and frame.data == b"\xff" * 7 + b"\xfd"
            and when >= since
        ]


class Bench:
    """Group, motors and port, and the loop that turns them at 100 Hz of simulated time."""

    def __init__(self, *all_settings, positions=None):
        all_settings = all_settings or (settings("tail pitch", 1), settings("tail roll", 2))
        positions = positions or [item.zero for item in all_settings]
        self.fakes = [
            FakeMotor(item.motor_id, where)
            for item, where in zip(all_settings, positions, strict=True)
        ]
        self.port = FakePort(self.fakes)
        self.group = MotorGroup(all_settings, self.port)
        self.motors = self.group.motors
        self.now = 0.0

    def cycle(self, *commands, count=1, period=PERIOD):
        """Turns the loop; `commands` one per motor, or one for all."""
        for _ in range(count):
            self.now += period
            self.port.now = self.now
            for fake in self.fakes:
                fake.advance(period)
            self.group.step(self.now)
            for motor, command in zip(
                self.motors, commands * (len(self.motors) // max(1, len(commands))), strict=False
            ):
                motor.set_command(command, self.now)

    def to_holding(self):
        self.group.set_enter(self.now)
        while any(motor.state is MotorState.ENTERING for motor in self.motors):
            self.cycle()
        assert [motor.state for motor in self.motors] == [MotorState.HOLDING] * len(self.motors)
        return self

    def to_running(self, *commands):
        self.to_holding()
        self.cycle(*(commands or (hold(0.0),)), count=60)
        assert [motor.state for motor in self.motors] == [MotorState.RUNNING] * len(self.motors)
        return self

    def commands(self, motor_id, since=-math.inf):
        """(time, command) of the command frames to a motor."""
        return [
            (when, decode_command(frame.data, PROFILE))
            for when, frame in self.port.sent
            if frame.arbitration_id == motor_id and when >= since and not is_special(frame.data)
        ]


def hold(position, kp=17.0, kd=5.0):
    return MitCommand(position, 0.0, kp, kd, 0.0)
