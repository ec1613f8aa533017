"""The whole way on the emulated car: command line, real byte streams, both wirings, against the
simulation.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from aerodima.hardware.car.wiring import WIRINGS
from aerodima.hardware.driving.watchdog_test import run_watchdog_test
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import sensor_columns
from aerodima.workbench.view.dead_reckoning import replayable
from tests.hardware.emulator.emulator_process import EmulatorProcess, undisturbed

pytestmark = [pytest.mark.emulated, pytest.mark.slow]

SETTINGS = [
    "drive.governor=true",  # at its speed in a second, where the open-loop car takes a dozen
    # The car's throttle comes on at a limited rate, the simulated one's at once: after ten seconds
    # both are as fast.
    "manoeuvre.speed=2.0",  # at that of the parameter files it tips over, and the drive stops it
    "manoeuvre.straight_time=10",
    "manoeuvre.log_end=13",
    # Both events of the swing come well after a tick of the simulation's controller, so that
    # readings that are some milliseconds older show them at the same tick or at the next one: a
    # tick more or less is 0.08 rad of the swing.
    "controller.trigger_yaw_rate=0.297",
    "controller.travel=2.225",
    "servo.frame_rate=250",  # frames of 100 Hz begin at any time within a tick of the drive
    # half the load of a step of 2 ms for a machine that runs car and drive
    "simulation.step=0.004",
    "simulation.log_rate=250",
]
FLAGS = [word for setting in SETTINGS for word in ("--set", setting)]
SCENARIO = load_scenario("auto_turn", SETTINGS)
PROGRAM = str(Path(sys.executable).with_name("aerodima"))


class Emulated(EmulatorProcess):
    """An emulator, and the command that drives on it."""

    def __init__(self, folder, wiring):
        super().__init__(folder, SCENARIO, wiring)
        self.log = folder / "drive.parquet"

    def drive(self, *flags, command="run", scenario=("auto_turn", *FLAGS), program=(PROGRAM,)):
        log = ["--out", str(self.log)]
        more = {"run": ["--arm", *log], "check": log, "watchdog-test": ["--arm"]}[command]
        car = ["--ports", str(self.folder / "ports.json"), "--wiring", self.wiring]
        return subprocess.Popen(
            [*program, "drive", command, *scenario, *car, *more, *flags],
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def record_watchdog_test(self):
        """As `aerodima drive watchdog-test` does it."""
        run_watchdog_test(SCENARIO, self.ports, self.wiring, lambda _: True, "emulator")


each_wiring = pytest.mark.parametrize("wiring", WIRINGS)


@pytest.fixture(scope="module")
def simulated():
    return simulate(SCENARIO)


def finish(process):
    out, err = process.communicate(timeout=90)
    return process.returncode, out, err


def from_the_turn(log, before=0.5, after=2.5):
    """Times since the steering command at which the roll angle of the tail was sampled, and the
    angle.

    A row shows what stood on the ports before its tick: the command of the tick before, and in a
    drive's log the reading of the tick before; the age of a sample is on the status.
    """
    step = float(np.median(np.diff(log.time)))
    start = log.time[np.argmax(np.abs(log.signal("steering_command_rad")) > 0.1)] - step
    reading = step if "teensy_sent_time_s" in log.table.columns else 0.0
    time = log.time - start - reading - log.signal("status_tail_roll_age_s")
    inside = (time >= -before) & (time <= after)
    return time[inside], log.signal("tail_roll_angle_rad")[inside]


def rms_to(simulated, log):
    time, angle = from_the_turn(log)
    return float(
        np.sqrt(np.mean((angle - np.interp(time, *from_the_turn(simulated, 0.6, 2.6))) ** 2))
    )


def driven(folder, wiring, *flags, **how):
    """A whole drive of the sequence; the ended emulator."""
    with Emulated(folder, wiring) as emulated:
        emulated.record_watchdog_test()
        status, out, err = finish(emulated.drive(*flags, **how))
        assert status == 0, out + err
    return emulated


@each_wiring
def test_same_swing_and_outcome_as_in_simulation_and_a_log_that_everything_reads(
    tmp_path, wiring, simulated
):
    def same_swing(folder):
        emulated = driven(folder, wiring)
        log = read_run_log(emulated.log)
        truth = read_run_log(emulated.folder / "truth.parquet")
        found = rms_to(simulated, truth), rms_to(simulated, log)
        assert max(found) <= 0.03, found
        return log, truth

    log, truth = undisturbed(same_swing, tmp_path)
    outcome, planned = (metrics_of(run).outcome for run in (truth, simulated))
    assert outcome.result == planned.result
    assert outcome.max_tilt_rad == pytest.approx(planned.max_tilt_rad, abs=0.05)
    assert [column.name for column in sensor_columns()] == list(log.table.columns)[
        : len(sensor_columns())
    ]
    assert log.extra["stop_reason"] == "the run is over"
    assert np.all(log.signal("status_armed") == 1.0)
    metrics = metrics_of(log)
    expected = summarise(simulated, SCENARIO.name).metrics.raw.max_yaw_rate_rad_per_s
    assert metrics.raw.max_yaw_rate_rad_per_s == pytest.approx(expected, rel=0.1)
    assert "plant_position_tail_tail_roll_q" in replayable(log).table.columns
    assert np.nanmedian(log.time - log.signal("teensy_sent_time_s")) < 0.03


@each_wiring
def test_motors_are_not_armed_without_a_recorded_watchdog_test_and_a_dry_run_moves_nothing(
    tmp_path, wiring
):
    with Emulated(tmp_path, wiring) as emulated:
        status, _, err = finish(emulated.drive())
        assert status == 2
        assert wiring in err.splitlines()[-1]
        assert not emulated.named("entered")
        status, out, err = finish(emulated.drive(command="check"))
        assert status == 0, out + err
        assert not emulated.named("entered")
        assert not emulated.named("throttle_on")
    log = read_run_log(emulated.log)
    assert np.all(log.signal("status_armed") == 0.0)
    assert log.signal("throttle_command").max() > 0.2


@each_wiring
def test_the_command_makes_the_watchdog_test(tmp_path, wiring):
    def recorded(folder):
        with Emulated(folder, wiring) as emulated:
            status, out, err = finish(emulated.drive(command="watchdog-test"))
            assert status == 0, out + err
            assert {event["joint"] for event in emulated.named("off")} == {
                "tail_pitch",
                "tail_roll",
            }

    undisturbed(recorded, tmp_path)
