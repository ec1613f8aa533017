"""The Teensy behind its serial text frames: pulses out, sail angle in and, in the bridge wiring,
the tail motors too.

In the bridge wiring the link is a `FramePort`: the motors' frames become the fields of the text
frame and its reply becomes frames again, so that the same `Motor` with the same checks works on
both wirings. One text frame leaves per `commit`, with the order of each motor: exit before enter
before command. Where nothing was asked for in a cycle the last command is repeated for a short
while, then it is exit; a motor that was never asked anything is ordered to exit.
"""

import math
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace

from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.protocol.ak70 import (
    ENTER,
    EXIT,
    LONG_REPLY,
    NEUTRAL,
    FirmwareProfile,
    is_special,
    make_reply,
)
from aerodima.hardware.protocol.ak70 import decode_command as decode_mit_command
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError, TimedFrames
from aerodima.hardware.protocol.teensy import (
    END,
    SERVO_PULSES,
    SWITCHED_OFF,
    THROTTLE_PULSES,
    Attitude,
    MotorOrder,
    MotorReport,
    MotorRequest,
    TeensyCommand,
    TeensyReply,
    TeensyStatus,
    decode_reply,
    make_command,
)
from aerodima.hardware.transport.serial_link import SerialLink

_MAX_REPLY = 200
"""Largest number of bytes between two `|`; more is noise."""
_WRAP = 2**32
"""Number of milliseconds after which the Teensy's clock starts again from 0."""
_WINDOW = 500
"""Number of messages over which the smallest offset of the clock is taken."""
_BACKWARDS = 1000
"""Fall of the count beyond which the microcontroller has restarted, ms."""
_SILENT = 0.1
"""Time for which a Teensy owes a reply text frame before it counts as silent, s: ten cycles. A
computer that paused has asked for none."""
_MAX_REPEATS = 20
"""Number of cycles in which an order is repeated when its motor asks for nothing; a motor that runs
asks at least every tenth."""
_REQUESTS = {ENTER: MotorRequest.ENTER, EXIT: MotorRequest.EXIT}


class ReplyStream:
    """Parser of the replies in a stream of bytes; anything that is not a valid text frame is
    dropped.

    What stands before the first `|` is never used: a text frame that was joined in its middle can
    look like a shorter one.
    """

    def __init__(self) -> None:
        self._open = b""
        self._synchronised = False

    def feed(self, data: bytes) -> list[TeensyReply]:
        """Adds bytes; returns the replies that became complete, oldest first."""
        *complete, rest = (self._open + data).split(END)
        self._open = rest[: _MAX_REPLY + 1]
        replies: list[TeensyReply] = []
        for text in complete[0 if self._synchronised else 1 :]:
            with suppress(FrameError):
                replies.append(decode_reply(text + END))
        self._synchronised = self._synchronised or bool(complete)
        return replies


class ClockAlignment:
    """Offset between a 32-bit millisecond counter and the computer's monotonic clock.

    A message can only arrive late, never early: the smallest of the last offsets is the best one,
    and the window lets it follow a drift of the counter.
    """

    def __init__(self) -> None:
        self._offsets: deque[float] = deque(maxlen=_WINDOW)
        self._last: int | None = None
        self._turns = 0

    def add(self, count: int, arrival: float) -> float:
        """Takes a message with its count (ms) and arrival (s); returns when it was sent, s on the
        computer's clock.
        """
        if self._last is not None:
            if self._last - count > _WRAP // 2:
                self._turns += 1
            elif self._last - count > _BACKWARDS:
                self._offsets.clear()
                self._turns = 0
        self._last = count
        seconds = (count + self._turns * _WRAP) / 1000.0
        self._offsets.append(arrival - seconds)
        return seconds + min(self._offsets)


class TeensyLink:
    """Text frames to and from the Teensy, one of each per cycle.

    Args:
        link: open serial link; the caller closes it.
        motor_ids: ids of the two motors in the text frame; in `watched_can` their orders stay
            `EXIT`.
        profile: firmware profile of the motors' frames.

    Attributes:
        sail: last angle of the sail encoder, rad in (-pi, pi]; NaN before the first reply.
        sent_time: time at which the Teensy sent the last reply, s on the computer's monotonic
            clock; NaN before the first.
        status: status of the last reply; None before the first.
        fault: fault at the last `poll`; it goes away by itself, the motors' faults that it caused
            do not.
        fault_text: the same fault in words.
    """

    def __init__(
        self, link: SerialLink, motor_ids: tuple[int, int], profile: FirmwareProfile
    ) -> None:
        self._link = link
        self._ids = motor_ids
        self._profile = profile
        self._stream = ReplyStream()
        self._orders: dict[int, MotorOrder] = {}
        self._last = {motor_id: _exit_order(motor_id) for motor_id in motor_ids}
        self._repeats = dict.fromkeys(motor_ids, 0)
        self._counters = dict.fromkeys(motor_ids, 0)
        self._servo = SERVO_PULSES[1]
        self._throttle = THROTTLE_PULSES[1]
        self._attitude: tuple[Attitude, float] | None = None
        self._reply_time = -math.inf
        self._asked = math.inf
        self._clock = ClockAlignment()
        self.sail = math.nan
        self.sent_time = math.nan
        self.status: TeensyStatus | None = None
        self.fault = SourceFault.NO_SAMPLE_YET
        self.fault_text = "the Teensy has not answered yet"

    def age(self, now: float) -> float:
        """Returns the seconds since the last valid reply text frame; infinite before the first."""
        return now - self._reply_time

    def set_pulses(self, servo: int, throttle: int) -> None:
        """Sets the pulses (us) of the next text frames."""
        self._servo = servo
        self._throttle = throttle

    def set_attitude(
        self, roll: float, pitch: float, taken: float, lean: float = 0.0, yaw_rate: float = 0.0
    ) -> None:
        """Sets the attitude for the next text frames; ignored while a value is not finite.

        Args:
            roll: roll angle, rad.
            pitch: pitch angle, rad.
            taken: time at which the attitude was taken, s, monotonic.
            lean: lean by the accelerometer, rad.
            yaw_rate: yaw rate, rad/s.
        """
        if all(map(math.isfinite, (roll, pitch, taken, lean, yaw_rate))):
            self._attitude = Attitude(roll, pitch, 0, lean, yaw_rate), taken

    def send(self, frame: CanFrame, urgent: bool = False) -> bool:
        """Notes a motor's frame for the next text frame.

        A frame that sets the zero, or is for another motor, is not sent.
        """
        del urgent
        if frame.arbitration_id not in self._ids or frame.extended:
            return False
        request = MotorRequest.COMMAND
        command = NEUTRAL
        if is_special(frame.data):
            if frame.data[7] not in _REQUESTS:
                return False
            request = _REQUESTS[frame.data[7]]
        else:
            command = decode_mit_command(frame.data, self._profile)
        noted = self._orders.get(frame.arbitration_id)
        if noted is None or request <= noted.request:  # exit before enter before command
            self._orders[frame.arbitration_id] = MotorOrder(frame.arbitration_id, request, command)
        return True

    def commit(self) -> None:
        """Writes the text frame of this cycle."""
        first, second = map(self._next_order, self._ids)
        attitude = None
        if self._attitude is not None:
            attitude, taken = self._attitude
            age = round(1000.0 * max(0.0, time.monotonic() - taken))
            attitude = replace(attitude, age=age)
        command = TeensyCommand((first, second), self._servo, self._throttle, attitude)
        self._link.write(make_command(command))
        self._asked = min(self._asked, time.monotonic())

    def poll(self) -> TimedFrames:
        """Reads what came in; returns the motors' answers as frames, with their arrival."""
        frames: TimedFrames = []
        for arrival, data in self._link.poll():
            for reply in self._stream.feed(data):
                self._receive(reply, arrival)
                frames += [
                    (arrival, frame) for report in reply.motors if (frame := self._frame_of(report))
                ]
        self._check_silence(time.monotonic())
        return frames

    def flush(self) -> bool:
        """Writes a text frame with what is noted; waits for a short while until it has left."""
        self.commit()
        return self._link.flush()

    def _next_order(self, motor_id: int) -> MotorOrder:
        order = self._orders.pop(motor_id, None)
        if order is not None:
            self._repeats[motor_id] = 0
        else:
            self._repeats[motor_id] += 1
            last = self._last[motor_id]
            order = _exit_order(motor_id)
            if last.request is not MotorRequest.EXIT and self._repeats[motor_id] <= _MAX_REPEATS:
                order = MotorOrder(motor_id, MotorRequest.COMMAND, last.command)
        self._last[motor_id] = order
        return order

    def _receive(self, reply: TeensyReply, arrival: float) -> None:
        self._reply_time = arrival
        self._asked = math.inf
        self.sail = math.remainder(math.radians(reply.sail), 2.0 * math.pi)
        self.sent_time = self._clock.add(reply.clock, arrival)
        self.status = reply.status
        self.fault_text = SWITCHED_OFF.get(reply.status, "")
        self.fault = SourceFault.REPORTED if self.fault_text else SourceFault.NONE

    def _frame_of(self, report: MotorReport) -> CanFrame | None:
        """Makes the frame of a report, in the form that motor and profile have; None if the motor
        has not answered since the last one, or is none of ours.
        """
        state = report.state
        if state.motor_id not in self._counters:
            return None
        if report.replies == self._counters[state.motor_id]:
            return None  # a counter that is 0 at the start: the motor has never answered
        self._counters[state.motor_id] = report.replies
        if LONG_REPLY not in self._profile.reply_lengths:
            state = state._replace(temperature=None, fault=None)
        try:
            return make_reply(state, self._profile)
        except FrameError:
            return None  # beyond the range of the profile: the motor counts a missed reply

    def _check_silence(self, now: float) -> None:
        if self._link.fault:
            self.fault = SourceFault.LOST
            self.fault_text = f"the Teensy's port is lost: {self._link.fault}"
        elif now - self._asked > _SILENT and self.age(now) < math.inf:
            self.fault = SourceFault.SILENT
            self.fault_text = f"the Teensy is silent for {self.age(now):.2f} s"


def pulse(share: float, pulses: tuple[int, int, int]) -> int:
    """Returns the pulse (us) at a share from -1 to 1 of the way from idle to the least or most
    pulse; 0 is idle.
    """
    lowest, idle, highest = pulses
    return round(idle + share * ((highest - idle) if share >= 0 else (idle - lowest)))


def _exit_order(motor_id: int) -> MotorOrder:
    return MotorOrder(motor_id, MotorRequest.EXIT, NEUTRAL)
