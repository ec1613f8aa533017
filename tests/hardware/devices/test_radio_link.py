"""The operator's radio over a pseudo-terminal: ages, the latch of the stop, frames that count for
nothing.
"""

import math
import os
import pty
import struct
import time
import tty

import pytest

from aerodima.hardware.devices.radio_link import IDLE, RadioLink
from aerodima.hardware.protocol.radio import (
    OperatorCommand,
    RadioMode,
    make_command,
    make_emergency_stop,
    make_heartbeat,
)
from aerodima.hardware.protocol.xbee import ReceivedPacket, make_received
from aerodima.hardware.transport.serial_link import SerialLink, SerialSettings
from tests.hardware.fake_can import wait_until

pytestmark = pytest.mark.realtime  # threads and deadlines on the wall clock

OPERATOR = 0x0013A20040000001
COMMAND = OperatorCommand(RadioMode.MANUAL, throttle=0.5, steering=-0.25)


class Radio:
    def __init__(self, operator=OPERATOR):
        self.master, self._slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(self._slave)
        self.serial = SerialLink.open(SerialSettings(path=os.ttyname(self._slave)))
        self.link = RadioLink(self.serial, 0.25, operator)

    def deliver(self, data, sender=OPERATOR):
        os.write(self.master, make_received(ReceivedPacket(sender, data)))

    def arrives(self, condition):
        return wait_until(lambda: self.link.poll() or condition(), 0.5)

    def close(self):
        self.serial.close()
        os.close(self.master)
        os.close(self._slave)


@pytest.fixture
def radio():
    radio = Radio()
    yield radio
    radio.close()


def test_nothing_is_asked_for_before_the_first_command(radio):
    radio.link.poll()
    assert radio.link.command == IDLE
    assert radio.link.age(time.monotonic()) == math.inf
    assert not radio.link.stopped


def test_command_and_heartbeat_make_the_operator_young(radio):
    radio.deliver(make_command(COMMAND))
    assert radio.arrives(lambda: radio.link.command == COMMAND)
    assert radio.link.age(time.monotonic()) == math.inf  # no heartbeat yet
    radio.deliver(make_heartbeat(1))
    assert radio.arrives(lambda: radio.link.age(time.monotonic()) < 0.5)


@pytest.mark.parametrize("alive", ["command", "heartbeat", "repeated heartbeat and command"])
def test_one_of_both_is_not_enough(radio, alive):
    radio.deliver(make_command(COMMAND))
    radio.deliver(make_heartbeat(1))
    assert radio.arrives(lambda: radio.link.age(time.monotonic()) < 0.5)
    start = time.monotonic()
    counter = 1
    while time.monotonic() - start < 0.3:
        if "command" in alive:
            radio.deliver(make_command(COMMAND))
        if alive == "heartbeat":
            counter += 1
        if "heartbeat" in alive:
            radio.deliver(make_heartbeat(counter))
        radio.link.poll()
        time.sleep(0.02)
    assert radio.link.age(time.monotonic()) > 0.25


def test_emergency_stop_latches_until_it_is_cleared_by_hand(radio):
    radio.deliver(make_command(COMMAND))
    radio.deliver(make_emergency_stop())
    assert radio.arrives(lambda: radio.link.stopped)
    radio.deliver(make_command(COMMAND))
    radio.deliver(make_heartbeat(9))
    time.sleep(0.05)
    radio.link.poll()
    assert radio.link.stopped
    radio.link.clear_stop()
    assert not radio.link.stopped
    assert radio.link.command == IDLE
    assert radio.link.age(time.monotonic()) == math.inf


def test_other_modules_are_ignored(radio):
    radio.deliver(make_command(COMMAND), sender=OPERATOR + 1)
    assert radio.arrives(lambda: radio.link.foreign == 1)
    assert radio.link.command == IDLE


def test_frame_of_the_other_alignment_is_counted_and_named(radio):
    radio.deliver(struct.pack("@BBffff", 1, 1, 0.5, 0, 0, 0))
    assert radio.arrives(lambda: radio.link.rejected == 1)
    assert "native alignment" in radio.link.last_error
    assert radio.link.command == IDLE


def test_serial_noise_costs_nothing(radio):
    os.write(radio.master, b"\x00\x7e\x00\x03junk\x7e")
    radio.deliver(make_command(COMMAND))
    radio.deliver(make_command(COMMAND))
    assert radio.arrives(lambda: radio.link.command == COMMAND)
