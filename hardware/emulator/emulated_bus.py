"""The CAN bus of the emulated car: the motors on it, the carrier of their frames, the slcan adapter
at its end, and the pseudo-terminals of the ports.

Every frame and every answer is in the traffic log. The adapter speaks as CANable and Lawicel
adapters do.
"""

from __future__ import annotations

import math
import os
import pty
import time
import tty
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from aerodima.hardware.car.car_ports import Joint
from aerodima.hardware.devices.motor_limits import clip, commanded_torque
from aerodima.hardware.emulator.fault_script import EventLog, Fault, FaultBoard, FaultEntry
from aerodima.hardware.protocol.ak70 import (
    AK70_10_V1_0_8,
    ENTER,
    EXIT,
    NEUTRAL,
    ZERO,
    MitCommand,
    MitReply,
    decode_command,
    is_special,
    make_reply,
)
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.hardware.transport.can_adapter import TrafficLog, can
from aerodima.workbench.core.errors import HardwareError

Frames = list[CanFrame]
Receiver = Callable[[CanFrame], None]
"""Function that receives a frame of another node."""
_PROFILE = AK70_10_V1_0_8
WARM = 30.0
"""Temperature of a healthy motor, degrees Celsius."""
HOT = 95.0
"""Temperature beyond the limit of `motor_safety.yaml`, degrees Celsius."""
_PAST = 1000
"""Number of steps of the car that a motor remembers."""
ENCODER_JUMP = 1.0
"""Jump of the fault `encoder_jump`, rad: ten times the margin of `motor_safety.yaml`."""
DRIFT_RATE = 3.0
"""Drift of the fault `out_of_range`, rad/s: it leaves the range in a second, slower than a jump."""
_OK = b"\r"
_ERROR = b"\a"
_MAX_LINE = 64
"""Number of bytes kept of a line that has not ended."""
_MAX_RECEIVED = 4096
"""Number of bytes waiting for the computer from which frames of other nodes are dropped."""
_MAX_BYTES = 4096
"""Largest number of bytes in one read."""


class EmulatedBus:
    """Bus whose owner gives it frames and gets the answers; a second node may receive all frames
    and send too.

    Bus-off is a state of the owner's controller: nothing goes out and nothing comes in until its
    channel is opened anew or the fault ends.

    Attributes:
        watch: function of the second node that receives every frame of the owner and of the motors.
        to_owner: function that receives what the second node sends and what the motors answer to
            it.
    """

    def __init__(self, motors: Sequence[EmulatedMotor], board: FaultBoard, log: TrafficLog) -> None:
        self._motors = {motor.motor_id: motor for motor in motors}
        self._board = board
        self._log = log
        self._healed = False
        self.watch: Receiver = lambda _: None
        self.to_owner: Receiver = lambda _: None

    @property
    def off(self) -> bool:
        """Returns whether the owner's controller is off the bus."""
        return self._board.entry("bus_off") is not None and not self._healed

    def reopened(self) -> None:
        """Notes that the owner has opened its channel anew."""
        self._healed = self._board.entry("bus_off") is not None

    def carry(self, frame: CanFrame) -> Frames:
        """Takes a frame of the owner; returns the motors' answers."""
        if self.off:
            return []
        answers = self._pass_on(frame)
        for received in (frame, *answers):
            self.watch(received)
        return answers

    def carry_from_watch(self, frame: CanFrame) -> None:
        """Takes a frame of the second node."""
        for received in (frame, *self._pass_on(frame)):
            if not self.off:
                self.to_owner(received)

    def _pass_on(self, frame: CanFrame) -> Frames:
        self._note(frame, received=False)
        motor = None if frame.extended else self._motors.get(frame.arbitration_id)
        answers = motor.receive(frame.data) if motor is not None and len(frame.data) == 8 else []
        for answer in answers:
            self._note(answer, received=True)
        return answers

    def _note(self, frame: CanFrame, received: bool) -> None:
        self._log.add(
            can.Message(
                timestamp=time.time(),
                arbitration_id=frame.arbitration_id,
                data=frame.data,
                is_extended_id=frame.extended,
                is_rx=received,
            )
        )


class EmulatedMotor:
    """Motor that obeys and answers like the real one, which has no watchdog: it holds its last
    command for ever.

    It also remembers that command when it is switched off, and jumps to it when it is entered
    again.

    Args:
        joint: joint that the motor drives.
        motor_id: id of the motor on the bus.
        zero: motor angle at joint angle 0, rad.
        direction: sign of the motor's angle relative to the joint's.

    Attributes:
        entered: whether the motor makes torque.
    """

    def __init__(
        self,
        joint: Joint,
        motor_id: int,
        board: FaultBoard,
        events: EventLog,
        zero: float = 0.0,
        direction: int = 1,
    ) -> None:
        self.joint = joint
        self.motor_id = motor_id
        self._board = board
        self._events = events
        self._zero = zero
        self._direction = direction
        self._command = NEUTRAL
        self._angle = 0.0
        self._speed = 0.0
        self._torque = 0.0
        self._blocked_at = 0.0
        self._past: deque[tuple[float, float, float, float]] = deque(maxlen=_PAST)
        self._reported = (0.0, 0.0, 0.0)
        self.entered = False

    @property
    def joint_command(self) -> MitCommand:
        """Present command to its joint, in the joint's angle and signs."""
        if not self.entered:
            return NEUTRAL
        command = self._command
        sign = self._direction
        if self._fault("motor_reversed"):
            torque = commanded_torque(command, self._angle, self._speed)
            return MitCommand(0.0, 0.0, 0.0, 0.0, -sign * torque)
        return MitCommand(
            sign * (command.position - self._zero),
            sign * command.velocity,
            command.kp,
            command.kd,
            sign * command.torque,
        )

    def set_joint(self, angle: float, speed: float, torque: float) -> None:
        """Sets angle (rad), speed (rad/s) and torque (N m) of the joint."""
        self._angle = self._zero + self._direction * angle
        self._speed = self._direction * speed
        self._torque = self._direction * torque
        # The motor measures its own current, the wrong way round.
        if self._fault("motor_reversed"):
            self._torque = -self._torque
        self._past.append((time.monotonic(), self._angle, self._speed, self._torque))

    def receive(self, data: bytes) -> Frames:
        """Obeys 8 bytes that came under its id; returns its answers as faults leave them."""
        if is_special(data):
            self._obey_special(data[7])
        else:
            try:
                self._command = decode_command(data, _PROFILE)
            except FrameError:
                return []  # a real one has no way to complain
        if self._fault("motor_fault"):
            self._set_entered(False, "its own fault")
        if self._fault("motor_off"):
            self._set_entered(False, "by itself")
        return self._answers()

    def _fault(self, fault: Fault) -> FaultEntry | None:
        """Returns the entry of a fault of this motor that is on."""
        return self._board.entry(fault, self.joint)

    def _obey_special(self, last: int) -> None:
        if last == ENTER:
            self._set_entered(True, "enter frame")
        elif last == EXIT:
            self._set_entered(False, "exit frame")
        elif last == ZERO:
            self._zero -= self._angle
            self._angle = 0.0
            self._events.add("zeroed", joint=self.joint)

    def _set_entered(self, entered: bool, reason: str) -> None:
        if entered != self.entered:
            self.entered = entered
            self._events.add("entered" if entered else "off", joint=self.joint, reason=reason)

    def _state(self) -> tuple[float, float, float]:
        """Returns what a reply tells: angle, speed, torque."""
        reported = (self._angle, self._speed, self._torque)
        if stale := self._fault("reply_stale"):
            taken = time.monotonic() - stale.delay
            reported = next(
                ((a, v, t) for when, a, v, t in reversed(self._past) if when <= taken), reported
            )
        if self._fault("feedback_reversed"):
            reported = (2.0 * self._zero - reported[0], -reported[1], reported[2])
        if not self._fault("frozen"):
            self._reported = reported
        return self._reported

    def _reply(self) -> CanFrame:
        board = self._board
        angle, speed, torque = self._state()
        # The whole torque works against what holds the motor where it was.
        if self._fault("blocked"):
            angle = self._blocked_at
            speed = 0.0
            held = self._command if self.entered else NEUTRAL
            torque = commanded_torque(held, angle, speed)
        else:
            self._blocked_at = angle
        if self._fault("encoder_jump"):
            angle += ENCODER_JUMP
        if drift := self._fault("out_of_range"):
            angle += DRIFT_RATE * (board.time - drift.time)
        position = math.remainder(angle, 2.0 * _PROFILE.position)
        velocity = clip(speed, _PROFILE.speed)
        torque = clip(torque, _PROFILE.torque)
        temperature = HOT if self._fault("over_temperature") else WARM
        fault = self._fault("motor_fault")
        code = fault.code if fault else 0
        reply = MitReply(self.motor_id, position, velocity, torque, temperature, code)
        return make_reply(reply, _PROFILE)

    def _answers(self) -> Frames:
        frame = self._reply()
        number = frame.arbitration_id
        data = frame.data
        answers: dict[Fault, Frames] = {
            "reply_lost": [],
            "v3_frame": [CanFrame(0x2900 | self.motor_id, data, extended=True)],
            "foreign_id": [CanFrame(0x7F, b"\x7f" + data[1:])],
            "reply_corrupted": [CanFrame(number, bytes(byte ^ 0x5A for byte in data))],
            "reply_short": [CanFrame(number, data[:5])],
            # Classic CAN has no more than 8 bytes: longer than 6, and not 8.
            "reply_long": [CanFrame(number, (data + b"\0")[:7])],
            "double_id": [frame, CanFrame(number, data[:1] + b"\x90" + data[2:])],
        }
        for fault, damaged in answers.items():
            if self._board.consume(fault, self.joint):
                return damaged
        return [frame]


class SlcanAdapter:
    """Adapter that turns bytes from the computer into frames on the bus, and answers into bytes.

    Frames pass only while the channel is open; a refused line is answered by the bell.
    """

    def __init__(self, bus: EmulatedBus, board: FaultBoard) -> None:
        self._bus = bus
        self._board = board
        self._line = b""
        self._open = False
        self._received = b""

    def receive(self, frame: CanFrame) -> None:
        """Receives a frame of another node on the bus."""
        if self._open and len(self._received) < _MAX_RECEIVED:
            self._received += write_frame(frame)

    def poll(self) -> bytes:
        """Returns what other nodes have sent since the last call, for the computer."""
        received = self._received
        self._received = b""
        return self._board.corrupt("can", received)

    def feed(self, data: bytes) -> bytes:
        """Returns what the adapter sends back for these bytes."""
        *lines, rest = (self._line + data).split(b"\r")
        self._line = rest[-_MAX_LINE:]
        return b"".join(self._obey(line) for line in lines if line)

    def _obey(self, line: bytes) -> bytes:
        kind = line[:1]
        if kind in (b"t", b"T"):
            return self._transmit(line)
        if kind == b"O":
            if self._open:
                return _ERROR
            self._open = True
            self._bus.reopened()
        elif kind == b"C":
            self._open = False
        elif kind not in (b"S", b"s", b"Y"):
            return _ERROR
        return _OK

    def _transmit(self, line: bytes) -> bytes:
        frame = read_frame(line)
        if frame is None or not self._open or self._bus.off:
            return _ERROR
        answers = b"".join(map(write_frame, self._bus.carry(frame)))
        return self._board.corrupt("can", answers)


def read_frame(line: bytes) -> CanFrame | None:
    """Decodes the frame of a `t` or `T` line without its end; None if it is none."""
    digits = 3 if line[:1] == b"t" else 8
    try:
        identifier = int(line[1 : 1 + digits], 16)
        length = int(line[1 + digits : 2 + digits], 16)
        data = bytes.fromhex(line[2 + digits :].decode("ascii"))
        if len(data) == length:
            return CanFrame(identifier, data, extended=digits == 8)
        return None
    except (ValueError, FrameError):
        return None


def write_frame(frame: CanFrame) -> bytes:
    """Makes the line that reports a frame, with its end."""
    head = f"T{frame.arbitration_id:08X}" if frame.extended else f"t{frame.arbitration_id:03X}"
    return f"{head}{len(frame.data)}{frame.data.hex().upper()}\r".encode()


class PtyPort:
    """One port. The computer opens `link`, a symbolic link to the terminal.

    Attributes:
        link: path that the computer opens.
        plugged: whether there is a terminal at present.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.plugged = False
        self._master = -1
        self._slave = -1
        self.plug()

    def fileno(self) -> int:
        """Returns the file number of the device's end; -1 while unplugged."""
        return self._master

    def plug(self, link: Path | None = None) -> None:
        """Makes a new terminal, unless there is one; under another name where `link` is given."""
        self.link = link or self.link
        if self.plugged:
            return
        try:
            self._master, self._slave = pty.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            temporary = self.link.with_name(f".{self.link.name}.new")
            temporary.unlink(missing_ok=True)
            temporary.symlink_to(os.ttyname(self._slave))
            os.replace(temporary, self.link)
        except OSError as error:
            raise HardwareError(
                f"{self.link}: no pseudo-terminal can be made: {error.strerror}"
            ) from None
        self.plugged = True

    def unplug(self) -> None:
        """Pulls the plug: the computer's end reads an error from now on."""
        if self.plugged:
            self.plugged = False
            os.close(self._master)
            os.close(self._slave)
            self._master = -1
            self._slave = -1
            self.link.unlink(missing_ok=True)

    def read(self) -> bytes:
        """Returns what has come; empty if nothing has."""
        with suppress(OSError):
            if self.plugged:
                return os.read(self._master, _MAX_BYTES)
        return b""

    def write(self, data: bytes) -> None:
        """Sends bytes; what does not fit is lost, as on a real line."""
        if self.plugged and data:
            with suppress(OSError):
                os.write(self._master, data)
