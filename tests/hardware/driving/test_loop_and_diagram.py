"""The plain loop and the diagram are one drive: same commands, same log; both write what a
simulation writes.
"""

import math
import os
import shutil
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import PERIOD, CarReading
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_settings import load_motor_safety
from aerodima.hardware.driving import run_journal
from aerodima.hardware.driving.car_guard import CarGuard, Stage
from aerodima.hardware.driving.drive_diagram import DiagramPilot
from aerodima.hardware.driving.plain_loop import (
    AutoPilot,
    ManualPilot,
    idle_until,
    run_loop,
)
from aerodima.hardware.driving.run_journal import RunJournal, drive_columns, open_run_journal
from aerodima.hardware.driving.speaker import Speaker
from aerodima.hardware.protocol.radio import OperatorCommand, RadioMode
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.core.realtime import permitted
from aerodima.workbench.logs.journal import read_journal
from aerodima.workbench.logs.schema import read_run_log
from tests.hardware.driving.fake_wiring import FakeWiring, quick_turn
from tests.hardware.fake_can import wait_until

SAFETY = load_drive_safety().model_copy(update={"overrun": 100.0, "throttle_start": 1.0})
"""Simulated time: nothing is ever late."""
SCENARIO = quick_turn()


class Time:
    def __init__(self):
        self.now = 50.0

    def __call__(self):
        return self.now

    def wait(self, due):
        self.now = max(self.now, due)


def yaw_rate(tick):
    return 2.0 if 60 <= tick < 110 else 0.0


def armed(wiring, clock):
    guard = CarGuard(wiring, SAFETY)
    idle_until(guard, lambda: True, 0.1, clock, clock.wait)
    guard.arm(clock())
    assert idle_until(guard, lambda: guard.was_idle, 0.1, clock, clock.wait)
    guard.drive(RadioMode.AUTO, clock())
    return guard


def plain(path, wiring, scenario=SCENARIO, length=2.0, pilot=None):
    clock = Time()
    guard = armed(wiring, clock)
    journal = open_run_journal(path, scenario, "watched_can")
    stopped = run_loop(
        guard, pilot or AutoPilot(scenario), scenario, length, journal, clock, clock.wait
    )
    journal.close()
    return guard, stopped


def diagram(path, wiring, scenario=SCENARIO):
    return plain(path, wiring, scenario, pilot=DiagramPilot(scenario))


class RollingCar(FakeWiring):
    def read(self, now):
        self.attitude = (0.2 * math.sin(0.05 * len(self.commands)), 0.0)
        return super().read(now)


@pytest.mark.parametrize("gain", [0.0, 3.0], ids=["free", "rollover control"])
def test_plain_loop_and_diagram_give_the_same_commands_and_the_same_log(tmp_path, gain):
    scenario = SCENARIO.varied(rollover_control={"gain": gain})
    wirings = [RollingCar(yaw_rate=yaw_rate) for _ in range(2)]
    plain(tmp_path / "plain.parquet", wirings[0], scenario)
    diagram(tmp_path / "drake.parquet", wirings[1], scenario)
    steering = {command.steering_angle for command in wirings[0].commands}
    assert len(steering) > 20 if gain else steering == {0.0, scenario.manoeuvre.steer_angle}
    assert len(wirings[0].commands) == len(wirings[1].commands)
    for ours, theirs in zip(wirings[0].commands, wirings[1].commands, strict=True):
        assert (ours.steering_angle, ours.throttle) == (theirs.steering_angle, theirs.throttle)
        np.testing.assert_array_equal(ours.tail_roll, theirs.tail_roll)
        np.testing.assert_array_equal(ours.tail_pitch, theirs.tail_pitch)
    logs = [read_run_log(tmp_path / f"{name}.parquet") for name in ("plain", "drake")]
    assert list(logs[0].table.columns) == list(logs[1].table.columns) == drive_columns()
    np.testing.assert_allclose(
        logs[0].table.to_numpy(), logs[1].table.to_numpy(), rtol=0, atol=1e-12
    )


def test_the_sequence_turns_swings_and_cuts_the_throttle(tmp_path):
    wiring = FakeWiring(yaw_rate=yaw_rate)
    guard, stopped = plain(tmp_path / "run.parquet", wiring)
    assert math.isnan(stopped)
    assert guard.stage is Stage.DRIVING
    log = read_run_log(tmp_path / "run.parquet")
    states = log.signal("controller_state")
    assert {SwingState.HOLD, SwingState.SWING, SwingState.SETTLE} <= set(states)
    turning = log.signal("steering_command_rad") > 0.5
    assert log.time[turning][[0, -1]] == pytest.approx(
        [0.51, 1.0]
    )  # a row shows what left one tick before
    assert np.all(log.signal("throttle_command")[log.time > 1.21] == 0.0)
    assert log.signal("tail_roll_angle_rad")[0] == pytest.approx(-math.pi / 2)
    assert log.signal("tail_roll_angle_rad")[-1] > 1.3
    assert log.signal("imu_yaw_rad")[-1] > 3.0 + 0.05 * 195  # unwrapped
    assert log.extra["platform"] == "physical"


@pytest.mark.parametrize("run", [plain, diagram], ids=["plain", "diagram"])
def test_a_fault_ends_the_run_with_a_log_up_to_it(tmp_path, run):
    wiring = FakeWiring()
    real = wiring.read

    def read(now):
        if len(wiring.commands) == 50:
            wiring.faults["imu"] = SourceFault.SILENT
        return real(now)

    wiring.read = read
    wiring.speed = 0.0
    guard, stopped = run(tmp_path / "run.parquet", wiring)
    log = read_run_log(tmp_path / "run.parquet")
    assert guard.finished
    assert 0.4 < stopped < 0.55
    assert log.time[-1] == pytest.approx(stopped + SAFETY.tail_hold + SAFETY.after_exit, abs=0.03)
    assert log.signal("status_imu_fault")[-1] == SourceFault.SILENT
    assert all(command.throttle == 0.0 for command in wiring.commands[51:])


@pytest.mark.parametrize("run", [plain, diagram], ids=["plain", "diagram"])
def test_the_log_has_the_commands_that_were_sent_also_of_a_stopped_drive(tmp_path, run):
    wiring = FakeWiring()
    real = wiring.read

    def read(now):
        if len(wiring.commands) == 90:  # while the sequence steers and drives
            wiring.faults["operator"] = SourceFault.STOPPED
        return real(now)

    wiring.read = read
    _, stopped = run(tmp_path / "run.parquet", wiring)
    log = read_run_log(tmp_path / "run.parquet")
    sent = wiring.commands[-len(log.time) - 1 : -1]
    assert log.time[-1] > stopped + 0.05
    assert log.signal("throttle_command") == pytest.approx([one.throttle for one in sent])
    steering = log.signal("steering_command_rad")
    assert steering == pytest.approx([one.steering_angle for one in sent])
    after = log.time > stopped + PERIOD
    assert steering[~after].max() > 0.1
    assert log.signal("throttle_command")[~after].max() > 0.1
    assert not steering[after].any()
    assert not log.signal("throttle_command")[after].any()


def test_a_dry_run_logs_what_the_pilot_commands(tmp_path):
    clock = Time()
    wiring = FakeWiring()
    guard = CarGuard(wiring, SAFETY)
    journal = open_run_journal(tmp_path / "run.parquet", SCENARIO, "watched_can")
    run_loop(guard, AutoPilot(SCENARIO), SCENARIO, 2.0, journal, clock, clock.wait)
    log = read_run_log(journal.close())
    assert log.signal("steering_command_rad").max() > 0.1
    assert not any(command.throttle for command in wiring.commands)


def test_the_operator_drives_by_radio_within_the_servo():
    pilot = ManualPilot(SCENARIO)
    operator = OperatorCommand(RadioMode.MANUAL, 0.2, -0.9, 0.1, 0.4)
    for tick in range(100):
        command = pilot.step(tick * PERIOD, CarReading(operator=operator)).command
    assert (command.steering_angle, command.throttle) == (-SCENARIO.servo.limit, 0.2)
    np.testing.assert_allclose(command.tail_roll, [0.4, 0.0, 17.0, 5.0, 0.0])
    np.testing.assert_allclose(command.tail_pitch, [0.1, 0.0, 17.0, 5.0, 0.0])


def test_a_stick_that_jumps_does_not_swing_the_tail():
    pilot = ManualPilot(SCENARIO)
    operator = OperatorCommand(RadioMode.MANUAL, pitch_tail=-0.2, roll_tail=1.5)
    reading = CarReading(tail_state=np.array([0.1, -1.5, 0, 0, 0, 0]), operator=operator)
    commands = [pilot.step(tick * PERIOD, reading).command for tick in range(301)]
    most = load_motor_safety().ramp_speed * PERIOD
    roll = np.array([command.tail_roll[0] for command in commands])
    assert roll[0] == pytest.approx(-1.5 + most)
    assert np.all(np.abs(np.diff(roll)) <= most + 1e-12)
    assert roll[-1] == pytest.approx(1.5)
    assert commands[-1].tail_pitch[0] == pytest.approx(-0.2)


@pytest.mark.skipif(not permitted()[0], reason="real-time priority is not permitted here")
def test_the_log_of_a_loop_with_priority_is_written_with_priority(tmp_path):
    """An ordinary thread, displaced by another program while it holds the interpreter's lock, would
    stop the loop.
    """
    found = []

    def drive():
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(7))
        journal = open_run_journal(tmp_path / "run.parquet", SCENARIO, "watched_can")
        journal.append(np.zeros(len(journal.columns)))
        while journal._waiting.qsize():
            time.sleep(0.001)
        found.append(os.sched_getscheduler(journal._thread.native_id))
        journal.discard()

    thread = threading.Thread(target=drive)
    thread.start()
    thread.join()
    assert found == [os.SCHED_RR]


def test_a_full_disk_stops_the_car_and_what_it_did_not_take_is_in_the_log_once_there_is_room(
    tmp_path,
):
    class FullDisk(RunJournal):
        def _write_batch(self):
            if self.rows + self._filled > 60:
                raise OSError(28, "No space left on device")
            super()._write_batch()

    clock = Time()
    wiring = FakeWiring()
    wiring.speed = 0.0
    guard = armed(wiring, clock)
    good = open_run_journal(tmp_path / "good.parquet", SCENARIO, "watched_can")
    journal = FullDisk(tmp_path / "run.parquet", drive_columns(), good._metadata)
    journal._buffer = np.empty((30, len(drive_columns())))
    journal._flush_due = journal._flush_interval = math.inf  # by full batches alone
    good.discard()
    assert not list(tmp_path.glob("good*"))

    def wait(due):
        clock.wait(due)
        while journal._waiting.qsize() and not journal.error:  # the thread keeps up
            pass

    run_loop(guard, AutoPilot(SCENARIO), SCENARIO, 2.0, journal, clock, wait)
    assert "No space left" in guard.reason
    assert wiring.calls[-1] == "disarm"
    assert (journal.rows, journal.lost) == (60, 0)
    log = read_run_log(journal.close())
    assert log.table["time_s"].to_numpy() == pytest.approx(PERIOD * np.arange(len(log.table)))
    assert len(log.table) > 90
    assert not list(tmp_path.glob("*.journal"))


def append_rows(journal, first, end):
    for index in range(first, end):
        journal.append(np.full(len(journal.columns), PERIOD * index))


def test_a_journal_without_a_drive_leaves_a_file_that_hangs_to_its_thread(tmp_path, monkeypatch):
    disk = threading.Event()
    writers = []

    write = lambda _: writers.append(threading.current_thread()) or disk.wait(1.0)  # noqa: E731
    monkeypatch.setattr(run_journal, "_LAST_WAIT", 0.01)
    monkeypatch.setattr(RunJournal, "_write_batch", write)
    journal = open_run_journal(tmp_path / "run.parquet", SCENARIO, "watched_can")
    append_rows(journal, 0, 1)
    assert wait_until(lambda: writers)
    journal.discard()
    disk.set()
    assert writers == [journal._thread]


@pytest.mark.parametrize("taken", [False, True])
def test_a_log_whose_folder_is_removed_is_said_at_once_and_written_all_the_same(
    tmp_path, monkeypatch, taken
):
    monkeypatch.setattr(run_journal, "_CHECK_PERIOD", 0.01)
    said = []
    terminal = threading.Event()

    def say(text):
        said.append(text)
        terminal.wait()
        raise BrokenPipeError("the terminal is gone")

    path = tmp_path / "logs" / "run.parquet"
    speaker = Speaker(say)
    journal = open_run_journal(path, SCENARIO, "watched_can", say=speaker)
    append_rows(journal, 0, 25)
    shutil.rmtree(path.parent)
    assert wait_until(lambda: said)
    append_rows(journal, 25, 50)
    assert str(journal.journal) in said[0]
    if taken:  # something else is there by the end
        path.mkdir(parents=True)
    log = journal.close()
    terminal.set()
    speaker.flush()
    assert log == (tmp_path / "run.parquet" if taken else path)
    assert str(log) in said[1]
    assert len(said) == 2
    assert read_run_log(log).table["time_s"].to_numpy() == pytest.approx(PERIOD * np.arange(50))


def test_a_journal_that_is_cut_while_driving_is_whole_again_within_a_second_and_it_is_said(
    tmp_path,
):
    said = []
    path = tmp_path / "run.parquet"
    journal = open_run_journal(path, SCENARIO, "watched_can", say=said.append)
    append_rows(journal, 0, 25)
    assert wait_until(lambda: journal.rows)
    os.truncate(journal.journal, 3000)
    begin = time.monotonic()
    assert wait_until(lambda: said)
    assert time.monotonic() - begin < 1.0
    assert read_journal(journal.journal)[0].num_rows >= 1
    append_rows(journal, 25, 50)
    run = read_run_log(journal.close())
    assert run.table["time_s"].to_numpy() == pytest.approx(PERIOD * np.arange(50))
    assert str(journal.journal) in run.extra["journal_notes"][0]
    assert journal.lost == 0


KILLED = """
import sys, time
from pathlib import Path
import numpy as np
from aerodima.hardware.driving.run_journal import open_run_journal
from aerodima.workbench.scenario.scenario import load_scenario
journal = open_run_journal(Path(sys.argv[1]), load_scenario("auto_turn"), "watched_can")
print("ready", flush=True)
while True:
    row = np.zeros(len(journal.columns))
    row[0] = time.monotonic()
    journal.append(row)
    time.sleep(0.01)
"""


@pytest.mark.realtime
def test_a_killed_drive_loses_a_tenth_of_a_second_of_its_log_at_most(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path / "run.parquet")], stdout=subprocess.PIPE
    )
    assert process.stdout.readline() == b"ready\n"
    time.sleep(1.23)
    killed = time.monotonic()
    process.kill()
    process.wait()
    table, damage = read_journal(tmp_path / "run.parquet.journal")
    assert damage
    assert killed - table.column(0)[-1].as_py() <= 0.1
