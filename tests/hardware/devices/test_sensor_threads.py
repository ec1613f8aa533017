"""A sensor thread on a pseudo-terminal: setting up, loss, and coming back."""

import dataclasses
import itertools
import os
import pty
import threading
import time
import tty

import pytest

from aerodima.hardware.devices.bno055 import Bno055Chip, Bno055Sample
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.sensor_threads import Bno055Session, SensorThread
from aerodima.hardware.transport.serial_link import SerialSettings, open_serial
from tests.hardware.fake_can import wait_until

pytestmark = pytest.mark.realtime  # threads and deadlines on the wall clock

LEVEL = Bno055Sample((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Terminal:
    """A pseudo-terminal behind a link that keeps its name when the plug is pulled and put back."""

    def __init__(self, folder, answer):
        self.link = folder / "device"
        self.answer = answer
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
        noise = (0.01 * (next(count) % 5), 0.0, 0.0)
        chip.set_sample(dataclasses.replace(LEVEL, gyro=noise, acceleration=noise))
        return chip.feed(data)

    terminal = Terminal(tmp_path, living)
    terminal.chip = chip
    thread = SensorThread("IMU", terminal.open, Bno055Session(), 0.1)
    yield terminal, thread
    thread.close()


def test_a_plug_that_was_pulled_is_told_and_the_chip_is_set_up_again(imu):
    terminal, thread = imu
    assert wait_until(lambda: fault(thread) is SourceFault.NONE)
    terminal.unplug()
    assert wait_until(lambda: fault(thread) is SourceFault.LOST)
    newest = thread.newest
    terminal.chip.__init__()  # it lost its power
    terminal.plug()
    assert wait_until(lambda: thread.newest != newest and fault(thread) is SourceFault.NONE)
