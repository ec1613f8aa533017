"""An AK70-10 as the bus sees it, on a joint of the simulated car."""

from __future__ import annotations

import math

from aerodima.hardware.emulator.event_log import EventLog
from aerodima.hardware.emulator.fault_board import FaultBoard
from aerodima.hardware.emulator.fault_script import EmulatorNumbers, Fault, Joint
from aerodima.hardware.protocol.ak70 import (
    NEUTRAL,
    MitCommand,
    MitReply,
    decode_command,
    is_special,
    make_reply,
)
from aerodima.hardware.protocol.ak70_profiles import FirmwareProfile
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError

_ENTER, _EXIT, _ZERO = 0xFC, 0xFD, 0xFE


class EmulatedMotor:
    """Obeys and answers like the real one, which has no watchdog: it holds its last command for ever.

    It also remembers that command when it is switched off, and jumps to it when it is entered again.

    Args:
        joint, motor_id: which one.
        zero: motor angle at joint angle 0, rad. direction: sign of the motor's angle against the joint's.

    Attributes:
        entered: whether it makes torque.
    """

    def __init__(
        self,
        joint: Joint,
        motor_id: int,
        profile: FirmwareProfile,
        numbers: EmulatorNumbers,
        board: FaultBoard,
        events: EventLog,
        zero: float = 0.0,
        direction: int = 1,
    ) -> None:
        self.joint, self.motor_id = joint, motor_id
        self._profile, self._numbers, self._board, self._events = profile, numbers, board, events
        self._zero, self._direction = zero, direction
        self._command = NEUTRAL
        self._angle = self._speed = self._torque = self._blocked_at = 0.0
        self.entered = False

    @property
    def joint_command(self) -> MitCommand:
        """What it does to its joint now, in the joint's angle and signs."""
        if not self.entered:
            return NEUTRAL
        command, sign = self._command, self._direction
        return MitCommand(
            sign * (command.position - self._zero),
            sign * command.velocity,
            command.kp,
            command.kd,
            sign * command.torque,
        )

    def set_joint(self, angle: float, speed: float, torque: float) -> None:
        """State of the joint: rad, rad/s, N m."""
        self._angle = self._zero + self._direction * angle
        self._speed, self._torque = self._direction * speed, self._direction * torque

    def receive(self, data: bytes) -> list[CanFrame]:
        """Obeys 8 bytes that came under its id; its answer, as faults leave it."""
        if is_special(data):
            self._obey_special(data[7])
        else:
            try:
                self._command = decode_command(data, self._profile)
            except FrameError:
                return []  # a real one has no way to complain
        for fault in (Fault.MOTOR_FAULT, Fault.MOTOR_OFF):
            if self._board.entry(fault, self.joint) and self.entered:
                self._set_entered(False, "its own fault" if fault is Fault.MOTOR_FAULT else "by itself")
        return self._answers()

    def _obey_special(self, last: int) -> None:
        if last == _ENTER:
            self._set_entered(True, "enter frame")
        elif last == _EXIT:
            self._set_entered(False, "exit frame")
        elif last == _ZERO:
            self._zero -= self._angle
            self._angle = 0.0
            self._events.add("zeroed", joint=self.joint)

    def _set_entered(self, entered: bool, reason: str) -> None:
        if entered != self.entered:
            self.entered = entered
            self._events.add("entered" if entered else "off", joint=self.joint, reason=reason)

    def _reply(self) -> CanFrame:
        numbers, board, profile = self._numbers, self._board, self._profile
        fault = board.entry(Fault.MOTOR_FAULT, self.joint)
        hot = board.entry(Fault.OVER_TEMPERATURE, self.joint)
        if board.entry(Fault.BLOCKED, self.joint):
            return self._blocked_reply()
        self._blocked_at = self._angle
        angle = self._angle
        if board.entry(Fault.ENCODER_JUMP, self.joint):
            angle += numbers.encoder_jump
        drift = board.entry(Fault.OUT_OF_RANGE, self.joint)
        if drift:
            angle += numbers.drift_rate * (board.time - drift.time)
        long_form = 8 in profile.reply_lengths
        return make_reply(
            MitReply(
                self.motor_id,
                math.remainder(angle, 2.0 * profile.position),
                min(max(self._speed, -profile.speed), profile.speed),
                min(max(self._torque, -profile.torque), profile.torque),
                (numbers.hot_temperature if hot else numbers.temperature) if long_form else None,
                (fault.code if fault else 0) if long_form else None,
            ),
            profile,
        )

    def _blocked_reply(self) -> CanFrame:
        """Of a joint that is held where it was when the fault came: all of the torque works against what holds it."""
        command, profile = self._command if self.entered else NEUTRAL, self._profile
        torque = command.kp * (command.position - self._blocked_at) + command.kd * command.velocity + command.torque
        torque = min(max(torque, -profile.torque), profile.torque)
        long_form = (self._numbers.temperature, 0) if 8 in profile.reply_lengths else (None, None)
        return make_reply(MitReply(self.motor_id, self._blocked_at, 0.0, torque, *long_form), profile)

    def _answers(self) -> list[CanFrame]:
        frame, board, joint = self._reply(), self._board, self.joint
        if board.meets(Fault.REPLY_LOST, joint):
            return []
        if board.meets(Fault.V3_FRAME, joint):
            return [CanFrame(0x2900 | self.motor_id, frame.data, extended=True)]
        if board.meets(Fault.FOREIGN_ID, joint):
            return [CanFrame(0x7F, bytes([0x7F]) + frame.data[1:])]
        if board.meets(Fault.REPLY_CORRUPTED, joint):
            return [CanFrame(frame.arbitration_id, bytes(byte ^ 0x5A for byte in frame.data))]
        if board.meets(Fault.REPLY_SHORT, joint):
            return [CanFrame(frame.arbitration_id, frame.data[:5])]
        if board.meets(Fault.REPLY_LONG, joint):  # classic CAN has no more than 8 bytes: longer than 6, and not 8
            return [CanFrame(frame.arbitration_id, (frame.data + b"\0")[:7])]
        if board.meets(Fault.DOUBLE_ID, joint):
            return [frame, CanFrame(frame.arbitration_id, frame.data[:1] + b"\x90" + frame.data[2:])]
        return [frame]
