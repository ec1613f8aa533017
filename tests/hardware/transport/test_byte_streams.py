"""Adapters over a real byte stream: slcan on a pseudo-terminal, socketcand on the loopback."""

import os
import pty
import socket
import threading
import time
import tty
from contextlib import closing

import pytest

from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.transport.can_bus import BusFault, CanBus
from tests.hardware.fake_can import wait_until
from tests.hardware.transport.test_can_bus import COMMAND, REPLY, received

LINE = b"t0008" + REPLY.data.hex().upper().encode() + b"\r"


@pytest.fixture
def slcan():
    """A bus, and the adapter's end of its terminal."""
    end, terminal = pty.openpty()
    tty.setraw(terminal)
    options = {"sleep_after_open": 0.0}
    name = os.ttyname(terminal)
    bus = CanBus.open(CanSettings(interface="slcan", channel=name, options=options))
    os.close(terminal)
    with open(end, "wb", buffering=0) as adapter, closing(bus):
        yield bus, adapter


def test_a_bad_line_takes_no_frame_of_its_read_with_it_and_pieces_of_a_line_are_joined(slcan):
    bus, adapter = slcan
    adapter.write(b"\xff\r" + LINE + b"tZZ\r" + LINE[:9])
    assert received(bus) == [REPLY]
    time.sleep(0.1)  # several reads without an end of the line
    adapter.write(LINE[9:])
    assert received(bus) == [REPLY]
    assert (bus.garbage, bus.fault) == (2, BusFault.NONE)


@pytest.mark.parametrize(
    "line",
    [
        LINE[:9] + LINE[13:],
        LINE.replace(b"t0008", b"t0006"),
        LINE[:-2] + b"\r",
        LINE.replace(b"t000", b"T00000000")[:-3] + b"\r",
    ],
    ids=["shortened", "longer than named", "half a byte", "extended"],
)
def test_a_line_with_another_number_of_bytes_than_it_names_is_no_frame(slcan, line):
    bus, adapter = slcan
    adapter.write(line + LINE)
    assert received(bus) == [REPLY]
    assert (bus.garbage, bus.fault) == (1, BusFault.NONE)


def test_bytes_without_an_end_are_dropped_and_are_a_fault_once_they_do_not_cease(slcan):
    bus, adapter = slcan
    adapter.write(b"\0" * 65)
    assert wait_until(lambda: bus.garbage == 1)
    adapter.write(LINE)
    assert received(bus) == [REPLY]
    assert bus.fault is BusFault.NONE
    assert wait_until(lambda: adapter.write(b"\0" * 65) and bus.fault is BusFault.RECEIVER_DEAD)
    assert "64 bytes" in bus.fault_text


def test_an_adapter_that_is_unplugged_is_lost(slcan):
    bus, adapter = slcan
    adapter.close()
    assert wait_until(lambda: bus.fault is BusFault.ADAPTER_LOST)
    assert bus.fault_text.startswith("CAN slcan:")


def test_frames_go_over_socketcand_until_its_server_has_gone():
    heard = []

    def serve():
        server.accept()[0].close()  # only whether there is a server
        client, _ = server.accept()
        with client:
            for answer in (b"< hi >", b"< ok >", b"< ok >"):
                client.sendall(answer)
                heard.append(client.recv(100))
            client.sendall(b"< frame 000 1.5 0180008008001900 >")

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=serve, daemon=True).start()
        options = {"host": "127.0.0.1", "port": server.getsockname()[1]}
        settings = CanSettings(interface="socketcand", channel="can0", options=options)
        with closing(CanBus.open(settings)) as bus:
            bus.send(COMMAND)
            assert received(bus) == [REPLY]
            assert heard[-1] == b"< send 001 8 80 0 80 0 0 0 8 0 >"
            assert wait_until(lambda: bus.fault is BusFault.ADAPTER_LOST)
