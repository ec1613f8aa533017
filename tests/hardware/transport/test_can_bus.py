"""The bus over an adapter in memory; what comes over a real byte stream is in the fault table."""

import errno
import time
from io import FileIO
from pathlib import Path

import can
import pytest

from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.transport.can_adapter import CanSettings, TrafficLog, open_bus
from aerodima.hardware.transport.can_bus import BusFault, CanBus
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.fake_can import FakeAdapter, wait_until
from tests.refusals import assert_refused

realtime = pytest.mark.realtime
"""Of a test with a deadline on the wall clock."""

COMMAND = CanFrame(1, bytes.fromhex("8000800000000800"))
LATER = CanFrame(1, bytes.fromhex("8001800000000800"))
EXIT = CanFrame(1, bytes.fromhex("FFFFFFFFFFFFFFFD"))
REPLY = CanFrame(0, bytes.fromhex("0180008008001900"))


@pytest.fixture
def adapter():
    return FakeAdapter()


@pytest.fixture
def bus(adapter):
    bus = CanBus(adapter)
    yield bus
    adapter.send_gate.set()
    bus.close()


def received(bus, count=1):
    frames = []
    wait_until(lambda: frames.extend(frame for _, frame in bus.poll()) or len(frames) >= count)
    return frames


def sent(adapter):
    return [bytes(message.data) for message in adapter.outgoing]


def comes_to(bus, fault):
    return wait_until(lambda: bus.poll() is None or bus.fault is fault)


def test_frames_come_in_with_their_time(bus, adapter):
    before = time.monotonic()
    adapter.deliver(0, REPLY.data)
    assert wait_until(lambda: bus._inbox)
    ((when, frame),) = bus.poll()
    assert frame == REPLY
    assert before <= when <= time.monotonic()
    assert bus.poll() == []


def test_echo_is_dropped_once_only(bus, adapter):
    bus.send(COMMAND)
    bus.flush()
    for _ in range(2):  # the second one is somebody else's, who commands this motor too
        adapter.deliver(1, COMMAND.data)
    assert received(bus) == [COMMAND]


def test_frames_marked_as_sent_by_this_computer_are_dropped(bus, adapter):
    adapter.deliver(1, REPLY.data, is_rx=False)
    adapter.deliver(1, COMMAND.data)
    assert received(bus) == [COMMAND]


def test_listen_filter_keeps_its_ids_and_every_extended_frame(adapter):
    bus = CanBus(adapter, listen={0, 1})
    adapter.deliver(0x123, b"12345678")
    adapter.deliver(0x2901, bytes(8), extended=True)
    adapter.deliver(1, REPLY.data)
    assert received(bus, 2) == [CanFrame(0x2901, bytes(8), extended=True), CanFrame(1, REPLY.data)]
    bus.close()


def test_remote_and_fd_frames_are_counted_not_read(bus, adapter):
    adapter.incoming.put(can.Message(arbitration_id=0, is_remote_frame=True, is_extended_id=False))
    adapter.incoming.put(
        can.Message(arbitration_id=0, is_fd=True, data=bytes(12), is_extended_id=False)
    )
    assert wait_until(lambda: bus.garbage == 2)
    assert bus.poll() == []
    assert bus.fault is BusFault.NONE


def test_a_command_that_may_have_left_is_not_sent_twice_and_an_exit_is(bus, adapter):
    import serial

    send = adapter.send

    def late(message, timeout=None):  # as pyserial, which looks at the clock after the write
        send(message, timeout)
        if len(adapter.outgoing) in (1, 2):
            try:
                raise serial.SerialTimeoutException("Write timeout")
            except serial.SerialTimeoutException as error:
                raise can.CanOperationError("Could not write to serial device") from error

    adapter.send = late
    bus.send(COMMAND)
    assert bus.flush()
    bus.send(EXIT, urgent=True)
    assert bus.flush()
    assert sent(adapter) == [
        COMMAND.data,
        EXIT.data,
        EXIT.data,
    ]
    assert bus.fault is BusFault.NONE


def test_full_buffer_is_retried_and_the_newest_command_wins(bus, adapter):
    adapter.send_error = can.CanOperationError(
        "Failed to transmit: No buffer space available", errno.ENOBUFS
    )
    bus.send(COMMAND)
    time.sleep(0.01)
    bus.send(LATER)
    adapter.send_error = None
    assert bus.flush()
    assert sent(adapter) == [LATER.data]
    assert bus.fault is BusFault.NONE


@realtime
def test_buffer_that_stays_full_is_a_fault_and_exit_still_waits_to_go_first(bus, adapter):
    adapter.send_error = can.CanOperationError("Transmit buffer full")
    start = time.monotonic()
    while bus.fault is BusFault.NONE and time.monotonic() < start + 2:
        bus.send(COMMAND)
        time.sleep(0.005)
    assert bus.fault is BusFault.SEND_BLOCKED
    assert time.monotonic() - start < 0.5
    bus.send(COMMAND)
    bus.send(EXIT, urgent=True)
    adapter.send_error = None
    assert wait_until(lambda: adapter.outgoing)
    bus.flush()
    assert sent(adapter) == [EXIT.data]


def hold_up(bus, adapter):
    """A driver that does not come back from a frame to motor 2."""
    adapter.send_gate.clear()
    bus.send(CanFrame(2, COMMAND.data))
    assert wait_until(lambda: bus._outbox.age_in_hand() > 0.0)


def test_exit_overtakes_what_waits_and_removes_the_commands_of_its_motor(bus, adapter):
    hold_up(bus, adapter)
    bus.send(COMMAND)
    for _ in range(3):
        bus.send(EXIT, urgent=True)
    adapter.send_gate.set()
    bus.flush(5.0)
    assert sent(adapter)[1:] == [EXIT.data] * 3


def test_commands_that_grew_old_behind_a_stuck_driver_are_not_sent(bus, adapter):
    hold_up(bus, adapter)
    bus.send(COMMAND)
    time.sleep(0.08)
    adapter.send_gate.set()
    bus.flush(5.0)
    assert [message.arbitration_id for message in adapter.outgoing] == [2]


@realtime
def test_driver_that_never_returns_does_not_hold_up_the_loop_and_is_noticed(bus, adapter):
    adapter.send_gate.clear()
    start = time.monotonic()
    for _ in range(100):
        bus.send(COMMAND)
        bus.poll()
    assert time.monotonic() - start < 0.1
    assert comes_to(bus, BusFault.SEND_BLOCKED)


@pytest.mark.parametrize("number", [errno.ENODEV, errno.ENETDOWN, errno.EIO])
@pytest.mark.parametrize("way", ["sending", "receiving"])
def test_lost_adapter_is_noticed(bus, adapter, number, way):
    lost = can.CanOperationError("Failed", number)
    if way == "receiving":
        adapter.incoming.put(lost)
    else:
        adapter.send_error = lost
        bus.send(COMMAND)
    assert comes_to(bus, BusFault.ADAPTER_LOST)


def test_receive_thread_that_dies_is_noticed(bus, adapter):
    adapter.incoming.put(RuntimeError("driver bug"))
    assert comes_to(bus, BusFault.RECEIVER_DEAD)
    assert "driver bug" in bus.fault_text, "the cause is named"
    assert bus.send(EXIT, urgent=True)  # exit frames go out although nothing comes in any more
    bus.flush()
    assert sent(adapter)[-1] == EXIT.data


@realtime
def test_receive_thread_that_hangs_is_noticed(bus, adapter):
    adapter._recv_internal = lambda timeout: (time.sleep(1.0), (None, False))[1]
    assert comes_to(bus, BusFault.RECEIVER_DEAD)


@realtime
def test_bus_off_is_reported_by_the_controller(bus, adapter):
    adapter.deliver(0x04, bytes(8), extended=True, is_error_frame=True)
    assert not wait_until(
        lambda: bus.fault is not BusFault.NONE, 0.05
    )  # error-passive warnings are no bus-off
    adapter.deliver(0x40, bytes(8), extended=True, is_error_frame=True)
    assert comes_to(bus, BusFault.BUS_OFF)


def test_first_fault_stays(bus, adapter):
    adapter.deliver(0x40, bytes(8), extended=True, is_error_frame=True)
    assert comes_to(bus, BusFault.BUS_OFF)
    adapter.incoming.put(RuntimeError("later"))
    assert wait_until(lambda: not bus._receiver.is_alive())
    assert bus.fault is BusFault.BUS_OFF


def test_a_lost_adapter_is_named_with_the_reason_of_its_driver(adapter):
    bus = CanBus(adapter, name="CAN slcan:/dev/ttyACM0")
    error = can.CanOperationError("Could not read from serial device")
    error.__cause__ = OSError(errno.ENXIO, "gone")
    adapter.incoming.put(error)
    assert comes_to(bus, BusFault.ADAPTER_LOST)
    bus.close()
    named = "CAN slcan:/dev/ttyACM0: receiving failed: there is no such device"
    assert bus.fault_text.startswith(named)


def test_close_sends_what_waits_and_closes_the_adapter(adapter):
    bus = CanBus(adapter)
    for _ in range(5):
        bus.send(EXIT, urgent=True)
    bus.close()
    assert sent(adapter) == [EXIT.data] * 5
    assert adapter.closed
    assert not bus.send(COMMAND)
    assert bus.fault is BusFault.CLOSED


@realtime
def test_close_returns_in_time_although_the_driver_is_stuck(adapter):
    bus = CanBus(adapter)
    adapter.send_gate.clear()
    bus.send(EXIT, urgent=True)
    start = time.monotonic()
    bus.close()
    assert time.monotonic() - start < 1.0
    adapter.send_gate.set()


def test_traffic_log_holds_both_directions(adapter, tmp_path):
    path = tmp_path / "traffic.blf"
    bus = CanBus(adapter, TrafficLog.create(path))
    bus.send(COMMAND)
    bus.flush()
    adapter.deliver(0, REPLY.data)
    received(bus)
    bus.close()
    logged = [
        (message.arbitration_id, bytes(message.data), message.is_rx)
        for message in can.BLFReader(path)
    ]
    assert logged == [(1, COMMAND.data, False), (0, REPLY.data, True)]
    assert_refused(lambda: TrafficLog.create(path), HardwareError, str(path))


@realtime
def test_traffic_log_of_a_killed_run_is_readable(adapter, tmp_path):
    path = tmp_path / "traffic.blf"
    bus = CanBus(adapter, TrafficLog.create(path))
    for i in range(100):
        bus.send(CanFrame(1, i.to_bytes(8, "big")))
        bus.flush()
    assert wait_until(lambda: path.stat().st_size > 400)
    copy = tmp_path / "cut_off.blf"
    copy.write_bytes(path.read_bytes())  # what the disk holds while the program still runs
    read = [int.from_bytes(message.data, "big") for message in can.BLFReader(copy)]
    assert read == list(range(len(read)))
    assert len(read) >= 40
    bus.close()


def test_full_disk_stops_the_log_and_not_the_bus(adapter):
    log = TrafficLog(FileIO("/dev/full", "r+"))
    bus = CanBus(adapter, log)
    for i in range(200):
        bus.send(CanFrame(1, i.to_bytes(8, "big")))
        bus.flush()
    assert wait_until(lambda: "No space left on device" in bus.log_error)
    assert len(adapter.outgoing) == 200
    assert bus.fault is BusFault.NONE
    bus.close()


def test_lines_that_are_no_frame_are_counted_and_without_end_they_are_a_fault(bus, adapter):
    for error in (ValueError("no frame"), IndexError("no text")):
        adapter.incoming.put(error)
    adapter.deliver(0, REPLY.data)
    assert received(bus) == [REPLY]
    assert (bus.garbage, bus.fault) == (2, BusFault.NONE)
    for _ in range(300):
        adapter.incoming.put(ValueError("no frame"))
    assert comes_to(bus, BusFault.RECEIVER_DEAD)


def test_a_frame_with_less_data_than_it_names_is_none(bus, adapter):
    adapter.deliver(0, REPLY.data[:6], dlc=8)
    adapter.deliver(0, REPLY.data[:6])
    assert received(bus) == [CanFrame(0, REPLY.data[:6])]
    assert bus.garbage == 1


def test_a_driver_that_reads_an_endless_nothing_has_lost_its_adapter(bus, adapter):
    def spin(timeout):  # as python-can's socketcand once its server has gone
        end = time.thread_time() + timeout
        while time.thread_time() < end:
            pass
        return None, False

    adapter._recv_internal = spin
    assert comes_to(bus, BusFault.ADAPTER_LOST)


# -- errors of the user


def opened(interface, channel, **others):
    return lambda: open_bus(CanSettings(interface=interface, channel=channel, **others))


SERVER = {"host": "127.0.0.1", "port": 9}
REFUSED = {
    "unknown interface": (opened("can0", "x"), "can0", "slcan", "socketcand"),
    "missing device": (opened("slcan", "/dev/ttyNOT_THERE"), "slcan", "/dev/ttyNOT_THERE"),
    "missing interface": (opened("socketcan", "can77"), "socketcan", "can77"),
    "no server": (opened("socketcand", "can0", options=SERVER), "127.0.0.1", "9"),
    "no host": (opened("socketcand", "can0"), "host"),
    "folder of the log": (
        lambda: CanBus.open(
            CanSettings(interface="virtual", channel="log_test"), Path("/nowhere/traffic.blf")
        ),
        "/nowhere",
    ),
}


@pytest.mark.parametrize("row", REFUSED.values(), ids=REFUSED)
def test_a_bus_that_cannot_be_opened_is_named(row):
    work, *named = row
    assert_refused(work, HardwareError, *named)
