"""What goes out on the operator's radio: nothing but what a page sent, and a stop until the car
reports it.
"""

import dataclasses
import math

import pytest

from aerodima.hardware.console.operator_radio import OperatorRadio
from aerodima.hardware.console.page_messages import HeartbeatClock, radio_state, read_message
from aerodima.hardware.protocol import radio as frames
from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.radio import (
    CarReport,
    EmergencyStop,
    Heartbeat,
    OperatorCommand,
    OperatorPrompt,
    RadioMode,
    decode_report,
    make_report,
)
from aerodima.hardware.protocol.xbee import ApiStream, Packet, make_received
from aerodima.workbench.core.errors import UserError
from tests.refusals import assert_refused

CAR = 7
MANUAL = OperatorCommand(RadioMode.MANUAL, 0.25, -0.125, 0.5, -1.0)
REST = OperatorCommand(RadioMode.IDLE)
REPORT = CarReport(
    True,
    False,
    RadioMode.MANUAL,
    (0, 0, 3, 0, 6, 0),
    0.5,
    -0.25,
    1.0,
    -1.5,
    2.0,
    -3.0,
    3.5,
    0.0625,
    "no fix",
)


class FakeLink:
    def __init__(self):
        self.sent = []
        self.inbox = []
        self.fault = ""
        self.error = ""
        self.losses = 0

    def write(self, data):
        packets = ApiStream().feed_transmits(data)
        assert all(packet.address == CAR for packet in packets)
        self.sent.append([frames.decode(packet.data) for packet in packets])

    def poll(self):
        inbox = self.inbox
        self.inbox = []
        return inbox

    def report(self, report, now, sender=CAR):
        self.inbox.append((now, make_received(Packet(sender, make_report(report)))))


@pytest.fixture
def link():
    return FakeLink()


@pytest.fixture
def radio(link):
    return OperatorRadio(link, CAR)


STOPPED = CarReport(False, True, RadioMode.IDLE)


@pytest.mark.parametrize(
    ("sender", "number"),
    [(CAR + 1, 0), (CAR, 3), (CAR + 1, 3)],
    ids=["other module", "other car", "both"],
)
def test_a_stop_is_confirmed_by_the_car_and_by_no_other(radio, link, sender, number):
    radio.stop("button", 1.0)
    for tick in range(20):
        link.report(dataclasses.replace(STOPPED, car=number), 1.0 + 0.05 * tick, sender)
        radio.poll(1.0 + 0.05 * tick)
    assert not radio.confirmed
    assert radio.report is None
    assert radio.foreign == 20
    assert sum(EmergencyStop() in sent for sent in link.sent) >= 15, "it goes on being sent"
    link.report(STOPPED, 2.0)
    radio.poll(2.0)
    assert radio.confirmed


def test_a_console_that_sends_to_all_believes_the_first_module_that_is_its_car(link):
    radio = OperatorRadio(link, car=4)
    link.report(REPORT, 1.0, sender=9)
    link.report(dataclasses.replace(REPORT, car=4), 1.0, sender=8)
    link.report(dataclasses.replace(STOPPED, car=4), 1.1, sender=9)
    radio.poll(1.1)
    assert radio.report == dataclasses.replace(REPORT, car=4)
    assert radio.foreign == 2


def test_a_radio_without_pages_is_silent(radio, link):
    for tick in range(100):
        link.report(REPORT, 0.01 * tick)
        radio.poll(0.01 * tick)
    assert link.sent == []


def test_an_armed_car_gets_the_command_and_the_counter_of_the_page(radio, link):
    link.report(REPORT, 1.0)
    radio.poll(1.0)
    radio.heartbeat(299, REST, 1.1)
    radio.heartbeat(300, MANUAL, 1.1)
    assert link.sent == [[REST, Heartbeat(299 % 256)], [MANUAL, Heartbeat(300 % 256)]]


@pytest.mark.parametrize(
    ("report", "age"), [(None, 0.0), (REPORT, 0.6), (CarReport(False, False, RadioMode.IDLE), 0.0)]
)
def test_a_car_that_has_not_just_reported_that_it_is_armed_is_left_at_rest(
    radio, link, report, age
):
    if report is not None:
        link.report(report, 1.0)
    radio.poll(1.0)
    radio.heartbeat(1, MANUAL, 1.0 + age)
    assert link.sent == [[OperatorCommand(RadioMode.IDLE), Heartbeat(1)]]


def test_stop_goes_out_at_once_and_is_repeated_until_the_car_reports_it(radio, link):
    radio.stop("key", 1.0)
    assert link.sent == [[EmergencyStop()]]
    radio.poll(1.04)
    assert len(link.sent) == 1
    radio.poll(1.05)
    radio.poll(1.10)
    assert link.sent[1:] == [[EmergencyStop()]] * 2
    link.report(CarReport(False, True, RadioMode.IDLE), 1.11)
    radio.poll(1.2)
    assert radio.confirmed
    radio.poll(2.0)
    assert len(link.sent) == 3


def test_a_beat_may_replace_a_stop_that_waits_and_carries_it(radio, link):
    radio.stop("button", 1.0)
    radio.heartbeat(5, MANUAL, 1.01)
    assert link.sent[-1] == [EmergencyStop(), OperatorCommand(RadioMode.IDLE), Heartbeat(5)]


def drive_by_hand(radio, link):
    """An armed car that is driven from 1.0 s on."""
    link.report(REPORT, 1.0)
    radio.poll(1.0)
    radio.heartbeat(0, REST, 1.0)
    radio.heartbeat(1, MANUAL, 1.0)


def test_a_stop_stays_until_it_is_reset_and_a_reset_alone_does_not_drive(radio, link):
    drive_by_hand(radio, link)
    radio.stop("gamepad", 1.1)
    link.report(REPORT, 1.2)
    radio.poll(1.2)
    for count, command in enumerate((MANUAL, REST, MANUAL), 2):
        radio.heartbeat(count, command, 1.2)
        assert REST in link.sent[-1]
    radio.reset()
    assert not radio.stopped
    radio.heartbeat(3, MANUAL, 1.8)  # the last report is too old
    assert link.sent[-1] == [OperatorCommand(RadioMode.IDLE), Heartbeat(3)]


def test_a_car_that_is_driven_is_sent_to_rest_once_and_never_by_a_heartbeat(radio, link):
    radio.send_idle()
    assert link.sent == []
    drive_by_hand(radio, link)
    radio.send_idle()
    radio.send_idle()
    assert link.sent[2:] == [[REST]]


def test_a_port_that_is_lost_takes_nothing_and_the_car_is_left_at_rest_when_it_is_back(radio, link):
    link.report(REPORT, 1.0)
    radio.poll(1.0)
    assert radio.heartbeat(1, REST, 1.0)
    assert radio.heartbeat(2, MANUAL, 1.05)
    link.fault = link.error = "reading failed: there is no such device"
    link.losses = 1
    radio.poll(1.1)
    assert link.fault in radio.fault(1.1)
    assert not radio.armed(1.1)
    assert not radio.heartbeat(3, MANUAL, 1.1)
    assert (len(link.sent), radio.mode) == (2, RadioMode.IDLE)
    link.fault = ""
    radio.poll(1.3)
    assert link.error in radio.fault(1.3), "one that comes back to fail again is shown all the time"
    link.report(REPORT, 2.2)
    radio.poll(2.2)
    assert radio.fault(2.2) == ""
    assert radio.heartbeat(4, MANUAL, 2.2)
    assert link.sent[-1] == [REST, Heartbeat(4)]


def test_what_is_not_fitted_to_a_car_without_a_tail_is_no_fault(radio, link):
    faults = (1, 1, 0, 0, 1, 0)
    for has_tail, expected in ((True, ["tail pitch", "tail roll"]), (False, [])):
        link.report(CarReport(True, False, RadioMode.IDLE, faults, has_tail=has_tail), 1.0)
        radio.poll(1.0)
        shown = radio_state(radio, 1.0)["report"]
        assert [fault["source"] for fault in shown["faults"]] == expected
        assert (shown["tail_roll"] is None) is not has_tail


def test_a_mode_that_was_chosen_before_the_car_was_armed_is_not_obeyed_after(radio, link):
    radio.heartbeat(1, REST, 0.9)
    radio.heartbeat(2, MANUAL, 0.95)
    link.report(REPORT, 1.0)
    radio.poll(1.0)
    radio.heartbeat(3, MANUAL, 1.0)
    assert all(MANUAL not in frames for frames in link.sent)
    radio.heartbeat(4, REST, 1.05)
    radio.heartbeat(5, MANUAL, 1.1)
    assert link.sent[-1] == [MANUAL, Heartbeat(5)]


def test_a_car_that_is_armed_anew_under_a_stop_is_stopped_again(radio, link):
    radio.stop("key", 1.0)
    link.report(CarReport(False, True, RadioMode.IDLE), 1.1)
    radio.poll(1.1)
    assert radio.confirmed
    link.report(CarReport(True, False, RadioMode.IDLE), 5.0)
    radio.poll(5.0)
    assert not radio.confirmed
    assert link.sent[-1] == [EmergencyStop()]
    radio.stop("key", 5.01)
    assert not radio.confirmed


IDLE_CAR = CarReport(True, False, RadioMode.IDLE)
REPORTS = [
    REPORT,
    *(dataclasses.replace(IDLE_CAR, prompt=prompt, has_tail=tail, operator_age=math.inf)
      for prompt in OperatorPrompt for tail in (True, False)),
]  # fmt: skip


@pytest.mark.parametrize("report", REPORTS)
def test_report_survives_the_frame(report):
    assert decode_report(make_report(report)) == report


def test_what_is_no_report_is_refused():
    data = make_report(dataclasses.replace(IDLE_CAR, text="long " * 40))
    assert len(data) == 100
    for wrong in (
        data[:41],
        data + b"x",
        b"\x05" + data[1:],
        data[:4] + b"\x09" + data[5:],
        data[:11] + b"\xff" * 32,
    ):
        assert_refused(lambda wrong=wrong: decode_report(wrong), FrameError)


def test_beats_that_were_held_up_are_not_passed_on():
    clock = HeartbeatClock()
    assert all(clock.in_time(1000.0 + 0.05 * i, 5.002 + 0.05 * i) for i in range(20))
    assert not clock.in_time(1001.0, 6.4)  # 0.4 s on its way
    assert clock.in_time(1001.4, 6.403)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"type": "fly"}',
        '{"type": "beat", "count": 1}',
        '{"type": "beat", "count": 1, "time": 0, "throttle": 1.1}',
        '{"type": "beat", "count": 1, "time": NaN}',
        '{"type": "beat", "count": 1, "time": 0, "steering": 4}',
        '{"type": "beat", "count": 1, "time": 0, "mode": "fast"}',
        '{"type": "stop", "by": "magic"}',
        '{"type": "stop", "by": "key", "more": 1}',
    ],
)
def test_what_is_no_message_is_one_line(text):
    with pytest.raises(UserError) as error:
        read_message(text)
    assert "\n" not in str(error.value)
