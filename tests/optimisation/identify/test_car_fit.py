"""A car from the log of its own drive: what is refused, what is used, and whether the truth lies in
the intervals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from aerodima.optimisation.identify.car_fit import fit_car
from aerodima.optimisation.identify.car_log import TAIL, CarDrive, LoggedCommands, car_drive
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import RunLog, write_run_log
from tests.optimisation.car_coverage import UNKNOWNS
from tests.optimisation.identify.car_truth import drawn, emulated


def still_log(steered: float = 0.5, **columns: float) -> RunLog:
    """A log without motion of the first 4 s of `turn_none`, steered from 2.0 to 2.5 s."""
    scenario = load_scenario("turn_none")
    time = np.arange(0.0, 4.0, 0.002)
    table = pd.DataFrame(
        {"time_s": time, "steering_command_rad": steered * ((time >= 2.0) & (time < 2.5))}
    )
    zeros = [
        "planned_turn",
        "imu_roll_rad",
        "imu_pitch_rad",
        "imu_gyro_x_rad_per_s",
        "imu_gyro_z_rad_per_s",
    ]
    table[[*zeros, "imu_acceleration_y_m_per_s2"]] = 0.0
    table = table.assign(**{"throttle_command": 0.35, "speed_m_per_s": 3.3, **columns})
    for source, rate in (("imu", 100.0), ("speed", 10.0)):
        table[f"status_{source}_age_s"] = time - np.floor(time * rate + 1e-6) / rate
    return RunLog(table, scenario.resolved(), 1, source="run.parquet")


def changed(**columns: Callable[[pd.DataFrame], Any]) -> RunLog:
    log = still_log()
    return replace(log, table=log.table.assign(**columns))


REFUSED: dict[str, tuple[Callable[[], RunLog], str]] = {
    "rig": (
        lambda: replace(still_log(), kind="swing"),
        "is a log of kind 'swing'; this fit needs a drive of the car",
    ),
    "straight": (
        lambda: still_log(0.0),
        "column 'steering_command_rad' stays within 0.01 rad; a fit needs a turn",
    ),
    "nan": (
        lambda: changed(
            imu_gyro_z_rad_per_s=lambda table: np.where(
                table.time_s == table.time_s[1100], math.nan, 0.0
            )
        ),
        r"column 'imu_gyro_z_rad_per_s': 1 sample\(s\) not finite, first nan at 2.2 s",
    ),
    "no IMU": (
        lambda: replace(still_log(), table=still_log().table.drop(columns="imu_gyro_x_rad_per_s")),
        "no column 'imu_gyro_x_rad_per_s'",
    ),
    "slow GPS": (
        lambda: changed(status_speed_age_s=lambda table: table.time_s % 1.0),
        "only 2 samples of 'speed_m_per_s' around the turn; a fit needs 5",
    ),
    "at rest": (
        lambda: still_log(throttle_command=0.0),
        "column 'throttle_command' drives the car at 0 m/s into",
    ),
    "cut": (
        lambda: replace(
            still_log(), table=still_log().table.query("time_s > 1.9 and time_s < 2.1")
        ),
        "holds 1.9 to 2.098 s, steered from 2 s on; a fit needs 0.5 s to either side",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_log_that_cannot_be_fitted_is_refused_in_one_line(case: str) -> None:
    make, message = REFUSED[case]
    with pytest.raises(UserError, match=f"^run.parquet: {message}"):
        car_drive(make())


def test_of_a_flipped_run_what_is_before_the_flip_is_used() -> None:
    drive = car_drive(changed(imu_roll_rad=lambda table: np.where(table.time_s < 2.4, 0.0, 1.2)))
    assert drive.warnings == ("the car leans beyond 0.8 rad at 2.4 s; samples until then are used",)
    assert max(channel.time[-1] for channel in drive.channels.values()) <= 2.4


@pytest.mark.parametrize(("stop", "cut"), [(math.pi / 2, True), (3.1416, False)])
def test_a_swung_log_ends_at_the_stop_of_the_tail_not_at_the_limit_of_its_command(
    stop: float, cut: bool
) -> None:
    log = still_log()
    scenario = load_scenario("turn_swing", [f"tail.roll_stop={stop}"])
    angle = np.interp(log.table["time_s"], [2.0, 2.3], [-math.pi / 2, math.pi / 2])
    columns = dict.fromkeys((name for joint in TAIL.values() for name in joint), 0.0) | {
        "tail_roll_angle_rad": angle
    }
    found = car_drive(replace(log, table=log.table.assign(**columns), scenario=scenario.resolved()))
    assert any("strikes its stop" in warning for warning in found.warnings) == cut


def test_commands_are_held_and_steering_alone_is_late() -> None:
    time = np.array([1.0, 1.1, 1.2])
    driver = np.array([[0.0, 0.3, 0.0], [0.1, 0.2, 0.3], [1.0, 1.0, 1.0]])
    commands = LoggedCommands(time, driver, np.zeros((2, 3, 5)), 100.0, begin=1.0, latency=0.05)
    assert commands.at(0.12) == (0.0, 0.2, 1.0)
    assert commands.at(0.15) == (0.3, 0.2, 1.0)


class Formula(CarDrive):
    """A drive whose car is a formula in place of a simulation, as rough as one; its height shows
    nowhere.
    """

    def run(
        self, changes: Mapping[str, Mapping[str, float]], latency: float, speed: float
    ) -> Mapping[str, Any]:
        time = np.arange(1.4, 3.2, 0.002)
        car = changes["car"]
        late = time - self.turn - latency
        turning = np.clip(late / 0.2, 0.0, 1.0)
        begins = np.exp(-np.square((late - 0.2) / 0.1))
        rough = 2e-4 * np.sign(math.sin(2e5 * car["tyre_friction"])) * turning
        gain = 1.0 - math.exp(-3.0 * (time[-1] - time[0]))
        return {
            "time": time,
            "yaw_rate": 3.0 * car["tyre_friction"] * turning
            - 2.0 * car["tyre_slip_angle"] * begins
            + rough,
            "roll_rate": 5.0 * car["tyre_slip_angle"] * begins + rough,
            "lateral_acceleration": 7.0 * car["tyre_friction"] * turning + rough,
            "speed": speed + gain * (changes["manoeuvre"]["speed"] - speed) * (time > self.turn),
        }


def test_a_rough_cost_settles_and_what_the_log_does_not_show_is_named() -> None:
    base = car_drive(still_log())
    drive = Formula(**{name: getattr(base, name) for name in base.__dataclass_fields__})
    truth = {"tyre_friction": 0.61, "tyre_slip_angle": 0.12}
    run = drive.run({"car": truth, "manoeuvre": {"speed": 3.2}}, 0.0, 3.0)
    noise = np.random.default_rng(5)
    channels = {
        name: replace(channel, value=value + noise.normal(0.0, 0.3, value.size) * channel.deviation)
        for (name, value), channel in zip(
            drive.sampled(run, 0.03).items(), drive.channels.values(), strict=True
        )
    }
    found = fit_car(replace(drive, channels=channels))
    assert found.success, found.status
    assert found.warnings == (
        "the log does not determine com_height; its interval is that of the prior",
    )
    assert all(found[name].holds(value) for name, value in (truth | {"delay": 0.03}).items())
    assert found["com_height"].upper - found["com_height"].lower > 0.2


@pytest.mark.slow
def test_the_truth_lies_in_the_intervals() -> None:
    """One drive of `car_coverage`, its fifth."""
    truth = drawn(4)
    found = fit_car(car_drive(emulated(truth)))
    assert found.success
    assert {name: found[name].holds(truth.values[name]) for name in UNKNOWNS} == dict.fromkeys(
        UNKNOWNS, True
    )
    assert found["tyre_friction"].upper - found["tyre_friction"].lower < 0.03
    assert not found.warnings


def test_settings_are_refused_before_any_log_is_read(tmp_path: Path) -> None:
    write_run_log(replace(still_log(), kind="other"), tmp_path / "run.parquet")
    arguments = ["fit", "car", str(tmp_path / "run.parquet"), "--out", str(tmp_path / "fits")]
    done = CliRunner().invoke(build_app(), [*arguments, "--set", "car.mas=6"])
    assert done.exit_code == 2
    assert done.stderr.splitlines() == [
        "error: scenario: car.mas: unknown key; did you mean 'mass'?"
    ]
    assert not (tmp_path / "fits").exists()
    done = CliRunner().invoke(build_app(), [*arguments, "--workers", "1"])
    assert done.exit_code == 2
    assert "is a log of kind 'other'; this fit needs a drive of the car, 'car_run'" in done.stderr
