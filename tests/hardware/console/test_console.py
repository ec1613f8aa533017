"""What the console passes on of what pages say: one page controls, every page may stop the car."""

import json
from types import SimpleNamespace

import pytest

from aerodima.hardware.console.console import GONE_AFTER, Console, ConsoleRecord
from aerodima.hardware.console.operator_radio import OperatorRadio
from aerodima.hardware.console.page_messages import Logging, PageHeartbeat, Request, Stop
from aerodima.hardware.protocol.radio import (
    CarReport,
    EmergencyStop,
    Heartbeat,
    OperatorCommand,
    RadioMode,
)
from aerodima.workbench.core.errors import UserError
from tests.hardware.console.test_operator_radio import CAR, REST, FakeLink
from tests.refusals import assert_refused

LIMITS = {"steering": 0.5, "pitch": 1.0, "roll": 2.0}

ARMED = CarReport(True, False, RadioMode.IDLE, operator_age=0.02)
STOP = Stop(type="stop", by="key")


class Bench:
    """A console, two pages, and a radio in memory. `car`: calls of a car that it has started."""

    def __init__(self, folder):
        self.car = []
        process = SimpleNamespace(
            arm=lambda: self.car.append("arm"), disarm=lambda: self.car.append("disarm"), view=None
        )
        self.link = FakeLink()
        self.record = folder / "record.jsonl"
        radio = OperatorRadio(self.link, CAR)
        self.console = Console(radio, ConsoleRecord(self.record), LIMITS, process)
        self.now = 10.0
        self.first = self.console.connect(self.now)
        self.second = self.console.connect(self.now)
        self.count = 0

    def say(self, message, page=None):
        self.console.handle(page or self.first, message, self.now)

    def ask(self, what, page=None):
        self.say(Request(type=what), page)

    def beat(self, page=None, late=0.0, **values):
        self.now += 0.05
        self.count += 1
        self.say(PageHeartbeat(type="beat", count=self.count, time=self.now - late, **values), page)

    def drive(self):
        """The first page drives the armed car in MANUAL."""
        self.link.report(ARMED, self.now)
        self.console.poll(self.now)
        self.beat()
        self.beat(mode="manual", throttle=0.25)
        assert self.commands()[-1] == OperatorCommand(RadioMode.MANUAL, 0.25)
        return self

    def sent(self, kind):
        return [frame for piece in self.link.sent for frame in piece if isinstance(frame, kind)]

    def commands(self):
        return self.sent(OperatorCommand)

    def recorded(self, event, name):
        lines = map(json.loads, self.record.read_text().splitlines())
        return [line[name] for line in lines if line["event"] == event]


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def test_a_console_that_has_failed_rests_the_car_and_obeys_nothing_but_a_stop(bench):
    bench.drive()
    bench.console.fail(ZeroDivisionError("first"))
    bench.console.fail(RuntimeError("second"))
    assert "first" in bench.console.failure
    assert bench.commands()[-1] == REST
    sent = len(bench.link.sent)
    bench.beat()
    bench.beat(mode="manual")
    bench.ask("arm")
    bench.ask("take", bench.second)
    assert (len(bench.link.sent), bench.car) == (sent, [])
    bench.say(STOP, bench.second)
    assert bench.link.sent[-1] == [EmergencyStop()]


def test_a_page_that_looks_on_may_stop_the_car_and_nothing_else(bench):
    bench.drive()
    sent = len(bench.link.sent)
    for work, named in (
        (lambda: bench.beat(bench.second, mode="auto"), "read-only"),
        (lambda: bench.ask("reset", bench.second), "read-only"),
    ):
        assert_refused(work, UserError, named)
    assert len(bench.link.sent) == sent
    bench.say(STOP, bench.second)
    assert bench.link.sent[-1] == [EmergencyStop()]


def test_the_car_goes_to_rest_with_the_page_that_drives_it_and_with_no_other(bench):
    bench.drive()
    sent = len(bench.link.sent)
    bench.console.disconnect(bench.second)
    assert len(bench.link.sent) == sent
    bench.console.disconnect(bench.first)
    assert bench.link.sent[sent:] == [[REST]], "once, and without a heartbeat"


def test_the_record_says_what_was_sent_and_what_a_lost_port_did_not_take(bench):
    bench.say(Logging(type="log", on=True))
    bench.drive()
    bench.link.fault = "there is no such device"
    bench.console.poll(bench.now)
    bench.beat(mode="manual", throttle=0.5)
    bench.say(STOP)
    assert bench.recorded("command", "throttle") == [0.0, 0.25]
    assert bench.recorded("stop", "sent") == [False]
    assert bench.recorded("report", "armed") == [True]
    assert "there is no such device" in bench.recorded("radio", "fault")[0]
    assert len(bench.sent(Heartbeat)) == 2
    bench.say(Logging(type="log", on=False))
    bench.ask("reset")
    assert bench.recorded("reset", "event") == []


def test_a_car_is_armed_at_rest_and_without_a_stop_only(bench):
    bench.drive()
    assert_refused(lambda: bench.ask("arm"), UserError, "mode", "rest")
    bench.beat()
    bench.say(STOP)
    assert_refused(lambda: bench.ask("arm"), UserError, "emergency stop")
    bench.ask("disarm")
    bench.ask("reset")
    bench.ask("arm")
    assert bench.car == ["disarm", "arm"]


def test_control_is_free_only_when_the_page_that_has_it_has_gone(bench):
    def assert_taken(page):
        assert_refused(lambda: bench.ask("take", page), UserError, "another page")

    bench.beat()
    assert_taken(bench.second)
    bench.now += GONE_AFTER + 0.1
    bench.ask("take", bench.second)
    assert_taken(bench.first)
    bench.console.disconnect(bench.second)
    bench.ask("take", bench.first)
