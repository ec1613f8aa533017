"""`aerodima run --swing`: a swing file on the whole car."""

import numpy as np
import pytest

from aerodima.workbench.core.resources import model_path
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import (
    SwingFile,
    read_swing,
    swing_from_dict,
    write_swing,
)
from tests.commands import done
from tests.refusals import assert_named

SHORT = ("--set", "manoeuvre.duration=2.7", "--speed", "3.33")
NOISES = ("gyro_noise", "gyro_bias", "accelerometer_noise", "attitude_noise")
QUIET = tuple(word for noise in NOISES for word in ("--set", f"imu.{noise}=0"))
"""Noise has no mirror image, and moves the trigger by a tick."""


@pytest.mark.slow
def test_the_published_swing_is_played_and_mirrored_for_a_right_turn(tmp_path):
    """Left and right runs are exact mirror images but for rounding, from the trigger to the end of
    the swing.
    """
    logs = {}
    for side in ("left", "right"):
        log = tmp_path / f"{side}.parquet"
        words = ("--swing", "thesis_8_rad_per_s", "--direction", side, "--out", log)
        done("run", *words, *SHORT, *QUIET)
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
def test_a_swing_for_another_car_needs_to_be_asked_for(refused, tmp_path):
    thesis = read_swing(model_path("swings/thesis_8_rad_per_s.yaml"))
    path = write_swing(
        SwingFile.model_validate(thesis.model_dump() | {"car": {"car.mass": 7.0}}),
        tmp_path / "a.yaml",
    )
    message = refused("run", "--swing", path, *SHORT)
    mass = load_scenario("turn_swing").car.mass
    assert_named(message, ("car.mass", "7", f"{mass:g}", "--other-car"))
    done("run", "--swing", path, "--other-car", *SHORT)


def test_what_makes_no_sense_is_refused(refused, tmp_path):
    assert "--swing" in refused("run", "turn_swing", "--other-car")
    assert "thesis_8_rad_per_s" in refused("run", "--swing", "nowhere")
    text = model_path("swings/thesis_8_rad_per_s.yaml").read_text()
    (tmp_path / "nan.yaml").write_text(text.replace("[8.0, 8.0, 0.0]", "[8.0, .nan, 0.0]"))
    assert "knots.roll_velocity_rad_per_s.1: nan" in refused(
        "run", "--swing", tmp_path / "nan.yaml"
    )
