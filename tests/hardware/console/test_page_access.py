"""Connections that ask for nothing take neither the files of the console nor the operator's
place.
"""

import contextlib
import socket
import time

import pytest

from aerodima.hardware.console import page_access as waiting
from aerodima.hardware.console.page_access import MAX_WAITING
from tests.hardware.console.test_console_server import Served, eventually

FLOOD = 400


def open_connection(served, sent=b""):
    connection = socket.create_connection(("127.0.0.1", served.port), timeout=10)
    connection.sendall(sent)
    connection.setblocking(False)
    return connection


def is_closed(connection):
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True


@pytest.fixture
def connections():
    with contextlib.ExitStack() as opened:
        yield lambda connection: opened.enter_context(contextlib.closing(connection))


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize(
    "sent", [b"", b"GET / HTTP/1.1\r\nHost: 127.0."], ids=["nothing", "half a request"]
)
def test_a_flood_is_kept_out_and_the_operator_gets_in(tmp_path, connections, monkeypatch, sent):
    monkeypatch.setattr(waiting, "REQUEST_TIME", 60.0)
    with contextlib.closing(Served(tmp_path)) as served:
        flood = [connections(open_connection(served, sent)) for _ in range(FLOOD)]
        eventually(lambda: sum(map(is_closed, flood)) >= FLOOD - MAX_WAITING)
        page = served.page(served.enter())
        page.beat()
        assert page.state()["controls"]
        more = [connections(open_connection(served, sent)) for _ in range(FLOOD)]
        eventually(lambda: sum(map(is_closed, more)) >= FLOOD - MAX_WAITING)
        assert page.state()[
            "controls"
        ]  # one that has asked for something is not among those that are closed


def test_one_that_never_ends_its_request_is_closed(tmp_path, connections, monkeypatch):
    monkeypatch.setattr(waiting, "REQUEST_TIME", 0.3)
    with contextlib.closing(Served(tmp_path)) as served:
        silent, trickling = (
            connections(open_connection(served, sent)) for sent in (b"", b"GET / HTTP/1.1\r\n")
        )
        kept = connections(open_connection(served, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"))
        page = served.page(served.enter())
        begin = time.monotonic()
        while time.monotonic() - begin < 1.0:
            with contextlib.suppress(OSError):
                trickling.send(b"a")
            page.state()
        assert is_closed(silent)
        assert is_closed(trickling)
        with contextlib.suppress(BlockingIOError):
            while kept.recv(4096):
                pass
        assert is_closed(kept)  # its second request never came
        assert page.state()["controls"]
