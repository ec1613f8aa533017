"""A Teensy with two motors in memory: reads command strings, answers each with a reply string."""

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
    """Attributes: commands: as read; deaf: ids of motors whose replies are lost; damage: called
    with each reply string.
    """

    def __init__(self):
        self.motors = {1: FakeMotor(1), 2: FakeMotor(2)}
        self.replies = {1: 0, 2: 0}
        self.deaf = set()
        self.commands = []
        self.damage = lambda text: text
        self.status = TeensyStatus.RUNNING
        self.sail = 90.0
        self.clock = 7_000
        self._reader = CommandReader()
        self._reader.feed(b"|")

    def advance(self, seconds):
        self.clock += round(1000.0 * seconds)
        for motor in self.motors.values():
            motor.advance(seconds)

    def answer(self, data):
        _, command = self._reader.feed(data)
        self.commands.append(command)
        reports = tuple(map(self._obey, command.motors))
        return self.damage(make_reply(TeensyReply(reports, self.sail, self.clock, self.status)))

    def _obey(self, order):
        number = order.motor_id
        motor = self.motors[number]
        neutral = make_command(number, order.command, PROFILE)
        frames = {
            MotorRequest.EXIT: [make_exit(number)],
            MotorRequest.ENTER: [neutral, make_enter(number), neutral],
            MotorRequest.COMMAND: [neutral],
        }[order.request]
        reply = [frame for each in frames for frame in motor.receive(each)][-1]
        if number not in self.deaf:
            self.replies[number] = (self.replies[number] + 1) % 256
        state = decode_reply(CanFrame(0, reply.data), PROFILE)
        return MotorReport(state, self.replies[number])
