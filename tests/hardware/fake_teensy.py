"""A Teensy with two motors on a pseudo-terminal: reads command strings, answers each with a reply
string.
"""

import os
import pty
import re
import threading
import time
import tty

from aerodima.hardware.protocol.ak70 import decode_reply, make_command, make_enter, make_exit
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.protocol.teensy import (
    MotorReport,
    MotorRequest,
    TeensyReply,
    TeensyStatus,
)
from tests.hardware.fake_motors import PROFILE, FakeMotor
from tests.hardware.firmware.core_functions import CommandReader, make_reply


class FakeTeensy:
    """Attributes: commands: (time, command) as read; silent: answers nothing; damage: called with
    each reply string.
    """

    def __init__(self):
        self.motors = {1: FakeMotor(1), 2: FakeMotor(2)}
        self.replies = {1: 0, 2: 0}
        self.deaf = set()
        self.commands = []
        self.silent = False
        self.damage = lambda text: text
        self.status = TeensyStatus.RUNNING
        self.sail = 90.0
        self.start = self._time = time.monotonic()
        self.plug_in()

    def plug_in(self):
        self.master, self._slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.path = os.ttyname(self._slave)
        self._running = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def unplug(self):
        if not self._running:
            return
        self._running = False
        self._thread.join(1.0)
        os.close(self.master)
        os.close(self._slave)

    def write(self, data):
        os.write(self.master, data)

    def _serve(self):
        stream = CommandReader()
        stream.feed(b"|")  # this end hears the line from its first byte on
        while self._running:
            try:
                data = os.read(self.master, 4096)
            except BlockingIOError:
                time.sleep(0.0005)
                continue
            except OSError:
                return
            for part in re.split(rb"(?<=\|)", data):  # at most one command ends with a part
                found, command = stream.feed(part)
                if found:
                    self._obey(command)

    def _obey(self, command):
        now = time.monotonic()
        self.commands.append((now, command))
        reports = []
        for order in command.motors:
            motor = self.motors[order.motor_id]
            motor.advance(now - self._time)
            neutral = make_command(order.motor_id, order.command, PROFILE)
            frames = {
                MotorRequest.EXIT: [make_exit(order.motor_id)],
                MotorRequest.ENTER: [neutral, make_enter(order.motor_id), neutral],
                MotorRequest.COMMAND: [neutral],
            }[order.request]
            replies = [reply for frame in frames for reply in motor.receive(frame)]
            if order.motor_id not in self.deaf:
                self.replies[order.motor_id] = (self.replies[order.motor_id] + 1) % 256
            state = decode_reply(CanFrame(0, replies[-1].data), PROFILE)
            reports.append(self._report(order.motor_id, state))
        self._time = now
        if not self.silent:
            clock = int((now - self.start) * 1000)
            text = make_reply(TeensyReply(tuple(reports), self.sail, clock, self.status))
            self.write(self.damage(text))

    def _report(self, motor_id, state):
        return MotorReport(
            motor_id,
            state.position,
            state.velocity,
            state.torque,
            self.replies[motor_id],
            int(state.temperature),
            state.fault,
        )
