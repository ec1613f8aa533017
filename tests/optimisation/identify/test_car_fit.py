"""A car from the log of its own drive: what is refused, what is used, and whether the truth lies in the intervals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from aerodima.optimisation.identify.car_fit import MISFIT, fit_car
from aerodima.optimisation.identify.car_log import CarDrive, LoggedCommands, car_drive
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import RunLog, write_run_log
from tests.optimisation.car_coverage import UNKNOWNS
from tests.optimisation.identify.car_truth import drawn, emulated


def still_log(steered: float = 0.5, **columns: float) -> RunLog:
    """A log without motion of the first 4 s of `turn_none`, steered from 2.0 to 2.5 s."""
    scenario, time = load_scenario("turn_none"), np.arange(0.0, 4.0, 0.002)
    table = pd.DataFrame({"time_s": time, "steering_command_rad": steered * ((time >= 2.0) & (time < 2.5))})
    zeros = ["planned_turn", "imu_roll_rad", "imu_pitch_rad", "imu_gyro_x_rad_per_s", "imu_gyro_z_rad_per_s"]
    table[[*zeros, "imu_acceleration_y_m_per_s2"]] = 0.0
    table = table.assign(**{"throttle_command": 0.35, "speed_m_per_s": 3.3, **columns})
    for source, rate in (("imu", 100.0), ("speed", 10.0)):
        table[f"status_{source}_age_s"] = time - np.floor(time * rate + 1e-6) / rate
    return RunLog(table, scenario.resolved(), 1, source="run.parquet")


def with_nan(log: RunLog, column: str, time: float) -> RunLog:
    table = log.table.copy()
    table.loc[np.argmin(np.abs(log.time - time)), column] = math.nan
    return replace(log, table=table)


REFUSED: dict[str, tuple[Callable[[], RunLog], str]] = {
    "rig": (lambda: replace(still_log(), kind="swing"), "is a log of kind 'swing'; this fit needs a drive of the car"),
    "straight": (lambda: still_log(0.0), "column 'steering_command_rad' stays within 0.01 rad; a fit needs a turn"),
    "nan": (
        lambda: with_nan(still_log(), "imu_gyro_z_rad_per_s", 2.2),
        r"column 'imu_gyro_z_rad_per_s': 1 sample\(s\) not finite, first nan at 2.2 s",
    ),
    "no IMU": (
        lambda: replace(still_log(), table=still_log().table.drop(columns="imu_gyro_x_rad_per_s")),
        "no column 'imu_gyro_x_rad_per_s'",
    ),
    "silent IMU": (
        lambda: still_log(imu_acceleration_y_m_per_s2=math.nan),
        "column 'imu_acc.* not finite, first nan",
    ),
    "coasting": (lambda: still_log(throttle_command=0.0), "column 'throttle_command' drives the car at 0 m/s into the turn"),
    "cut": (
        lambda: replace(still_log(), table=still_log().table.query("time_s > 1.9 and time_s < 2.1")),
        "holds 1.9 to 2.098 s, steered from 2 s on; a fit needs 0.8 s to either side",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_log_that_cannot_be_fitted_is_refused_in_one_line(case: str) -> None:
    make, message = REFUSED[case]
    with pytest.raises(UserError, match=f"^run.parquet: {message}"):
        car_drive(make())


def test_of_a_flipped_run_what_is_before_the_flip_is_used() -> None:
    log = still_log()
    drive = car_drive(replace(log, table=log.table.assign(imu_roll_rad=np.where(log.time < 2.4, 0.0, 1.2))))
    assert drive.warnings == ("the car leans beyond 0.8 rad at 2.4 s; samples until then are used",)
    assert max(channel.time[-1] for channel in drive.channels.values()) <= 2.4
    assert car_drive(log).warnings == ()


def test_every_sample_counts_once_and_on_the_straight_with_the_noise_of_its_sensor_alone() -> None:
    channel = car_drive(still_log()).channels["yaw_rate"]
    assert np.allclose(np.diff(channel.time), 0.01)
    imu = load_scenario("turn_none").imu
    assert np.allclose(channel.deviation, math.hypot(imu.gyro_noise, 1.0 / 900.0 / math.sqrt(12.0)))


def test_commands_are_held_and_steering_alone_is_late() -> None:
    time = np.array([1.0, 1.1, 1.2])
    driver = np.array([[0.0, 0.3, 0.0], [0.1, 0.2, 0.3], [1.0, 1.0, 1.0]])
    commands = LoggedCommands(time, driver, np.zeros((2, 3, 5)), 100.0, begin=1.0, latency=0.05)
    assert commands.at(0.12) == (0.0, 0.2, 1.0)
    assert commands.at(0.15) == (0.3, 0.2, 1.0)
    assert replace(commands, latency=0.0).at(0.1) == (0.3, 0.2, 1.0)


@pytest.fixture(scope="module")
def drive() -> tuple[CarDrive, dict[str, float]]:
    truth = drawn(4)
    return car_drive(emulated(truth)), truth.values


def test_the_model_is_the_car_that_made_the_log() -> None:
    """With the truth and the step of the log only noise is left: the commands are played as they acted."""
    truth = drawn(4)
    found = car_drive(emulated(truth, step=0.002))
    car = {name: truth.values[name] for name in ("tyre_friction", "tyre_slip_angle", "com_height")}
    motion = found.motion({"car": car}, round(truth.values["delay"] / 0.002) * 0.002)
    late = truth.values["delay"] - round(truth.values["delay"] / 0.002) * 0.002
    assert abs(late) <= 0.001
    for name, channel in found.channels.items():
        bias = truth.values["gyro_bias_z"] if name == "yaw_rate" else 0.0
        off = (channel.value - bias - motion[name]) / channel.deviation
        assert np.sqrt(np.mean(np.square(off))) < 1.5, name


@pytest.mark.slow
def test_the_truth_lies_in_the_intervals(drive: tuple[CarDrive, dict[str, float]]) -> None:
    """One drive of `car_coverage`, its fifth."""
    log, truth = drive
    found = fit_car(log)
    assert found.success
    assert {name: found[name].holds(truth[name]) for name in UNKNOWNS} == dict.fromkeys(UNKNOWNS, True)
    widths = {name: found[name].upper - found[name].lower for name in UNKNOWNS}
    assert widths["tyre_friction"] < 0.03
    assert widths["com_height"] < 0.02
    assert all(found.facts[f"misfit_{name}"] < MISFIT for name in log.channels)


def test_settings_are_refused_before_any_log_is_read(tmp_path: Path) -> None:
    write_run_log(replace(still_log(), kind="other"), tmp_path / "run.parquet")
    arguments = ["fit", "car", str(tmp_path / "run.parquet"), "--out", str(tmp_path / "fits")]
    done = CliRunner().invoke(build_app(), [*arguments, "--set", "car.mas=6"])
    assert done.exit_code == 2
    assert done.stderr.splitlines() == ["error: scenario: car.mas: unknown key; did you mean 'mass'?"]
    assert not (tmp_path / "fits").exists()
    done = CliRunner().invoke(build_app(), [*arguments, "--workers", "1"])
    assert done.exit_code == 2
    assert "is a log of kind 'other'; this fit needs a drive of the car, 'car_run'" in done.stderr
