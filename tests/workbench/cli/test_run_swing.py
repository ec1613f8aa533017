"""`aerodima run --swing`: a swing file on the whole car."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.swing_file import SwingFile, read_swing, swing_from_dict, write_swing
from aerodima.workbench.controllers.swing_law import SwingState
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.resources import model_path
from aerodima.workbench.simulate.simulation import simulate

SHORT = ("--set", "manoeuvre.duration=2.7", "--speed", "3.33")
NOISES = ("gyro_noise", "gyro_bias", "accelerometer_noise", "attitude_noise")
QUIET = tuple(word for noise in NOISES for word in ("--set", f"imu.{noise}=0"))
"""Noise has no mirror image, and moves the trigger by a tick."""
COMMANDED = ("command_position_rad", "command_velocity_rad_per_s")


@pytest.mark.slow
def test_the_published_swing_is_played_and_mirrored_for_a_right_turn(
    call: Callable, tmp_path: Path
) -> None:
    """Left and right runs are exact mirror images but for rounding, from the trigger to the end of
    the swing.
    """
    logs = {}
    for side in ("left", "right"):
        log = tmp_path / f"{side}.parquet"
        result = call(
            "run",
            "--swing",
            "thesis_8_rad_per_s",
            "--direction",
            side,
            "--out",
            log,
            *SHORT,
            *QUIET,
        )
        assert result.exit_code == 0, result.output
        logs[side] = read_run_log(log)
    assert swing_from_dict(logs["left"].extra["swing"]) == read_swing(
        model_path("swings/thesis_8_rad_per_s.yaml")
    )
    left, right = (logs[side].signal("tail_roll_angle_rad") for side in ("left", "right"))
    assert left[0] < -1.5
    assert left[-1] > 1.0
    np.testing.assert_allclose(left, -right, atol=1e-6)
    assert np.max(logs["left"].signal("tail_roll_command_velocity_rad_per_s")) == 8.0


@pytest.mark.slow
def test_torque_of_a_braking_swing_steps_with_the_ticks_of_its_commands() -> None:
    """100 Hz: position and rate of the curve are held for 10 ms, and the motor's gains answer each
    new pair at once.

    A quarter is left for what the tail itself does between two rows, 2 ms apart.
    """
    settings = [
        "controller.swing_file=thesis_8_rad_per_s",
        "manoeuvre.speed=4.44",
        "manoeuvre.duration=2.7",
    ]
    log = simulate(load_scenario("turn_swing", settings))
    swinging = log.time[log.signal("controller_state") == SwingState.SWING]
    braking = slice(*np.searchsorted(log.time, swinging[0] + np.array([0.32, 0.42])))
    rows = [
        np.diff(log.signal(f"tail_roll_{name}"))[braking] for name in ("torque_n_m", *COMMANDED)
    ]
    gains = [log.signal(f"tail_roll_command_{name}")[braking] for name in ("kp", "kd")]
    asked = gains[0] * rows[1] + gains[1] * rows[2]
    ticks = np.abs(asked) > 1e-9
    assert np.count_nonzero(ticks) == 10
    assert np.all(asked[ticks] < -0.3)
    np.testing.assert_allclose(rows[0][ticks], asked[ticks], rtol=0.25)
    assert np.max(np.abs(rows[0][~ticks])) < 0.5 * np.min(np.abs(rows[0][ticks]))


@pytest.mark.slow
def test_a_swing_for_another_car_needs_to_be_asked_for(
    call: Callable, refused: Callable, tmp_path: Path
) -> None:
    thesis = read_swing(model_path("swings/thesis_8_rad_per_s.yaml"))
    path = write_swing(
        SwingFile.model_validate(thesis.model_dump() | {"car": {"car.mass": 7.0}}),
        tmp_path / "a.yaml",
    )
    message = refused("run", "--swing", path, *SHORT)
    mass = load_scenario("turn_swing").car.mass
    assert (
        f"car.mass: made for 7, the scenario has {mass:g}; allowed: the same car, or --other-car"
        in message
    )
    assert call("run", "--swing", path, "--other-car", *SHORT).exit_code == 0


def test_what_makes_no_sense_is_refused(refused: Callable, tmp_path: Path) -> None:
    assert "--other-car: allowed together with --swing" in refused(
        "run", "turn_swing", "--other-car"
    )
    unknown = refused("run", "--swing", "nowhere")
    assert "models/swings has none of this name; allowed: thesis_8_rad_per_s" in unknown
    text = model_path("swings/thesis_8_rad_per_s.yaml").read_text()
    (tmp_path / "nan.yaml").write_text(text.replace("[8.0, 8.0, 0.0]", "[8.0, .nan, 0.0]"))
    assert "knots.roll_velocity_rad_per_s.1: nan" in refused(
        "run", "--swing", tmp_path / "nan.yaml"
    )
