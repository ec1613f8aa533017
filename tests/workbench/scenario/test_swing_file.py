import copy
import math

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.core.errors import SwingFileError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.swing_file import (
    car_mismatches,
    gains_at,
    read_swing,
    swing_at,
    swing_from_dict,
    write_swing,
)
from tests.refusals import assert_named, assert_refused

THESIS = "swings/thesis_8_rad_per_s.yaml"


def thesis_data():
    return yaml.safe_load(model_path(THESIS).read_text())


def changed(key, value):
    """The thesis' swing as data with one value changed; `key` is dotted, None removes it."""
    data = copy.deepcopy(thesis_data())
    *path, last = key.split(".")
    place = data
    for part in path:
        place = place[int(part)] if isinstance(place, list) else place[part]
    if value is None:
        del place[last]
    else:
        place[int(last) if isinstance(place, list) else last] = value
    return data


def test_the_thesis_swing_travels_130_degrees_at_8_rad_per_s_and_settles_outside():
    """Table 6.4 with ERRATA E28, for a left turn: from the left (-90 degrees) over the top to the
    right (+90).
    """
    swing = read_swing(model_path(THESIS))
    assert (swing.direction, swing.trigger.threshold_rad_per_s, swing.trigger.delay_s) == (
        "left",
        1.0,
        0.0,
    )
    travel = math.radians(130.0)
    during = np.linspace(0.0, travel / 8.0, 50)
    point = swing_at(swing, during)
    assert_allclose(point.roll_position, -math.pi / 2 + 8.0 * during, atol=1e-9)
    assert_allclose(point.roll_velocity, 8.0, atol=1e-9)
    end = swing_at(swing, 3.0)
    assert (float(end.roll_position), float(end.roll_velocity)) == (pytest.approx(math.pi / 2), 0.0)
    assert float(swing_at(swing, -1.0).roll_position) == pytest.approx(-math.pi / 2)
    assert not np.any(point.pitch_position)
    assert swing.car == {}


def test_the_thesis_gains_follow_the_phases_of_the_table():
    swing = read_swing(model_path(THESIS))
    travelled = math.radians(130.0) / 8.0
    assert [(g.kp, g.kd) for g in (gains_at(swing, t)[0] for t in (-0.01, 0.0, 0.28, travelled,
    2.0))] == [
        (17.0, 5.0), (0.0, 3.0), (0.0, 3.0), (5.0, 2.0), (5.0, 2.0),
    ]  # fmt: skip


def test_the_other_direction_mirrors_roll_and_keeps_pitch():
    data = changed("knots.pitch_position_rad", [0.0, 0.2, 0.1])
    data["knots"]["roll_torque_n_m"] = [1.0, 2.0, 0.0]
    data["knots"]["pitch_torque_n_m"] = [0.5, 0.5, 0.5]
    swing = swing_from_dict(data)
    t = np.linspace(-0.1, 0.6, 36)
    left = swing_at(swing, t, "left")
    right = swing_at(swing, t, "right")
    assert_array_equal(right.roll_position, -left.roll_position)
    assert_array_equal(right.roll_velocity, -left.roll_velocity)
    assert_array_equal(right.roll_torque, -left.roll_torque)
    assert_array_equal(right.pitch_position, left.pitch_position)
    assert_array_equal(right.pitch_torque, left.pitch_torque)
    assert_array_equal(swing_at(swing, t).roll_position, left.roll_position)
    assert left.roll_torque[10] > 0


def test_a_cubic_is_met_exactly_and_the_rate_is_its_derivative():
    t = np.array([0.0, 0.1, 0.35, 0.4])
    cubic = np.polynomial.Polynomial([-1.0, 2.0, 5.0, -9.0])
    slope = cubic.deriv()
    data = thesis_data()
    data["knots"] = {
        "time_s": t.tolist(),
        "roll_position_rad": cubic(t).tolist(),
        "roll_velocity_rad_per_s": slope(t).tolist(),
        "pitch_position_rad": [0.0] * 4,
        "pitch_velocity_rad_per_s": [0.0] * 4,
    }
    fine = np.linspace(0.0, 0.4, 97)
    point = swing_at(swing_from_dict(data), fine)
    assert_allclose(point.roll_position, cubic(fine), atol=1e-12)
    assert_allclose(point.roll_velocity, slope(fine), atol=1e-11)


def test_what_is_written_comes_back_equal_and_is_not_overwritten(tmp_path):
    data = changed("car", {"car.mass": 6.1, "tail.length": 0.9})
    swing = swing_from_dict(data)
    path = write_swing(swing, tmp_path / "new" / "swing.yaml")
    assert read_swing(path) == swing
    assert_refused(lambda: write_swing(swing, path), SwingFileError, str(path))
    write_swing(swing, path, force=True)
    (tmp_path / "file").write_text("")
    below = tmp_path / "file" / "swing.yaml"
    assert_refused(lambda: write_swing(swing, below), SwingFileError, str(tmp_path / "file"))


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("schema", "aerodima/swing/2", ("aerodima/swing/2", "aerodima/swing/1")),
        ("direction", "up", ("'up'", "'left'", "'right'")),
        ("knots.time_s", [0.0, 0.3, 0.3], ("knots.time_s.2", "0.3")),
        ("knots.time_s", [0.1, 0.3, 0.5], ("0.1",)),
        ("knots.time_s.1", float("nan"), ("nan",)),
        ("knots.roll_velocity_rad_per_s", [8.0, 0.0], ("2", "3")),
        ("knots.roll_position_rad.0", "-90 deg", ("'-90 deg'",)),
        ("knots.roll_position_rad.2", 90.0, ("90.0", "1.5708")),
        ("knots.roll_velocity_rad_per_s.0", 9.0, ("9.0", "8")),
        ("knots.roll_torque_n_m", [0.0, 25.0, 0.0], ("knots.roll_torque_n_m.1", "25.0", "24.8")),
        ("knots.pitch_position_rad", None, ()),
        ("gains.feedback", {"states": ["tail_roll"]}, ("hold", "phases")),
        ("gains.hold.kp", 501.0, ("501.0", "500")),
        ("gains.phases.1.start_s", 0.0, ("gains.phases.1", "0.0")),
        ("trigger.kind", "roll", ("'roll'",)),
        ("trigger.threshold_rad_per_s", -1.0, ("-1.0",)),
        ("trigger", {"kind": "yaw_rate"}, ("trigger.threshold_rad_per_s",)),
        (
            "trigger",
            {"kind": "time", "threshold_rad_per_s": 1.0},
            ("trigger.threshold_rad_per_s",),
        ),
        (
            "trigger",
            {"kind": "steering", "threshold_rad": 0.1, "threshold_rad_per_s": 1.0},
            ("trigger.threshold_rad_per_s",),
        ),
        ("car", {"car.mass": "6 kg"}, ("car.car.mass", "'6 kg'")),
    ],
)
def test_errors_name_file_key_and_value(tmp_path, key, value, named):
    path = tmp_path / "swing.yaml"
    path.write_text(yaml.safe_dump(changed(key, value)))
    place = key.removesuffix(".start_s")
    assert_refused(lambda: read_swing(path), SwingFileError, "swing.yaml", place, *named)


def test_a_curve_that_overshoots_its_limit_between_the_knots_is_refused():
    """Knots at 85 degrees with opposite rates of 8 rad/s, 0.1 s apart, bulge by 8 x 0.1 / 4 = 0.2
    rad.
    """
    data = thesis_data()
    edge = math.radians(85.0)
    data["knots"] |= {
        "time_s": [0.0, 0.1, 0.2],
        "roll_position_rad": [edge, edge, 0.0],
        "roll_velocity_rad_per_s": [8.0, -8.0, 0.0],
    }
    assert_refused(lambda: swing_from_dict(data), SwingFileError, "1.68353", "0.05", "1.5708")


@pytest.mark.parametrize(
    "text",
    [
        "schema: [",
        "schema: aerodima/swing/1\nname: a\nname: b\n",
        "- 1\n",
        "",
        None,
    ],
)
def test_what_is_no_swing_file_is_refused(tmp_path, text):
    path = tmp_path / "swing.yaml"
    if text is not None:
        path.write_text(text)
    assert_refused(lambda: read_swing(path), SwingFileError, "swing.yaml")


def test_another_car_is_named_parameter_by_parameter():
    swing = swing_from_dict(
        changed(
            "car",
            {
                "car.mass": 6.1,
                "tail.length": 0.9,
                "tail.mode": 1.0,
                "tail.colour": 1.0,
                "seed": 1.0,
            },
        )
    )
    scenario = {"car": {"mass": 6.1}, "tail": {"length": 0.8, "mode": "swing"}, "seed": 1}
    length, *unknown = car_mismatches(swing, scenario)
    assert_named(length, ("tail.length", "0.9", "0.8"))
    for line, name in zip(unknown, ("tail.mode", "tail.colour", "seed"), strict=True):
        assert_named(line, (name, "1", "no such parameter"))
    assert car_mismatches(swing_from_dict(thesis_data()), scenario) == []
