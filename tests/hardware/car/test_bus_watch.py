"""The Teensy as watchdog on the bus, seen from the drive: answered beats, silence, what it says of
itself.
"""

import itertools
import time

import pytest

from aerodima.hardware.car.bus_watch import ANSWER_ID, HEARTBEAT_ID, BusWatch, HeartbeatState
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.protocol.teensy import SWITCHED_OFF, TeensyStatus
from aerodima.workbench.core.errors import HardwareError
from tests.refusals import assert_refused

ANSWER = load_drive_safety().heartbeat_answer


class Bus:
    """A port behind which a Teensy answers every beat with `status`, while it is there."""

    fault = 0
    fault_text = ""

    def __init__(self):
        self.status = TeensyStatus.RUNNING
        self.there = True
        self.beats = []
        self.inbox = []

    def send(self, frame, urgent=False):
        if frame.arbitration_id == HEARTBEAT_ID:
            _, state, counter, check = frame.data
            assert check == ~(state ^ counter) & 0xFF
            self.beats.append((HeartbeatState(state), counter))
            if self.there:
                answer = bytes([0xAD, self.status, counter, ~(self.status ^ counter) & 0xFF])
                self.inbox.append((0.0, CanFrame(ANSWER_ID, answer)))
        return True

    def poll(self):
        frames = self.inbox
        self.inbox = []
        return frames

    def flush(self, timeout=0.2):
        return True


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 50.0

    monkeypatch.setattr(time, "monotonic", lambda: Clock.now)
    return Clock


@pytest.fixture
def watch(clock):
    return BusWatch(Bus(), ANSWER)


def turn(watch, clock, seconds=0.1):
    for _ in range(round(seconds / 0.01)):
        clock.now += 0.01
        watch.poll()
        watch.heartbeat()


def test_it_is_not_armed_before_the_teensy_has_answered(watch, clock):
    assert_refused(watch.arm, HardwareError, "watched_can")
    turn(watch, clock)
    watch.arm()
    turn(watch, clock, 3.0)
    assert not watch.reason
    assert watch._port.beats[-1][0] is HeartbeatState.ARMED
    counters = [counter for _, counter in watch._port.beats]
    assert all(a != b for a, b in itertools.pairwise(counters))


@pytest.mark.parametrize("armed", [True, False])
def test_a_teensy_that_dies_is_noticed(watch, clock, armed):
    turn(watch, clock)
    if armed:
        watch.arm()
    watch._port.there = False
    turn(watch, clock, ANSWER - 0.02)
    assert not watch.reason
    turn(watch, clock, 0.05)
    assert watch.reason
    assert f"{ANSWER + 0.02:.2f} s" in watch.reason
    if not armed:
        assert_refused(watch.arm, HardwareError, "does not answer", watch.reason)


def test_a_loop_that_stood_still_is_no_silence_of_the_teensy(watch, clock):
    turn(watch, clock)
    clock.now += 1.0
    watch.arm()
    clock.now += 1.0
    assert not watch.reason
    watch.poll()
    assert not watch.reason


def test_a_teensy_that_has_acted_is_not_armed_with_and_stops_a_car(watch, clock):
    watch._port.status = TeensyStatus.WATCHDOG_ACTED
    turn(watch, clock)
    assert_refused(watch.arm, HardwareError, SWITCHED_OFF[TeensyStatus.WATCHDOG_ACTED])
    watch._port.status = TeensyStatus.RUNNING
    turn(watch, clock)
    watch.arm()
    watch._port.status = TeensyStatus.ATTITUDE
    turn(watch, clock, 0.03)
    assert watch.reason == SWITCHED_OFF[TeensyStatus.ATTITUDE]


def test_the_frames_of_the_motors_pass_and_the_answers_do_not(watch, clock):
    reply = (1.0, CanFrame(0, bytes([1, 0, 0, 0, 0, 0])))
    watch.heartbeat()
    watch._port.inbox.append(reply)
    assert watch.poll() == [reply]
    assert not watch.reason


def test_trip_and_disarm_are_said_on_the_bus(watch, clock):
    turn(watch, clock)
    watch.arm()
    watch.trip()
    assert watch._port.beats[-1][0] is HeartbeatState.TRIP
    watch.disarm()
    watch.heartbeat()
    assert watch._port.beats[-1][0] is HeartbeatState.OFF


def test_answers_that_are_damaged_or_of_a_beat_to_come_are_no_life(watch, clock):
    turn(watch, clock)
    watch._port.there = False
    counter = watch._port.beats[-1][1]
    for first, last, check in ((0xAE, counter, 0), (0xAD, counter, 1), (0xAD, counter + 100, 0)):
        last %= 256
        answer = bytes([first, 0, last, (~last & 0xFF) ^ check])
        for _ in range(round(ANSWER / 0.01) + 2):
            watch._port.inbox.append((0.0, CanFrame(ANSWER_ID, answer)))
            turn(watch, clock, 0.01)
        assert watch.reason
