"""Scripts of faults: what is read, what is refused, and what is on when."""

import pytest
import yaml

from aerodima.hardware.car.car_ports import read_events
from aerodima.hardware.devices.motor_settings import load_motor_safety
from aerodima.hardware.emulator.emulated_bus import DRIFT_RATE, ENCODER_JUMP, HOT, WARM
from aerodima.hardware.emulator.fault_script import (
    EventLog,
    FaultBoard,
    Script,
    read_script,
)
from aerodima.hardware.protocol.radio import OperatorCommand, RadioMode
from aerodima.workbench.core.errors import UserError
from tests.refusals import assert_refused


def script(tmp_path, **content):
    path = tmp_path / "script.yaml"
    path.write_text(yaml.safe_dump({"schema": "aerodima/emulation/1", **content}))
    return path


@pytest.fixture
def events(tmp_path):
    log = EventLog(tmp_path / "events.jsonl")
    yield log
    log.close()


def board(events, *faults, clock="start"):
    made = FaultBoard(Script.model_validate({"clock": clock, "faults": faults}), events)
    made.begin("start", 100.0)
    return made


def test_a_script_is_read(tmp_path):
    fault = {"time": 1.0, "fault": "reply_lost", "part": "tail_roll", "duration": 0.1}
    operator = {"time": 0.5, "mode": "manual", "throttle": 0.2}
    read = read_script(script(tmp_path, clock="start", faults=[fault], operator=[operator]))
    assert (read.clock, read.faults[0].fault) == ("start", "reply_lost")
    assert read.faults[0].duration == 0.1
    assert read.operator[0].command(asked=False) == OperatorCommand(RadioMode.MANUAL, 0.2)
    usual = Script.model_validate({}).operator[0]
    modes = [usual.command(asked=asked).mode for asked in (False, True)]
    assert modes == [RadioMode.IDLE, RadioMode.AUTO]


LOST = {"time": 1.0, "fault": "reply_lost", "part": "tail_roll"}


def wrong(**changes):
    return {"faults": [{**LOST, **changes}]}


WRONG = {
    "fault": (wrong(fault="fire"), "fault", "fire"),
    "time": (wrong(time=-1.0), "time", "-1"),
    "nan": (wrong(time=float("nan")), "time", "nan"),
    "no part": (wrong(part=None), "reply_lost", "None"),
    "part": (wrong(fault="unplugged", part="wheel"), "unplugged", "wheel"),
    "part of the bus": (wrong(fault="bus_off", part="can"), "bus_off", "can"),
    "key": (wrong(length=2), "length"),
    "mode": ({"operator": [{"time": 0.0, "mode": "fly"}]}, "mode", "fly"),
    "clock": ({"clock": "noon"}, "clock", "noon"),
    "schema": ({"schema": "aerodima/scenario/1"}, "aerodima/scenario/1"),
}


@pytest.mark.parametrize("row", WRONG.values(), ids=WRONG)
def test_a_wrong_script_is_told_by_file_key_and_value(tmp_path, row):
    content, *named = row
    path = script(tmp_path, **content)
    assert_refused(lambda: read_script(path), UserError, str(path), *named)


def test_a_fault_lasts_from_its_time_for_its_duration(events, tmp_path):
    faults = board(events, {"time": 1.0, "fault": "silent", "part": "imu", "duration": 0.5})
    for now, on in ((100.9, False), (101.0, True), (101.4, True), (101.6, False), (110.0, False)):
        faults.update(now)
        assert (faults.entry("silent", "imu") is not None) is on
        assert faults.entry("silent", "gps") is None
    assert [event["event"] for event in read_events(tmp_path / "events.jsonl")] == [
        "script_begins",
        "fault_on",
        "fault_off",
    ]


def test_a_counted_fault_meets_that_many(events):
    faults = board(events, {"time": 0.0, "fault": "reply_lost", "part": "tail_roll", "count": 2})
    faults.update(100.0)
    assert [faults.consume("reply_lost", "tail_roll") for _ in range(4)] == [
        True,
        True,
        False,
        False,
    ]
    faults.update(100.1)
    assert not faults.consume("reply_lost", "tail_roll")


def test_the_clock_may_begin_with_the_first_enter_frame(events):
    faults = board(events, {"time": 0.0, "fault": "bus_off"}, clock="entered")
    faults.update(105.0)
    assert faults.entry("bus_off") is None
    faults.begin("entered", 106.0)
    faults.begin("entered", 107.0)
    faults.update(106.0)
    assert faults.entry("bus_off") is not None


def test_the_faults_are_larger_than_what_the_motors_are_allowed():
    safety = load_motor_safety()
    assert WARM < safety.temperature_limit < HOT
    assert safety.jump_margin < ENCODER_JUMP
    assert safety.speed_limit > DRIFT_RATE
