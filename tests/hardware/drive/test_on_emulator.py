"""The whole way on the emulated car: command line, real byte streams, both wirings, against the simulation."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hardware.emulator.events import read_events
from hardware.wiring.base import WIRINGS
from tests.blocked_drake import BLOCK
from workbench.logs.columns import sensor_columns
from workbench.logs.schema import read_run_log
from workbench.metrics import metrics_of
from workbench.replay.reckoned_motion import replayable
from workbench.scenario import load_scenario
from workbench.trial import run_trial

pytestmark = [pytest.mark.emulated, pytest.mark.slow]

SETTINGS = [
    "manoeuvre.straight_time=3",
    "manoeuvre.log_end=6",
    "controller.trigger_yaw_rate=0.6",  # where the yaw rate rises steeply; on its plateau at 1 rad/s noise decides
    "simulation.step=0.004",  # half the load of a step of 2 ms for a machine that runs car and drive
    "simulation.log_rate=250",
]
FLAGS = [word for setting in SETTINGS for word in ("--set", setting)]
PROGRAM = str(Path(sys.executable).with_name("aerodima"))
NO_DRAKE = (
    BLOCK
    + """
from workbench.cli import main
sys.argv = ["aerodima", *sys.argv[1:]]
main()
"""
)


class Emulated:
    def __init__(self, folder, wiring):
        self.folder, self.wiring = folder / "car", wiring
        self.log = folder / "drive.parquet"
        self.environment = {**os.environ, "XDG_STATE_HOME": str(folder / "state"), "OMP_NUM_THREADS": "1"}
        self._emulator = None

    def start(self, *flags):
        command = [PROGRAM, "emulate", "auto_turn", *FLAGS, "--out", str(self.folder), "--wiring", self.wiring, *flags]
        self._emulator = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        end = time.monotonic() + 60
        while not (self.folder / "ready.json").exists():
            assert self._emulator.poll() is None
            assert time.monotonic() < end
            time.sleep(0.05)
        return self

    def stop(self):
        if self._emulator is not None:
            self._emulator.terminate()
            self._emulator.wait(20)
            self._emulator = None

    def drive(self, *flags, scenario=("auto_turn", *FLAGS), program=(PROGRAM,)):
        command = [*program, "drive", *scenario, "--ports", str(self.folder / "ports.json"), "--wiring", self.wiring]
        return subprocess.Popen(
            [*command, "--log", str(self.log), "--arm", *flags],
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def events(self, name):
        return [event for event in read_events(self.folder / "events.jsonl") if event["event"] == name]

    def record_watchdog_test(self):
        process = self.drive("--watchdog-test")
        out, err = process.communicate(timeout=60)
        assert process.returncode == 0, out + err


@pytest.fixture(params=WIRINGS)
def emulated(request, tmp_path):
    car = Emulated(tmp_path, request.param)
    yield car
    car.stop()


def finish(process):
    out, err = process.communicate(timeout=90)
    return process.returncode, out, err


def from_the_turn(log, before=0.5, after=2.5):
    """Times since the steering command at which the roll angle of the tail was sampled, and the angle.

    A row shows what stood on the ports before its tick: the command of the tick before, and in a drive's log the
    reading of the tick before; the age of a sample is on the status.
    """
    step = float(np.median(np.diff(log.time)))
    start = log.time[np.argmax(np.abs(log.signal("steering_command_rad")) > 0.1)] - step
    reading = step if "teensy_sent_time_s" in log.table.columns else 0.0
    time = log.time - start - reading - log.signal("status_tail_roll_age_s")
    inside = (time >= -before) & (time <= after)
    return time[inside], log.signal("tail_roll_angle_rad")[inside]


def rms_to(simulated, log):
    time, angle = from_the_turn(log)
    return float(np.sqrt(np.mean((angle - np.interp(time, *from_the_turn(simulated, 0.6, 2.6))) ** 2)))


def test_same_swing_and_outcome_as_in_simulation_and_a_log_that_everything_reads(emulated):
    emulated.start()
    emulated.record_watchdog_test()
    status, out, err = finish(emulated.drive())
    assert status == 0, out + err
    emulated.stop()
    trial = run_trial(load_scenario("auto_turn", SETTINGS), stop_when_flipped=False, signals="all")
    log, truth = read_run_log(emulated.log), read_run_log(emulated.folder / "truth.parquet")
    assert rms_to(trial.run_log, truth) <= 0.03
    assert rms_to(trial.run_log, log) <= 0.03
    outcome = metrics_of(truth).outcome
    assert outcome.result == trial.summary.metrics.outcome.result
    assert outcome.clean == trial.summary.metrics.outcome.clean
    assert [column.name for column in sensor_columns()] == list(log.table.columns)[: len(sensor_columns())]
    assert log.extra["stop_reason"] == "the run is over"
    assert np.all(log.signal("status_armed") == 1.0)
    metrics = metrics_of(log)
    expected = trial.summary.metrics.raw.max_yaw_rate_rad_per_s
    assert metrics.raw.max_yaw_rate_rad_per_s == pytest.approx(expected, rel=0.1)
    assert "plant_position_tail_tail_roll_q" in replayable(log).table.columns
    assert np.nanmedian(log.time - log.signal("teensy_sent_time_s")) < 0.03


def test_without_drake_from_a_bundle_the_car_swings_the_same(emulated, tmp_path):
    bundle = tmp_path / "bundle.json"
    subprocess.run([PROGRAM, "export", "auto_turn", *FLAGS, "--out", str(bundle)], check=True, capture_output=True)
    emulated.start()
    emulated.record_watchdog_test()
    program = (sys.executable, "-c", NO_DRAKE)
    status, out, err = finish(emulated.drive("--no-drake", scenario=(str(bundle),), program=program))
    assert status == 0, out + err
    simulated = run_trial(load_scenario("auto_turn", SETTINGS), stop_when_flipped=False, signals="all").run_log
    assert rms_to(simulated, read_run_log(emulated.log)) <= 0.03


def test_motors_are_not_armed_without_a_recorded_watchdog_test(emulated):
    emulated.start()
    status, _, err = finish(emulated.drive())
    assert status == 2
    assert "no watchdog test" in err.splitlines()[-1]
    assert not emulated.events("entered")


@pytest.mark.parametrize(("number", "expected"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_switches_everything_off_and_leaves_a_log(emulated, number, expected):
    emulated.start()
    emulated.record_watchdog_test()
    before = len(emulated.events("off"))
    process = emulated.drive()
    end = time.monotonic() + 60
    while not emulated.events("throttle_on") and time.monotonic() < end:
        time.sleep(0.02)
    time.sleep(1.0)
    sent = time.monotonic()
    process.send_signal(number)
    status, out, err = finish(process)
    assert status == expected, out + err
    off = emulated.events("off")[before:]
    neutral = emulated.events("throttle_neutral")[-1]
    assert {event["joint"] for event in off} == {"tail_pitch", "tail_roll"}
    assert all(event["reason"] == "exit frame" for event in off)
    assert max(event["time_s"] for event in [*off, neutral]) - sent < 0.2
    log = read_run_log(emulated.log)
    assert log.extra["stop_reason"] == signal.Signals(number).name
    assert log.signal("status_armed")[-1] == 0.0


def test_a_dry_run_reads_everything_and_moves_nothing(emulated):
    emulated.start()
    status, out, err = finish(emulated.drive("--dry-run"))
    assert status == 0, out + err
    assert not emulated.events("entered")
    assert not emulated.events("throttle_on")
    log = read_run_log(emulated.log)
    assert np.all(log.signal("status_armed") == 0.0)
    assert log.signal("throttle_command").max() > 0.2
    assert json.loads((emulated.folder / "ports.json").read_text())["schema"] == "aerodima/ports/1"
