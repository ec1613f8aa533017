"""What a sensor's session makes of the bytes of its device, on a clock that the test turns."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from aerodima.hardware.devices import sensor_threads
from aerodima.hardware.devices.bno055 import Bno055Chip, Bno055Sample, Register, make_write
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.sensor_threads import (
    Bno055Session,
    GpsSession,
    SensorThread,
    Session,
)
from aerodima.hardware.devices.ublox import GpsSample, make_nav_pvt
from aerodima.workbench.core.errors import HardwareError
from tests.refusals import assert_refused

SILENT = 0.1


class Port:
    """A device whose answers are read; a read without one takes 10 ms."""

    in_waiting = 0

    def __init__(self, clock, answer=lambda data: b""):
        self.clock = clock
        self.answer = answer
        self.waiting = b""

    def write(self, data):
        self.waiting += self.answer(data)

    def read(self, size):
        self.clock.now += 0.0 if self.waiting else 0.01
        data = self.waiting
        self.waiting = b""
        return data


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(now=20.0, monotonic=lambda: clock.now)
    clock.sleep = lambda seconds: setattr(clock, "now", clock.now + seconds)
    monkeypatch.setattr(sensor_threads, "time", clock)
    return clock


@pytest.fixture
def chip():
    chip = Bno055Chip()
    chip.set_sample(Bno055Sample((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0)))
    return chip


def test_the_chip_is_set_up_and_asked_every_10_ms_in_step_with_the_loop(clock, chip):
    session = Bno055Session()
    port = Port(clock, chip.feed)
    session.begin(port)
    session.align(30.0)
    times, samples = zip(*(session.read(port) for _ in range(8)), strict=True)
    assert samples[-1].gyro == (0.0, 0.0, 0.5)
    assert np.diff(times[1:]) == pytest.approx(0.01)
    assert math.remainder(times[-1] - 30.0, 0.01) == pytest.approx(-0.006 + 0.01), "ready in time"


def test_what_the_chip_says_of_itself_is_a_fault_until_it_is_well(clock, chip):
    session = Bno055Session()
    port = Port(clock, chip.feed)
    session.begin(port)
    for status, faulty in (([1, 3], True), ([5, 0], False)):
        chip.feed(make_write(Register.SYSTEM_STATUS, bytes(status)))
        for count in range(100):
            acceleration = (0.01 * (count % 5), 0.0, 0.0)  # it lives
            chip.set_sample(Bno055Sample((1.0, 0.0, 0.0, 0.0), (0.0,) * 3, acceleration))
            session.read(port)
        assert ("3" in session.fault_text) is faulty


def test_a_chip_that_answers_nothing_is_set_up_anew_and_another_one_is_refused(clock, chip):
    session = Bno055Session()
    port = Port(clock, chip.feed)
    session.begin(port)
    port.answer = lambda data: b""
    for _ in range(19):
        assert session.read(port) is None
    port.answer = chip.feed
    assert session.read(port) is not None, "and counts anew"
    port.answer = lambda data: b""
    for _ in range(19):
        assert session.read(port) is None
    assert_refused(lambda: session.read(port), HardwareError, "20")
    port.answer = lambda data: b"\xbb\x01\x55"
    assert_refused(lambda: session.begin(port), HardwareError, "55")


@pytest.mark.parametrize(("speed", "frozen"), [(3.2, True), (0.0, False)])
def test_a_receiver_has_frozen_only_if_a_moving_car_keeps_its_speed(clock, speed, frozen):
    session = GpsSession()
    port = Port(clock)
    for _ in range(11):
        assert not session.fault_text
        port.waiting = make_nav_pvt(GpsSample(speed))
        when, sample = session.read(port)
        assert (when, sample.speed) == (clock.now, pytest.approx(speed))
    assert bool(session.fault_text) is frozen


def test_a_sensor_is_silent_when_its_sample_is_too_old(clock):
    thread = SensorThread("IMU", lambda: Port(clock), Session(), SILENT)
    thread._closing.set()
    thread._thread.join()
    thread._port = Port(clock)
    thread._newest = None
    assert thread.fault(clock.now)[0] is SourceFault.NO_SAMPLE_YET
    thread._newest = (clock.now, "sample")
    for age, fault in (
        (-0.01, SourceFault.NONE),
        (SILENT - 0.001, SourceFault.NONE),
        (SILENT + 0.001, SourceFault.SILENT),
    ):
        assert thread.age(clock.now + age) == pytest.approx(max(0.0, age))
        assert thread.fault(clock.now + age)[0] is fault
    thread._session.fault_text = "frozen"
    assert thread.fault(clock.now) == (SourceFault.REPORTED, "frozen")
    thread._port = None
    assert thread.fault(clock.now)[0] is SourceFault.LOST
