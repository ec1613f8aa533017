"""The operator's radio: ages, the latch of the stop, frames that count for nothing."""

import math
import struct

import pytest

from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.radio_link import IDLE, RadioLink
from aerodima.hardware.protocol.radio import (
    OperatorCommand,
    RadioMode,
    make_command,
    make_emergency_stop,
    make_heartbeat,
)
from aerodima.hardware.protocol.xbee import ApiStream, Packet, make_received
from tests.hardware.fake_serial import FakeLink

OPERATOR = 0x0013A20040000001
COMMAND = OperatorCommand(RadioMode.MANUAL, throttle=0.5, steering=-0.25)
SILENT = 0.25


class Radio:
    def __init__(self):
        self.wire = FakeLink()
        self.link = RadioLink(self.wire, SILENT, OPERATOR)

    def take(self, *frames, sender=OPERATOR):
        for frame in frames:
            self.wire.deliver(make_received(Packet(sender, frame)))
        self.link.poll()

    def wait(self, seconds):
        self.wire.now += seconds

    @property
    def age(self):
        return self.link.age(self.wire.now)

    @property
    def fault(self):
        return self.link.fault(self.wire.now)[0]


@pytest.fixture
def radio():
    return Radio()


def test_nothing_is_asked_for_before_the_first_command(radio):
    radio.link.poll()
    assert radio.link.command == IDLE
    assert radio.age == math.inf
    assert not radio.link.stopped
    assert radio.fault is SourceFault.NO_SAMPLE_YET


def test_command_and_heartbeat_make_the_operator_young(radio):
    radio.take(make_command(COMMAND))
    assert radio.link.command == COMMAND
    assert radio.age == math.inf, "no heartbeat yet"
    radio.take(make_heartbeat(1))
    assert radio.age == 0.0
    radio.wait(SILENT - 0.001)
    assert radio.fault is SourceFault.NONE
    radio.wait(0.002)
    assert radio.fault is SourceFault.SILENT
    radio.wire.fault = "no such device"
    assert radio.fault is SourceFault.LOST


@pytest.mark.parametrize("alive", ["command", "heartbeat", "repeated heartbeat and command"])
def test_one_of_both_is_not_enough(radio, alive):
    radio.take(make_command(COMMAND), make_heartbeat(1))
    for count in range(30):
        radio.wait(0.01)
        if "command" in alive:
            radio.take(make_command(COMMAND))
        if "heartbeat" in alive:
            radio.take(make_heartbeat(1 if "repeated" in alive else 2 + count))
    assert radio.age == pytest.approx(0.3)


@pytest.mark.parametrize("first", [17, 200, 250])
@pytest.mark.parametrize("length", [2, 20, 180])
def test_a_recorded_piece_of_radio_that_is_sent_for_ever_is_no_operator(radio, first, length):
    record = [make_heartbeat(first + count) for count in range(length)]
    radio.take(make_command(COMMAND), *record)
    assert radio.fault is SourceFault.NONE, "a living counter wraps"
    for beat in 5 * record:
        radio.wait(0.05)
        radio.take(make_command(COMMAND), beat)
    assert radio.age == pytest.approx(5 * length * 0.05)
    assert "count on" in radio.link.fault(radio.wire.now)[1]


@pytest.mark.parametrize(("last", "first", "refused"), [(30, 1, 30), (150, 1, 150), (2, 250, 9)])
def test_a_station_that_was_started_again_counts_once_it_passed_the_old_counter(
    radio, last, first, refused
):
    radio.take(make_command(COMMAND), make_heartbeat(last))
    for count in range(refused + 1):
        radio.wait(0.05)
        radio.take(make_command(COMMAND), make_heartbeat(first + count))
        assert (radio.age == 0.0) is (count == refused)


def test_emergency_stop_latches(radio):
    radio.take(make_command(COMMAND), make_emergency_stop(), make_command(COMMAND))
    radio.take(make_heartbeat(9))
    assert radio.link.stopped
    assert radio.fault is SourceFault.STOPPED


def test_frames_that_count_for_nothing(radio):
    radio.take(make_command(COMMAND), make_heartbeat(1), sender=OPERATOR + 1)
    radio.take(struct.pack("@BBffff", 1, 1, 0.5, 0, 0, 0))
    assert radio.link.rejected == 1
    assert radio.link.last_error
    assert radio.link.command == IDLE
    assert radio.age == math.inf
    radio.wire.deliver(b"\x00\x7e\x00\x03junk\x7e")
    radio.take(make_command(COMMAND), make_command(COMMAND))
    assert radio.link.command == COMMAND


def test_reports_go_to_the_module_that_was_heard(radio):
    radio.link.report(b"report")
    assert radio.wire.sent == []
    radio.take(make_heartbeat(1))
    radio.link.report(b"report")
    (packet,) = ApiStream().feed_transmits(radio.wire.sent[0])
    assert (packet.address, packet.data) == (OPERATOR, b"report")
