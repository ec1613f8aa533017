"""The whole way on the emulated car: command line, real byte streams, both wirings, against the
simulation.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from aerodima.hardware.car.wiring import WIRINGS
from aerodima.hardware.driving.watchdog_test import run_watchdog_test
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.signal_table import sensor_columns
from aerodima.workbench.view.dead_reckoning import replayable
from tests.hardware.emulator.emulator_process import EmulatorProcess, undisturbed
from tests.notebook_runs import FOLDER, definitions

pytestmark = [pytest.mark.emulated, pytest.mark.slow]

SOURCE = definitions(FOLDER / "06_from_simulation_to_the_car.ipynb")
"""The swerve of the notebook, with the diagram that drives it."""
NOTEBOOK: dict[str, Any] = {}
exec(SOURCE, NOTEBOOK)
SCENARIO = NOTEBOOK["SCENARIO"]
FLAGS = [word for setting in NOTEBOOK["SETTINGS"] for word in ("--set", setting)]
DRIVES = 10
"""Simulated swerves, with as many seeds of the noise."""
PROGRAM = str(Path(sys.executable).with_name("aerodima"))


class Emulated(EmulatorProcess):
    """An emulator, and the command that drives on it."""

    def __init__(self, folder, wiring):
        super().__init__(folder, SCENARIO, wiring)
        self.log = folder / "drive.parquet"

    def drive(self, *flags, command="run", scenario=("swerve", *FLAGS), program=(PROGRAM,)):
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
    seeds = range(1, DRIVES + 1)
    return [simulate(SCENARIO.varied(seed=seed), build=NOTEBOOK["build"]) for seed in seeds]


def finish(process):
    out, err = process.communicate(timeout=90)
    return process.returncode, out, err


def driven(folder, wiring, *flags, **how):
    """A whole drive of the sequence; the ended emulator."""
    with Emulated(folder, wiring) as emulated:
        emulated.record_watchdog_test()
        status, out, err = finish(emulated.drive(*flags, **how))
        assert status == 0, out + err
    return emulated


@each_wiring
def test_swerve_is_the_simulated_one_and_its_log_is_one_that_everything_reads(
    tmp_path, wiring, simulated
):
    figures_of = NOTEBOOK["figures_of"]
    planned = pd.DataFrame(map(figures_of, simulated)).mean()

    def same_swerve(folder):
        diagram = folder / "swerve.py"
        diagram.write_text(SOURCE, encoding="utf-8")
        emulated = driven(folder, wiring, "--diagram", f"{diagram}:build")
        log = read_run_log(emulated.log)
        figures = figures_of(log)
        for name, band in NOTEBOOK["BAND"].items():
            assert figures[name] == pytest.approx(planned[name], abs=band), (name, figures)
        return log, read_run_log(emulated.folder / "truth.parquet")

    log, truth = undisturbed(same_swerve, tmp_path)
    outcome, *expected = (metrics_of(run).outcome.result for run in (truth, *simulated))
    assert {outcome} == set(expected)
    assert [column.name for column in sensor_columns()] == list(log.table.columns)[
        : len(sensor_columns())
    ]
    assert log.extra["stop_reason"] == "the run is over"
    assert np.all(log.signal("status_armed") == 1.0)
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
