"""The console's door and what passes it: tokens, origins, one page that controls, stops; a real
server, no browser.
"""

import contextlib
import http.client
import json
import os
import pty
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

import pytest
from typer.testing import CliRunner
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from aerodima.hardware.console.console import Console, ConsoleRecord
from aerodima.hardware.console.console_server import make_app, make_server, open_socket, run_server
from aerodima.hardware.console.operator_radio import OperatorRadio
from aerodima.hardware.console.page_access import Access
from aerodima.hardware.protocol.radio import (
    Heartbeat,
    OperatorCommand,
    RadioMode,
)
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.console.test_console import ARMED
from tests.hardware.console.test_operator_radio import CAR, FakeLink
from tests.refusals import assert_refused

LIMITS = {"steering": 0.5, "pitch": 1.0, "roll": 2.0}


class Served:
    """A console on a free port with a radio in memory."""

    def __init__(self, folder, listener=None, car=None):
        self.link = FakeLink()
        self.said = []
        self.record = folder / "record.jsonl"
        self.listener = listener or open_socket(0)
        self.port = self.listener.getsockname()[1]
        self.access = Access(self.port)
        self.console = Console(
            OperatorRadio(self.link, CAR), ConsoleRecord(self.record), LIMITS, car
        )
        self.server = make_server(make_app(self.console, self.access, self.said.append, self.end))
        self.thread = threading.Thread(target=lambda: self.server.run(sockets=[self.listener]))
        self.thread.start()

    def end(self):
        self.server.should_exit = True

    def close(self):
        self.end()
        self.thread.join(10)
        self.listener.close()

    def get(self, path, **headers):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        connection.putrequest("GET", path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        answer.body = answer.read().decode()
        connection.close()
        return answer

    def enter(self):
        """The cookie that the valid token gives."""
        answer = self.get(self.access.url.partition(str(self.port))[2])
        assert answer.status == 303
        return answer.getheader("Set-Cookie")

    def page(self, cookie, origin=""):
        headers = {"Cookie": cookie.partition(";")[0]}
        origin = f"http://127.0.0.1:{self.port}" if origin == "" else origin
        return Page(
            connect(f"ws://127.0.0.1:{self.port}/socket", origin=origin, additional_headers=headers)
        )

    def sent(self, kind):
        return [
            message
            for piece in list(self.link.sent)
            for message in piece
            if isinstance(message, kind)
        ]


class Page:
    def __init__(self, socket):
        self.socket = socket.__enter__()
        self.count = 0

    def say(self, **message):
        self.socket.send(json.dumps(message))

    def beat(self, **values):
        self.count += 1
        self.say(type="beat", count=self.count, time=time.monotonic(), **values)

    def until(self, condition):
        end = time.monotonic() + 10
        while time.monotonic() < end:
            message = json.loads(self.socket.recv(timeout=10))
            if condition(message):
                return message
        raise AssertionError("did not come")

    def state(self, condition=lambda state: True):
        return self.until(lambda message: message["type"] == "state" and condition(message))

    def refusal(self):
        return self.until(lambda message: message["type"] == "refused")["text"]


@pytest.fixture
def served(tmp_path):
    served = Served(tmp_path)
    yield served
    served.close()


def eventually(condition):
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_token_opens_once_and_the_cookie_afterwards(served):
    assert served.get("/").status == 403
    assert served.get("/console.js").status == 403
    assert served.get("/?token=wrong").status == 403
    used = served.access.url
    cookie = served.enter()
    assert {"HttpOnly", "SameSite=strict"} <= set(cookie.split("; "))
    assert served.get(used.partition(str(served.port))[2]).status == 403
    page = served.get("/", Cookie=cookie.partition(";")[0])
    assert (page.status, "EMERGENCY STOP" in page.body) == (200, True)
    assert "frame-ancestors 'none'" in page.getheader("Content-Security-Policy")
    assert served.access.url in served.said[-1]
    assert served.access.url != used
    assert served.get("/", Cookie=f"{served.access.cookie}=guessed").status == 403
    assert served.get("/../server.py", Cookie=cookie.partition(";")[0]).status == 404


def test_pages_name_nothing_outside(served):
    cookie = served.enter().partition(";")[0]
    for name in (
        "",
        "console.css",
        "console.js",
        "gamepads.js",
        "inputs.js",
        "news.js",
        "plots.js",
    ):
        body = served.get(f"/{name}", Cookie=cookie).body
        assert "http://" not in body
        assert "https://" not in body
        assert "<style" not in body


def test_foreign_host_and_origin_are_refused(served):
    cookie = served.enter()
    plain = cookie.partition(";")[0]
    own = f"127.0.0.1:{served.port}"
    evil = f"evil.example:{served.port}"
    for status, headers in (
        (200, {"Host": own, "Origin": f"http://{own}"}),
        (403, {"Host": evil}),
        (403, {"Origin": "http://evil.example"}),
    ):
        assert served.get("/", Cookie=plain, **headers).status == status
    for origin in ("http://evil.example", "null", None, "http://127.0.0.1:1"):
        with pytest.raises(InvalidStatus, match="403"):
            served.page(cookie, origin=origin)
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    for host, crumb in ((evil, plain), (own, "a=b"), (own, f"{served.access.cookie}=guessed")):
        headers = {"Host": host, "Origin": f"http://{host}", "Cookie": crumb}
        assert served.get("/socket", **upgrade, **headers).status == 403
    assert served.link.sent == []


def test_beats_are_passed_on_one_for_one_and_none_is_invented(served):
    page = served.page(served.enter())
    served.link.report(ARMED, time.monotonic())
    page.state(lambda state: state["radio"]["armed"])
    page.beat()
    for _ in range(4):
        page.beat(mode="manual", throttle=0.25, steering=0.5)
    eventually(lambda: len(served.sent(Heartbeat)) == 5)
    assert [beat.counter for beat in served.sent(Heartbeat)] == [1, 2, 3, 4, 5]
    assert served.sent(OperatorCommand)[-1] == OperatorCommand(RadioMode.MANUAL, 0.25, 0.5)
    time.sleep(0.3)  # the page is frozen: open, but silent
    assert len(served.sent(Heartbeat)) == 5
    page.socket.close()
    eventually(lambda: served.sent(OperatorCommand)[-1] == OperatorCommand(RadioMode.IDLE))
    time.sleep(0.2)
    assert len(served.sent(Heartbeat)) == 5


def die(*_):
    raise ZeroDivisionError("in a part of the console")


@pytest.mark.parametrize("part", ["poll", "state", "welcome", "handle"])
def test_a_part_of_the_console_that_dies_sends_the_car_to_rest_says_so_and_ends_it(tmp_path, part):
    with contextlib.closing(Served(tmp_path)) as served:
        cookie = served.enter()
        page = served.page(cookie)
        served.link.report(ARMED, time.monotonic())
        page.state(lambda state: state["radio"]["armed"])
        page.beat()
        page.beat(mode="auto")
        eventually(lambda: served.sent(OperatorCommand)[-1:] == [OperatorCommand(RadioMode.AUTO)])
        setattr(served.console, part, die)
        if part == "welcome":
            served.page(cookie)
        elif part == "handle":
            page.beat(mode="auto")
        told = page.until(lambda message: message["type"] == "failed")
        assert "ZeroDivisionError" in told["text"]
        assert served.sent(OperatorCommand)[-1] == OperatorCommand(RadioMode.IDLE)
        served.thread.join(10)
        assert not served.thread.is_alive()


def test_a_console_that_has_failed_ends_with_its_reason(tmp_path):
    console = Console(
        OperatorRadio(FakeLink(), CAR),
        ConsoleRecord(tmp_path / "record.jsonl"),
        LIMITS,
    )
    console.poll = die
    with contextlib.closing(open_socket(0)) as listener, ThreadPoolExecutor(1) as thread:
        served = thread.submit(
            run_server, listener, console, Access(listener.getsockname()[1]), print
        )
        assert_refused(lambda: served.result(10), HardwareError, "ZeroDivision")


@pytest.mark.slow
@pytest.mark.parametrize(
    "between", [0.0, 0.1, 0.4], ids=["at once", "while it ends", "near the end"]
)
def test_a_second_ctrl_c_ends_it_without_a_traceback(tmp_path, between):
    radio, module = pty.openpty()
    words = f"-P -m aerodima console --radio {os.ttyname(module)} --port 0".split()
    with subprocess.Popen(
        [sys.executable, *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.default_int_handler
        ),  # deaf below a background job
    ) as console:
        url = console.stdout.readline().removeprefix("open once: ").strip()
        server = urlsplit(url).netloc
        path = url.partition("/?")[2]
        page = http.client.HTTPConnection(server, timeout=10)
        page.request("GET", f"/?{path}")
        cookie = page.getresponse().getheader("Set-Cookie").partition(";")[0]
        with connect(
            f"ws://{server}/socket",
            origin=f"http://{server}",
            additional_headers={"Cookie": cookie},
        ):
            console.send_signal(signal.SIGINT)
            time.sleep(between)
            console.send_signal(signal.SIGINT)
            _, errors = console.communicate(timeout=20)
    os.close(radio)
    os.close(module)
    assert errors in ("", "interrupted\n")
    assert console.returncode in (
        0,
        130,
        -signal.SIGINT,
    )  # the last: Python had ended but for its own exit


def test_nonsense_from_a_page_is_one_line_and_ends_nothing(served):
    page = served.page(served.enter())
    page.state()
    page.socket.send("{")
    assert "\n" not in page.refusal()
    page.socket.send(b"\x00\x01")
    page.refusal()
    page.beat()
    eventually(lambda: served.sent(Heartbeat))


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ([], "--radio"),
        (["--radio", "/dev/none", "--port", "70000"], "70000"),
        (["--radio", "/dev/none", "--port", "0"], "/dev/none"),
        (["--radio", "/dev/none", "--port", "TAKEN"], "TAKEN"),
        (["--ports", "none.json", "--port", "0"], "none.json"),
    ],
)
def test_wrong_flags_are_one_line(words, named, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with contextlib.closing(open_socket(0)) as taken:
        port = str(taken.getsockname()[1])
        used = [word.replace("TAKEN", port) for word in words]
        result = CliRunner().invoke(build_app(), ["console", *used])
    assert result.exit_code == 2
    assert named.replace("TAKEN", port) in result.stderr
    assert len(result.stderr.splitlines()) == 1
