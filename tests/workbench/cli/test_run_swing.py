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


@pytest.mark.slow
@pytest.mark.parametrize(("direction", "side"), [("left", 1.0), ("right", -1.0)])
def test_the_published_swing_is_played_to_the_outside_of_the_turn(tmp_path, direction, side):
    path = tmp_path / "run.parquet"
    words = ("--swing", "thesis_8_rad_per_s", "--direction", direction, "--out", path)
    done("run", *words, *SHORT)
    log = read_run_log(path)
    assert swing_from_dict(log.extra["swing"]) == read_swing(
        model_path("swings/thesis_8_rad_per_s.yaml")
    )
    roll = side * log.signal("tail_roll_angle_rad")
    assert roll[0] < -1.5
    assert roll[-1] > 1.0
    assert np.max(side * log.signal("tail_roll_command_velocity_rad_per_s")) == 8.0


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
    message = refused("run", "turn_swing", "--swing", "thesis_8_rad_per_s", "--tail", "held")
    assert_named(message, ("--swing thesis_8_rad_per_s", "--tail swing"))
    assert "thesis_8_rad_per_s" in refused("run", "--swing", "nowhere")
    text = model_path("swings/thesis_8_rad_per_s.yaml").read_text()
    (tmp_path / "nan.yaml").write_text(text.replace("[8.0, 8.0, 0.0]", "[8.0, .nan, 0.0]"))
    assert "knots.roll_velocity_rad_per_s.1: nan" in refused(
        "run", "--swing", tmp_path / "nan.yaml"
    )
