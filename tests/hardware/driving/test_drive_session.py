"""A whole drive on devices in memory: however it ends, exit frames and throttle 0 go out, and the
log can be read.
"""

import contextlib
import os
import signal
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from aerodima.hardware.car.car_ports import ports_from_dict
from aerodima.hardware.driving import drive_session
from aerodima.hardware.driving.drive_result import DriveOptions
from aerodima.hardware.driving.drive_session import RUN_OVER, DriveSession
from aerodima.hardware.driving.run_journal import RunJournal
from aerodima.hardware.protocol.radio import OperatorCommand, RadioMode
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.logs.schema import read_run_log
from tests.hardware.car.fake_devices import PORTS, CarOnTheBench, ImuAtRest
from tests.refusals import assert_refused

pytestmark = pytest.mark.realtime  # threads and deadlines on the wall clock

QUICK = [
    "manoeuvre.straight_time=0.5",
    "manoeuvre.speed_ramp=0.3",
    "manoeuvre.wait_after_turn=0.1",
    "manoeuvre.log_end=1.2",
]


class LawThatBreaks:
    """The law of the scenario, and after some ticks whatever `fail` does."""

    def __init__(self, scenario, fail=None, ticks=30):
        self._law = law_of_scenario(scenario)
        self._fail = fail
        self._left = ticks

    def __getattr__(self, name):
        return getattr(self._law, name)

    def step(self, memory, observation):
        self._left -= 1
        result = self._law.step(memory, observation)
        return self._fail(result) if self._fail and self._left < 0 else result


class Drive:
    def __init__(self, folder, with_drake, *changes):
        self.bench = CarOnTheBench(*(changes or QUICK))
        self.bench.devices.imu = ImuAtRest()
        self.log = folder / "run.parquet"
        self.with_drake = with_drake
        self.said = []

    def run(self, fail=None, **options):
        return self.run_with(options, law=LawThatBreaks(self.bench.scenario, fail))

    def run_with(self, options, **driver):
        chosen = DriveOptions(self.log, with_drake=self.with_drake, **options)
        ports = ports_from_dict(PORTS)
        said = self.said.append
        car = self.bench.car
        self.session = DriveSession(car, self.bench.scenario, ports, chosen, said, **driver)
        return self.session.complete()

    def assert_safe(self):
        assert not any(motor.entered for motor in self.bench.port.motors)
        assert self.bench.port.exits(1)
        assert self.bench.port.exits(2)
        assert self.bench.teensy.pulses[-1] == (1500, 1500)
        assert self.bench.closed == [1]

    def assert_never_armed(self):
        """No motor was told to enter, and no log is left."""
        assert not [frame for _, frame in self.bench.port.sent if frame.data.endswith(b"\xfc")]
        assert not self.log.exists()


@pytest.fixture(params=[True, False], ids=["drake", "plain"])
def drive(request, tmp_path):
    return Drive(tmp_path, request.param)


def test_the_sequence_runs_and_ends_in_order(drive):
    drive.bench.devices.bus = SimpleNamespace(log_error="CAN traffic log stopped")
    result = drive.run(law_name="LawThatBreaks")
    assert result.traffic_error == "CAN traffic log stopped"
    assert (result.reason, result.orderly, result.signal) == (RUN_OVER, True, 0)
    drive.assert_safe()
    log = read_run_log(drive.log)
    assert log.time[-1] == pytest.approx(1.2)
    assert (log.extra["overruns"], log.extra["tail_law"]) == (0, "LawThatBreaks")
    throttle = max(pulse for _, pulse in drive.bench.teensy.pulses)
    assert throttle > 1500


@pytest.mark.parametrize(
    ("leave", "named"),
    [
        (lambda: 1 / 0, "ZeroDivisionError: division"),
        (lambda: sys.exit(0), "SystemExit: 0"),
        (lambda: os._exit(0), "os._exit(0)"),
    ],
)
def test_a_controller_that_raises_or_leaves_the_program(drive, leave, named):
    def fail(result):
        leave()
        return result

    result = drive.run(fail)
    assert not result.orderly
    assert named in result.reason
    assert "test_drive_session.py" in result.reason
    assert [text for text in drive.said if "in fail" in text and 'drive_session.py", line' in text]
    drive.assert_safe()
    log = read_run_log(drive.log)
    assert log.extra["stop_reason"] == result.reason
    assert log.time[-1] > 0.25


def test_a_controller_that_commands_nan_switches_the_motors_off(drive):
    result = drive.run(lambda result: (result[0], np.full(5, np.nan), *result[2:]))
    assert not result.orderly
    assert "nan" in result.reason.lower()
    drive.assert_safe()
    assert read_run_log(drive.log).extra["stop_reason"] == result.reason


@pytest.mark.parametrize("blocked", [[], [signal.SIGALRM]])
def test_a_controller_that_nothing_interrupts_is_given_up_with_its_log(drive, monkeypatch, blocked):
    left = []
    monkeypatch.setattr(drive_session, "leave", left.append)
    # Another thread takes a signal that this one blocks; a long call hears nothing of it.
    pause = 5.0 if blocked else 0.1

    def go_on(result):
        before = signal.pthread_sigmask(signal.SIG_BLOCK, blocked)
        while not left:
            with contextlib.suppress(BaseException):
                time.sleep(pause)
        drive.assert_safe()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return result

    drive.run(go_on)
    assert left == [1]
    assert any(str(drive.log) in text for text in drive.said)
    cause = "does not come to an end" if blocked else "goes on"
    assert any(cause in text for text in drive.said), "the last line, if it were to end here"
    facts = read_run_log(drive.log).extra
    assert cause in facts["stop_reason"]
    assert facts["stop_time_s"] > 0.25


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal(drive, number):
    ticks = []

    def kill(result):
        ticks.append(result)
        if len(ticks) == 5:
            os.kill(os.getpid(), number)
        return result

    result = drive.run(kill)
    assert (result.signal, result.reason) == (number, signal.Signals(number).name)
    drive.assert_safe()
    assert read_run_log(drive.log).extra["stop_reason"] == result.reason


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_before_arming_switches_nothing_on(drive, number):
    drive.bench.watchdog.arm = lambda: pytest.fail("armed after a signal")
    result = drive.run(confirm=lambda: os.kill(os.getpid(), number) or True)
    assert (result.signal, result.reason) == (number, signal.Signals(number).name)
    drive.assert_never_armed()
    drive.assert_safe()


def test_a_car_that_cannot_drive_is_off_before_its_log_is_discarded(drive, monkeypatch):
    monkeypatch.setattr(drive_session, "await_operator", lambda *_: 1 / 0)
    monkeypatch.setattr(RunJournal, "discard", lambda _: drive.assert_safe())
    with pytest.raises(ZeroDivisionError):
        drive.run()


def test_everything_is_closed_before_the_cause_of_a_silence_is_looked_for(drive, monkeypatch):
    order = []

    def check(session):
        session._guard.least_delay = 0.1
        session._resources.callback(order.append, 0.0)
        raise HardwareError("silent")

    monkeypatch.setattr(DriveSession, "check", check)
    monkeypatch.setattr(drive_session, "emulator_delay", lambda *_: order.append(0.3) or 0.3)
    assert_refused(drive.run, HardwareError, "300 ms: silent")
    assert order == [0.0, 0.3, 0.3]


@pytest.mark.parametrize("heard", [True, False])
def test_an_operator_who_leaves_auto_is_an_orderly_end_and_one_who_is_lost_is_not(
    drive, heard, monkeypatch
):
    radio = drive.bench.radio

    def leave(result):
        """The console sends the car to rest when the page has gone; the heartbeat ends with the
        page.
        """
        radio.command = OperatorCommand(RadioMode.IDLE)
        if not heard:
            left = time.monotonic() - radio.silence
            monkeypatch.setattr(radio, "age", lambda now: now - left)
        return result

    result = drive.run(leave)
    assert result.orderly is heard
    assert "left AUTO for IDLE" in result.reason
    assert ("not heard" in result.reason) is not heard
    drive.assert_safe()
    assert read_run_log(drive.log).extra["stop_reason"] == result.reason


def test_without_an_answer_on_the_terminal_nothing_is_armed(drive):
    assert_refused(lambda: drive.run(confirm=lambda: False), HardwareError, "not armed")
    drive.assert_never_armed()
    assert not list(drive.log.parent.glob("*.journal"))


def test_an_operator_who_never_chooses(drive):
    drive.bench.radio.command = OperatorCommand(RadioMode.IDLE)
    begin = time.monotonic()
    result = drive.run(wait_for_operator=0.3)
    assert "AUTO" in result.reason
    assert time.monotonic() - begin < 10.0
    drive.assert_safe()
    assert not drive.log.exists()


def test_a_switch_that_stands_on_auto_since_before_the_arming_starts_nothing(drive):
    drive.bench.radio.car = None  # nobody listens to what the car asks for
    result = drive.run(wait_for_operator=1.0)
    assert "IDLE" in result.reason
    assert any("AUTO" in text and "IDLE" in text for text in drive.said)
    assert not any(text.startswith("driving") for text in drive.said)
    assert {pulses for pulses in drive.bench.teensy.pulses if pulses} == {(1500, 1500)}
    drive.assert_safe()
    assert not drive.log.exists()


def test_a_motor_that_does_not_answer_fails_the_start(drive):
    drive.bench.port.motors[1].respond = lambda frame: []
    assert_refused(drive.run, HardwareError, "tail roll")
    drive.assert_safe()


def test_a_tail_far_from_its_mark_fails_the_start(drive):
    drive.bench.port.motors[1].position = -0.8
    assert_refused(drive.run, HardwareError, "tail roll zero", "-4")  # degrees
    drive.assert_safe()
