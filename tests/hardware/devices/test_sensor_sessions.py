"""What a sensor's session makes of the bytes of its device, on a clock that the test turns."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

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


def set_up(clock, chip):
    """A session that has set the chip up, and its port."""
    session = Bno055Session()
    port = Port(clock, chip.feed)
    session.begin(port)
    return session, port


def test_the_chip_is_set_up_and_asked_every_10_ms_in_step_with_the_loop(clock, chip):
    session, port = set_up(clock, chip)
    session.align(30.0)
    times, samples = zip(*(session.read(port) for _ in range(8)), strict=True)
    assert samples[-1].gyro == (0.0, 0.0, 0.5)
    assert np.diff(times[1:]) == pytest.approx(0.01)
    assert math.remainder(times[-1] - 30.0, 0.01) == pytest.approx(-0.006 + 0.01), "ready in time"


def test_what_the_chip_says_of_itself_is_a_fault_until_it_is_well(clock, chip):
    session, port = set_up(clock, chip)
    for status, faulty in (([1, 3], True), ([5, 0], False)):
        chip.feed(make_write(Register.SYSTEM_STATUS, bytes(status)))
        for count in range(100):
            noise = (0.01 * (count % 5), 0.0, 0.0)  # it lives
            chip.set_sample(Bno055Sample((1.0, 0.0, 0.0, 0.0), noise, noise))
            session.read(port)
        assert ("3" in session.fault_text) is faulty


def test_a_chip_that_answers_nothing_is_set_up_anew_and_another_one_is_refused(clock, chip):
    session, port = set_up(clock, chip)
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


def time_to_fault(clock, rate, attitude=1.0, gyro=1.0, frozen=None):
    """When a session reports a fault of a car that turns at `rate` (3), rad/s, and in which words.

    `attitude` and `gyro` are the fractions of the motion that they show; what is `frozen` stands.
    """
    chip = Bno055Chip()
    session, port = set_up(clock, chip)
    noise = np.random.default_rng(4)
    begin = clock.now
    kept = {}
    while not session.fault_text and clock.now < begin + 3.0:
        turned = Rotation.from_rotvec(attitude * np.array(rate) * (clock.now - begin))
        signals = {
            "quaternion": tuple(np.roll(turned.as_quat(), 1)),
            "gyro": tuple(gyro * np.array(rate) + noise.normal(0.0, 0.005, 3)),
            "acceleration": tuple(noise.normal(0.0, 0.05, 3)),
        }
        kept = kept or {frozen: signals[frozen]} if frozen else {}
        chip.set_sample(Bno055Sample(**signals | kept))
        session.read(port)
    return clock.now - begin, session.fault_text


@pytest.mark.parametrize(
    ("what", "most", "word"),
    [
        ({"rate": (0.5, 0.0, 0.0), "frozen": "quaternion"}, 0.13, "attitude"),
        ({"rate": (0.0, -1.0, 0.5), "frozen": "gyro"}, 0.13, "gyro"),
        ({"rate": (0.0, 0.0, 2.0), "frozen": "acceleration"}, 0.13, "acceleration"),
        ({"rate": (1.0, 0.0, 0.0), "attitude": 0.01}, 0.8, "differ"),
        ({"rate": (1.0, 0.5, -1.0), "attitude": 0.5}, 1.0, "differ"),
        ({"rate": (0.0, 0.0, 0.5), "gyro": 10.0}, 0.4, "differ"),
        ({"rate": (0.0, 0.0, 1.0), "gyro": -1.0}, 0.5, "differ"),
    ],
)
def test_every_signal_of_the_imu_has_a_witness(clock, what, most, word):
    when, text = time_to_fault(clock, **what)
    assert word in text
    assert when <= most


@pytest.mark.parametrize("rate", [(0.0, 0.0, 0.0), (0.0, 0.0, 4.0), (8.0, -5.0, 3.0)])
def test_a_living_imu_has_no_fault_at_rest_and_at_any_rate(clock, rate):
    assert time_to_fault(clock, rate)[1] == ""


class LatePort(Port):
    """A chip that answers in order, `delays[n]` s after its n-th request (None: never), 4 ms after
    others.
    """

    def __init__(self, clock, answer, delays):
        super().__init__(clock, answer)
        self.delays = delays
        self.requests = 0
        self.queue = []

    def write(self, data):
        delay = self.delays.get(self.requests, 0.004)
        self.requests += 1
        answer = self.answer(data)
        if delay is not None:
            last = self.queue[-1][0] if self.queue else 0.0
            self.queue.append((max(self.clock.now + delay, last + 0.001), answer))

    def read(self, size):
        self.clock.now += 0.001
        due = [data for when, data in self.queue if when <= self.clock.now]
        self.queue = self.queue[len(due) :]
        return b"".join(due)


@pytest.mark.parametrize("late", [24, 103, 104])  # samples, and the chip's own status
@pytest.mark.parametrize("delay", [0.055, 0.1, 0.13, 0.19, None])
def test_no_answer_is_taken_for_that_of_another_request(clock, chip, late, delay):
    requests = []

    def answer(data):
        requests.append(clock.now)
        chip.set_sample(
            Bno055Sample((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.01 * len(requests)), (0.0,) * 3)
        )
        return chip.feed(data)

    session = Bno055Session()
    port = LatePort(clock, answer, {late: delay})
    session.begin(port)
    session.align(30.0)
    readings = [session.read(port) for _ in range(130)]
    assert readings.count(None) <= 3
    for reading in filter(None, readings):
        when, sample = reading
        assert requests[round(100 * sample.gyro[2]) - 1] == pytest.approx(when, abs=1e-9)


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
    thread.newest = None
    assert thread.fault(clock.now)[0] is SourceFault.NO_SAMPLE_YET
    thread.newest = (clock.now, "sample")
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
