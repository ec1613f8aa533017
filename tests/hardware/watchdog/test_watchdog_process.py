"""The watchdog process on a slcan adapter behind a pseudo-terminal: killed, stopped and ended drive processes."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from aerodima.hardware.car.safety_settings import load_watchdog_timing
from aerodima.hardware.protocol.ak70 import make_exit
from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.transport.device_lock import lock_devices
from aerodima.hardware.watchdog.watchdog_process import WatchdogProcess
from aerodima.workbench.errors import HardwareError
from tests.hardware.fake_can import SlcanAdapter, wait_until

pytestmark = pytest.mark.emulated  # processes and deadlines on the wall clock

TIMING = load_watchdog_timing()
EXITS = [(motor_id, make_exit(motor_id).data) for motor_id in (1, 2)]

DRIVE = """
import sys, time
from pathlib import Path
from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.watchdog.watchdog_process import WatchdogProcess
watchdog = WatchdogProcess(CanSettings(interface="slcan", channel=sys.argv[1]), (1, 2), Path(sys.argv[2]))
watchdog.arm()
print(watchdog.pid, flush=True)
while True:
    watchdog.beat()
    time.sleep(0.01)
"""


@pytest.fixture
def adapter():
    adapter = SlcanAdapter()
    yield adapter
    if adapter._running:
        adapter.unplug()


@pytest.fixture
def report(tmp_path):
    return tmp_path / "watchdog.json"


def settings(adapter):
    return CanSettings(interface="slcan", channel=adapter.path)


@pytest.fixture
def drive(adapter, report):
    """A process that beats, and the process id of its watchdog."""
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVE, adapter.path, str(report)], stdout=subprocess.PIPE, text=True
    )
    watchdog = None
    try:
        watchdog = int(process.stdout.readline())
        time.sleep(2 * TIMING.heartbeat_timeout)
        assert adapter.frames() == []
        yield process, watchdog
    finally:
        process.kill()
        process.wait()
        # One that acts looks for its adapter by name for a minute: the next test's terminal may have the same.
        if watchdog is not None and _lives(watchdog):
            os.kill(watchdog, signal.SIGKILL)
            assert wait_until(lambda: not _lives(watchdog))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV])
def test_a_drive_process_that_is_killed_has_its_motors_switched_off(adapter, drive, report, number):
    killed = time.monotonic()
    drive[0].send_signal(number)
    assert wait_until(lambda: len(adapter.frames()) >= 2, 1.0)
    assert time.monotonic() - killed < 0.2
    assert adapter.frames()[:2] == EXITS
    assert wait_until(report.exists)
    facts = json.loads(report.read_text())
    assert facts["cause"] == "the drive process died"
    assert killed <= facts["cause_time_s"] <= facts["first_exit_time_s"] < killed + 0.2


def test_exit_frames_go_on_and_the_channel_is_opened_anew(adapter, drive):
    drive[0].kill()
    time.sleep(TIMING.exit_time + 0.3)
    lines = [line for line in adapter.lines if line]
    opened = lines.index(b"O")
    assert lines[opened - 2 : opened] == [b"C", b"S8"]
    assert len([line for line in lines[opened:] if line[:1] == b"t"]) > 50
    assert wait_until(lambda: not _lives(drive[1]), 2.0)


def test_a_drive_process_that_hangs_has_its_motors_switched_off_for_good(adapter, drive):
    drive[0].send_signal(signal.SIGSTOP)
    stopped = time.monotonic()
    assert wait_until(lambda: len(adapter.frames()) >= 2, 1.0)
    assert 0.05 < time.monotonic() - stopped < TIMING.heartbeat_timeout + 0.2
    drive[0].send_signal(signal.SIGCONT)
    time.sleep(TIMING.exit_time + 0.1)
    count = len(adapter.frames())
    time.sleep(0.5)
    assert len(adapter.frames()) > count
    assert b"C" not in adapter.lines, "the drive process may still use the channel"


def test_ctrl_c_in_the_terminal_does_not_end_it(adapter, drive):
    os.kill(drive[1], signal.SIGINT)
    os.kill(drive[1], signal.SIGHUP)
    time.sleep(0.1)
    assert adapter.frames() == []
    drive[0].kill()
    assert wait_until(lambda: adapter.frames()[:2] == EXITS)


def test_one_that_was_asked_to_act_outlives_the_drive_process_until_the_adapter_is_back(adapter, report):
    watchdog = WatchdogProcess(settings(adapter), (1, 2), report)
    watchdog.arm()
    watchdog.trip()
    begin = time.monotonic()
    watchdog.close()
    assert time.monotonic() - begin < 0.2, "nobody waits for it"
    assert wait_until(lambda: adapter.frames()[:2] == EXITS)
    assert _lives(watchdog.pid)
    assert wait_until(lambda: watchdog._process.poll() is not None, TIMING.exit_time + 1.0)


def test_an_orderly_end_sends_nothing(adapter, report):
    watchdog = WatchdogProcess(settings(adapter), (1, 2), report)
    watchdog.arm()
    watchdog.disarm()
    time.sleep(TIMING.heartbeat_timeout + 0.1)
    assert watchdog.healthy
    watchdog.close()
    assert adapter.frames() == []
    assert not report.exists()
    assert not watchdog.healthy


def test_it_acts_when_asked_to_and_cannot_be_armed_again(adapter):
    watchdog = WatchdogProcess(settings(adapter), (1, 2))
    watchdog.arm()
    watchdog.trip()
    assert wait_until(lambda: not watchdog.healthy)
    assert watchdog.reason == "the watchdog has acted: asked to by the drive process"
    assert adapter.frames()[:2] == EXITS
    with pytest.raises(HardwareError, match=r"has acted.*start anew"):
        watchdog.arm()
    watchdog.close()


def test_a_watchdog_that_died_is_noticed(adapter):
    watchdog = WatchdogProcess(settings(adapter), (1, 2))
    watchdog.arm()
    os.kill(watchdog.pid, signal.SIGKILL)
    assert wait_until(lambda: not watchdog.healthy)
    assert watchdog.reason == "the watchdog process has ended"
    watchdog.beat()
    watchdog.close()


def test_a_watchdog_that_hangs_is_noticed_and_does_not_keep_its_lock(adapter):
    lock = lock_devices([adapter.path], "a drive")
    watchdog = WatchdogProcess(settings(adapter), (1, 2), lock=lock)
    watchdog.arm()
    for _ in range(20):
        watchdog.beat()
        time.sleep(0.01)
    assert watchdog.healthy
    os.kill(watchdog.pid, signal.SIGSTOP)
    stopped = time.monotonic()
    while watchdog.healthy and time.monotonic() - stopped < 2.0:
        watchdog.beat()
        time.sleep(0.01)
    assert time.monotonic() - stopped < TIMING.answer_timeout + 0.2
    assert watchdog.reason.startswith("the watchdog process does not answer")
    watchdog.close()
    lock.close()
    lock_devices([adapter.path], "a drive").close()


def test_it_has_a_session_of_its_own(adapter):
    watchdog = WatchdogProcess(settings(adapter), (1, 2))
    assert os.getsid(watchdog.pid) == watchdog.pid != os.getsid(0)
    watchdog.close()


def test_a_line_that_the_dead_process_did_not_finish_does_not_spoil_the_exit_frames(adapter):
    watchdog = WatchdogProcess(settings(adapter), (1, 2))
    watchdog.arm()
    drive_end = os.open(adapter.path, os.O_WRONLY | os.O_NOCTTY)
    os.write(drive_end, b"t0018FF")
    os.close(drive_end)
    watchdog.trip()
    assert wait_until(lambda: EXITS[0][1].hex().upper().encode() in b"".join(adapter.lines))
    assert b"t0018FFFFFFFFFFFFFFFD" in adapter.lines
    watchdog.close()


def test_an_adapter_that_was_unplugged_gets_its_exit_frames_when_it_is_back(adapter, tmp_path):
    link = tmp_path / "can"
    link.symlink_to(adapter.path)
    watchdog = WatchdogProcess(CanSettings(interface="slcan", channel=str(link)), (1, 2))
    watchdog.arm()
    adapter.unplug()
    watchdog.trip()
    assert wait_until(lambda: not watchdog.healthy)
    watchdog.close()
    back = SlcanAdapter()
    link.unlink()
    link.symlink_to(back.path)
    assert wait_until(lambda: b"O" in back.lines and back.frames()[-2:] == EXITS, 3.0)
    back.unplug()


@pytest.mark.parametrize(
    ("can", "message"),
    [
        (CanSettings(interface="slcan", channel="/dev/nowhere"), "No such file"),
        (CanSettings(interface="slcan", channel="/dev/null"), "is no serial device"),
        (CanSettings(interface="virtual", channel="x"), "inside one process"),
        (CanSettings(interface="slcan", channel="/dev/nowhere", bitrate=123), "bit rate 123; allowed: 10000"),
        (
            CanSettings(interface="socketcand", channel="can0", options={"host": "127.0.0.1", "port": 1}),
            "no socketcand at 127.0.0.1:1",
        ),
    ],
)
def test_an_adapter_that_cannot_be_opened_is_one_line(can, message):
    with pytest.raises(HardwareError, match=message) as caught:
        WatchdogProcess(can, (1, 2))
    assert "\n" not in str(caught.value)


def _lives(process_id):
    try:
        with open(f"/proc/{process_id}/stat") as stream:
            return stream.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
