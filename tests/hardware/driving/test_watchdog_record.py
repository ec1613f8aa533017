"""Without the record of a watchdog test for its wiring nothing real is armed."""

import json

import pytest

from aerodima.hardware.car.car_ports import (
    EVENTS_FILE,
    READY_FILE,
    READY_SCHEMA,
    emulator_delay,
    ports_from_dict,
)
from aerodima.hardware.driving import watchdog_record as record
from aerodima.hardware.driving.watchdog_record import (
    is_emulated,
    new_record,
    read_record,
    require_watchdog_test,
    write_record,
)
from aerodima.workbench.core.errors import HardwareError
from tests.refusals import assert_refused


def ports(teensy="/dev/ttyACM0", can=None):
    data = {
        "schema": "aerodima/ports/1",
        "teensy": {"path": teensy},
        "imu": {"path": "/dev/ttyUSB0"},
    }
    return ports_from_dict(data if can is None else {**data, "can": can})


REAL = ports(can={"interface": "socketcan", "channel": "can0"})
WIRINGS = ("watched_can", "teensy_bridge")


@pytest.fixture(autouse=True)
def state_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def recorded(wiring="teensy_bridge", **changes):
    made = new_record(wiring, REAL, "strings stopped", 0.152, "operator")
    return write_record(made.model_copy(update=changes), REAL)


@pytest.mark.parametrize("wiring", WIRINGS)
def test_a_test_of_this_wiring_allows_arming(wiring):
    path = recorded(wiring)
    found = require_watchdog_test(wiring, REAL)
    assert (found.time_to_exit, found.seen_off_by, found.emulated) == (0.152, "operator", False)
    assert found == read_record(path)


BEFORE = REAL.model_dump(mode="json", by_alias=True)
OTHER = {
    "made on the emulator": ({"emulated": True}, "emulator"),
    "other firmware": ({"firmware": "0" * 64}, "firmware"),
    "too slow": ({"time_to_exit": 0.5}, "0.5"),
    "other Teensy": ({"ports": {**BEFORE, "teensy": {"path": "/dev/ttyACM7"}}}, "teensy"),
    "other profile": (
        {"ports": {**BEFORE, "firmware_profile": "ak70_10_24_n_m"}}, "firmware_profile"
    ),
    "other motor": ({"ports": {**BEFORE, "tail_roll": {"motor_id": 5}}}, "tail_roll.motor_id"),
    "no ports": ({"ports": {}}, "teensy", "firmware_profile"),
    "other wiring": ({"wiring": "watched_can"}, "watched_can"),
}  # fmt: skip


@pytest.mark.parametrize("row", OTHER.values(), ids=OTHER)
def test_a_record_that_does_not_fit_is_refused(row):
    changes, *named = row
    made = recorded(**changes)
    made.rename(made.with_name("teensy_bridge.json"))
    work = lambda: require_watchdog_test("teensy_bridge", REAL)  # noqa: E731
    assert_refused(work, HardwareError, *named)


def test_without_a_record_nothing_is_armed():
    recorded("teensy_bridge")
    work = lambda: require_watchdog_test("watched_can", REAL)  # noqa: E731
    assert_refused(work, HardwareError, "watched_can", "watchdog-test", "--ports YOUR_")


def test_exit_frames_that_came_too_late_are_not_recorded():
    work = lambda: new_record("watched_can", REAL, "heartbeat stopped", 0.4, "operator")  # noqa: E731
    assert_refused(work, HardwareError, "0.4", "0.3")


DEEP = pytest.param("[" * 100_000, id="deep")


@pytest.mark.parametrize(
    "text", ["", DEEP, "{}", '{"schema": "aerodima/watchdog_test/2"}', "\xff", "unknown key"]
)
def test_a_file_that_is_no_record_is_refused(text):
    path = recorded()
    if text == "unknown key":
        text = json.dumps({**json.loads(path.read_text()), "motors_off": True})
    path.write_text(text, encoding="latin-1")
    assert_refused(lambda: read_record(path), HardwareError, "teensy_bridge.json")


@pytest.mark.parametrize(
    ("wiring", "teensy", "can", "emulated"),
    [
        ("teensy_bridge", "/dev/ttyACM0", None, False),
        ("watched_can", "/dev/ttyACM0", ("socketcan", "can0"), False),
        ("watched_can", "/dev/ttyACM0", ("slcan", "/dev/ttyACM3"), False),
        ("watched_can", "/dev/ttyACM0", ("virtual", "x"), True),
        ("watched_can", "/dev/pts/0", ("socketcan", "can0"), False),
        ("watched_can", "/dev/ttyACM0", ("socketcand", "can0"), False),
    ],
)
def test_which_motors_are_real(wiring, teensy, can, emulated):
    options = {"host": "127.0.0.1", "port": 1} if can and can[0] == "socketcand" else {}
    bus = can and {"interface": can[0], "channel": can[1], "options": options}
    assert is_emulated(wiring, ports(teensy, bus)) is emulated


def test_only_a_pseudo_terminal_of_an_emulator_is_no_real_motor(tmp_path):
    (tmp_path / "ports").mkdir()
    link = tmp_path / "ports" / "teensy"
    link.symlink_to("/dev/pts/0")
    assert not is_emulated("teensy_bridge", ports(str(link))), (
        "a real device may hang behind a pseudo-terminal"
    )
    (tmp_path / READY_FILE).write_text(json.dumps({"schema": READY_SCHEMA}))
    assert is_emulated("teensy_bridge", ports(str(link)))
    events = [{"time_s": t, "event": "late", "delay_s": d} for t, d in ((1.0, 0.3), (5.0, 0.05))]
    (tmp_path / EVENTS_FILE).write_text("".join(f"{json.dumps(event)}\n" for event in events))
    assert emulator_delay(str(link), 2.0) == 0.05
    (tmp_path / EVENTS_FILE).write_text("[" * 100_000 + "\n")
    assert emulator_delay(str(link), 2.0) == 0.0, "a damaged file holds up no stop"
    link.unlink()
    link.symlink_to("/dev/ttyACM0")
    assert not is_emulated("teensy_bridge", ports(str(link)))


def test_a_test_is_void_for_another_adapter_and_not_for_another_zero_or_imu():
    recorded("watched_can")
    data = REAL.model_dump(mode="json", by_alias=True)
    moved = {**data, "imu": {"path": "/dev/ttyUSB9"}, "tail_roll": {"motor_id": 2, "zero": 0.3}}
    assert require_watchdog_test("watched_can", ports_from_dict(moved))
    other = {**data, "can": {"interface": "socketcan", "channel": "can1"}}
    work = lambda: require_watchdog_test("watched_can", ports_from_dict(other))  # noqa: E731
    assert_refused(work, HardwareError, "can")


def test_other_timing_is_another_watchdog(monkeypatch, tmp_path):
    before = record.teensy_hash()
    changed = tmp_path / "changed.yaml"
    changed.write_text("watchdog_timeout: 0.25")
    monkeypatch.setattr(record, "model_path", lambda name: changed)
    assert record.teensy_hash() != before
