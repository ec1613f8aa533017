"""The serial link over a port in memory: what is sent after a loss, what is replaced, what is
noticed.
"""

import errno
import threading
import time

import pytest

from aerodima.hardware.transport import serial_link
from aerodima.hardware.transport.serial_link import (
    SerialLink,
    SerialSettings,
    open_serial,
    reason_of,
)
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.fake_can import wait_until
from tests.refusals import assert_refused

GONE = OSError(errno.ENODEV, "No such device")


class Port:
    """A device that takes bytes while `gate` is open.

    Attributes: broken: raised by every call; begun: bytes that the driver was given.
    """

    in_waiting = 0

    def __init__(self):
        self.begun = []
        self.written = []
        self.incoming = []
        self.broken = None
        self.gate = threading.Event()
        self.gate.set()

    def read(self, size):
        time.sleep(0.0005)
        if self.broken:
            raise self.broken
        return self.incoming.pop() if self.incoming else b""

    def write(self, data):
        self.begun.append(data)
        self.gate.wait()
        if self.broken:
            raise self.broken
        self.written.append(data)

    def close(self):
        self.gate.set()


@pytest.fixture
def ports():
    """The device as it is plugged in for the first and for the second time."""
    return [Port(), Port()]


@pytest.fixture
def link(ports, monkeypatch):
    monkeypatch.setattr(serial_link, "RECONNECT", 0.001)
    found = iter(ports)
    plugged = threading.Event()
    plugged.set()

    def open_port():
        if not plugged.is_set():
            raise HardwareError("no such device")
        return next(found)

    link = SerialLink(open_port)
    link.plugged = plugged
    yield link
    for port in ports:
        port.gate.set()
    link.close()


def lose(link, port):
    link.plugged.clear()
    port.broken = GONE
    assert wait_until(lambda: link.fault)


def test_what_was_written_while_the_port_was_lost_is_not_sent_when_it_is_back(link, ports):
    lose(link, ports[0])
    link.write(b"throttle 0.5")
    link.plugged.set()
    assert wait_until(lambda: not link.fault)
    assert link.flush(5.0)
    link.write(b"throttle 0")
    assert link.flush(5.0)
    assert ports[1].written == [b"throttle 0"]
    assert link.losses == 1


def test_of_what_waits_behind_a_slow_driver_the_newest_is_sent_and_is_never_lost(link, ports):
    ports[0].gate.clear()
    link.write(b"first")
    assert wait_until(lambda: ports[0].begun)
    link.write(b"second")
    link.write(b"third")
    assert not link.flush(0.01)
    ports[0].gate.set()
    assert link.flush(5.0)
    assert ports[0].written == [b"first", b"third"]


def test_bytes_that_a_lost_port_did_not_take_are_not_sent_again(link, ports):
    def refuse(data):
        ports[0].begun.append(data)
        raise GONE

    ports[0].write = refuse
    link.write(b"old")
    assert wait_until(lambda: ports[0].begun and not link.fault and link.losses == 1)
    assert link.flush(5.0)
    link.write(b"new")
    assert link.flush(5.0)
    assert (ports[0].written, ports[1].written) == ([], [b"new"])


def test_a_lost_port_is_a_fault_until_it_is_back(link, ports):
    assert link.fault == ""
    lose(link, ports[0])
    assert link.fault
    link.plugged.set()
    assert wait_until(lambda: link.fault == "")


def test_bytes_come_in_once_each_with_its_time(link, ports):
    before = time.monotonic()
    ports[0].incoming.append(b"reply")
    found = []
    assert wait_until(lambda: found.extend(link.poll()) or found)
    ((arrival, data),) = found
    assert data == b"reply"
    assert before <= arrival <= time.monotonic()
    assert link.poll() == []


def test_a_driver_that_does_not_come_back_is_a_fault(link, ports, monkeypatch):
    monkeypatch.setattr(serial_link, "_THREAD_SILENT", 0.05)
    stuck = threading.Event()
    ports[0].read = lambda size: stuck.wait() and b""
    assert wait_until(lambda: link.fault)
    stuck.set()


def test_what_waits_is_written_before_the_device_is_closed(link, ports):
    link.write(b"exit")
    link.close()
    assert ports[0].written == [b"exit"]
    assert link.fault == "closed"


@pytest.mark.parametrize(
    ("path", "named"), [("/dev/ttyNOT_THERE", "no such device"), ("/dev/null", "no serial device")]
)
def test_a_path_that_is_no_serial_device_is_refused(path, named):
    settings = SerialSettings(path=path)
    assert_refused(lambda: open_serial(settings), HardwareError, path, named)
    assert_refused(lambda: SerialLink.open(settings), HardwareError, path, named)


@pytest.mark.parametrize(
    ("number", "named"),
    [
        (errno.EACCES, "dialout"),
        (errno.EBUSY, "another program"),
        (errno.ENOENT, "no such device"),
        (errno.ENOTTY, "no serial device"),
        (errno.EIO, "said by the system"),
    ],
)
def test_what_the_system_says_of_a_device_is_told_in_words_that_help(number, named):
    error = OSError("could not open the port")
    error.__cause__ = OSError(number, "said by the system")
    assert named in reason_of(error)


def test_a_port_that_both_threads_lose_is_lost_once_and_the_next_one_stays_open(link, ports):
    old, new = ports
    old.close = lambda: None  # the driver stays in its write
    old.gate.clear()
    link.write(b"stuck")
    assert wait_until(lambda: old.begun)
    old.broken = GONE
    assert wait_until(lambda: link.losses == 1 and not link.fault)
    old.gate.set()
    link.write(b"next")
    assert wait_until(lambda: new.written == [b"next"])
    assert (link.losses, link.fault) == (1, "")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_has_died_is_a_fault(link, ports):
    ports[0].broken = SystemExit()
    assert wait_until(lambda: "serial-receive" in link.fault)
