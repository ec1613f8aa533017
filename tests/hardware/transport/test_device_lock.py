"""One program at a time: locks by device, freed by every kind of death."""

import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.transport.device_lock import can_address, lock_devices
from aerodima.workbench.core.errors import HardwareError
from tests.refusals import assert_refused

HOLD = """
import sys, time
from aerodima.hardware.transport.device_lock import lock_devices
lock = lock_devices(sys.argv[1:], "a drive")
print("held", flush=True)
time.sleep(60)
"""


@contextmanager
def holder(*devices):
    """Another program that has the devices."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, *devices], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == "held\n"
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def device(tmp_path):
    """A name that no other test has."""
    path = tmp_path / "ttyTeensy"
    path.touch()
    return str(path)


def assert_in_use(device, *named):
    assert_refused(lambda: lock_devices([device], "a console"), HardwareError, device, *named)


def test_a_second_program_is_refused_at_once_and_told_who_has_the_device(device):
    with holder(device) as process:
        begin = time.monotonic()
        assert_in_use(device, "a drive", str(process.pid))
        assert time.monotonic() - begin < 0.5


def test_the_same_program_is_refused_a_second_time_and_may_have_it_after_it_was_given_back(device):
    lock = lock_devices([device], "a drive")
    assert_in_use(device)
    lock.close()
    lock.close()
    lock_devices([device], "a drive").close()


def test_an_alias_of_a_device_is_the_same_device(device, tmp_path):
    alias = tmp_path / "aerodima-teensy"
    alias.symlink_to(device)
    for first, second in ((device, str(alias)), (str(alias), device)):
        lock = lock_devices([first], "a drive")
        assert_in_use(second)
        lock.close()


def test_all_or_none(device, tmp_path):
    other = str(tmp_path / "ttyImu")
    with holder(device):
        assert_refused(lambda: lock_devices([other, device], "a console"), HardwareError, device)
        lock_devices([other], "a console").close()


def test_death_frees_the_device(device):
    with holder(device) as process:
        process.kill()
        process.wait()
        lock_devices([device], "a drive").close()


def test_an_adapter_that_is_no_device_of_this_computer_is_locked_by_its_address():
    def address(**options):
        return can_address(CanSettings(interface="socketcand", channel="can0", options=options))

    assert address(host="localhost", port=29536) == address(host="127.0.0.1", port=29536)
    assert address(host="127.0.0.1", port=29536) != address(host="127.0.0.1", port=29537)
    assert can_address(CanSettings(interface="socketcan", channel="can0")) == "socketcan:can0"
    assert (
        can_address(CanSettings(interface="slcan", channel="/dev/ttyACM0@1000000"))
        == "/dev/ttyACM0"
    )
    lock = lock_devices([address(host="127.0.0.1", port=1)], "a drive")
    assert_in_use(address(host="localhost", port=1), "127.0.0.1:1")
    lock.close()
