"""The sensor threads on pseudo-terminals: setting up, silence, loss, and coming back."""

import dataclasses
import itertools
import math
import os
import pty
import threading
import time
import tty

import pytest

from aerodima.hardware.devices.bno055 import Bno055Chip, Bno055Sample
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.sensor_threads import Bno055Session, GpsSession, SensorThread
from aerodima.hardware.devices.ublox import GpsSample, make_nav_pvt
from aerodima.hardware.transport.serial_link import SerialSettings, open_serial
from tests.hardware.fake_can import wait_until

pytestmark = pytest.mark.realtime  # threads and deadlines on the wall clock

LEVEL = Bno055Sample((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0))


class Terminal:
    """A pseudo-terminal behind a link that keeps its name when the plug is pulled and put back."""

    def __init__(self, folder, answer=lambda data: b""):
        self.link = folder / "device"
        self.answer = answer
        self.requests = []
        self.plug()

    def plug(self):
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self.slave))
        threading.Thread(target=self._serve, args=(self.master,), daemon=True).start()

    def unplug(self):
        os.close(self.slave)
        os.close(self.master)
        self.link.unlink()

    def open(self):
        return open_serial(SerialSettings(path=str(self.link)), 0.01)

    def _serve(self, master):
        try:
            while data := os.read(master, 4096):
                self.requests.append(time.monotonic())
                if reply := self.answer(data):
                    os.write(master, reply)
        except OSError:
            return


def fault(thread):
    return thread.fault(time.monotonic())[0]


@pytest.fixture
def imu(tmp_path):
    chip = Bno055Chip()
    count = itertools.count()

    def living(data):
        chip.set_sample(
            dataclasses.replace(LEVEL, acceleration=(0.01 * (next(count) % 5), 0.0, 0.0))
        )
        return chip.feed(data)

    terminal = Terminal(tmp_path, living)
    terminal.chip = chip
    terminal.living = living
    thread = SensorThread("IMU", terminal.open, Bno055Session(), 0.1)
    yield terminal, thread
    thread.close()


def test_a_silent_and_a_frozen_chip_are_told_and_the_return_too(imu):
    terminal, thread = imu
    assert wait_until(lambda: thread.count > 5)
    terminal.answer = lambda data: b""
    assert wait_until(lambda: fault(thread) is SourceFault.SILENT)
    terminal.answer = terminal.living
    assert wait_until(lambda: fault(thread) is SourceFault.NONE)
    terminal.answer = terminal.chip.feed
    assert wait_until(lambda: fault(thread) is SourceFault.REPORTED)
    assert "IMU" in thread.fault(time.monotonic())[1]


def test_a_plug_that_was_pulled_is_told_and_the_chip_is_set_up_again(imu):
    terminal, thread = imu
    assert wait_until(lambda: thread.count > 5)
    terminal.unplug()
    assert wait_until(lambda: fault(thread) is SourceFault.LOST)
    count = thread.count
    terminal.chip.__init__()  # it lost its power
    terminal.chip.set_sample(LEVEL)
    terminal.plug()
    assert wait_until(lambda: thread.count > count and fault(thread) is SourceFault.NONE)


def test_gps_samples_have_an_age(tmp_path):
    terminal = Terminal(tmp_path)
    thread = SensorThread("GPS", terminal.open, GpsSession(), 0.3)
    assert thread.age(time.monotonic()) == math.inf
    os.write(terminal.master, b"noise" + make_nav_pvt(GpsSample(3.2)))
    assert wait_until(lambda: thread.count == 1)
    assert thread.newest[1].speed == pytest.approx(3.2)
    assert wait_until(lambda: fault(thread) is SourceFault.SILENT)
    thread.close()
