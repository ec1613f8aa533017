import copy
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from aerodima.workbench.config.swing_file import (
    car_mismatches,
    gains_at,
    read_swing,
    swing_at,
    swing_from_dict,
    write_swing,
)
from aerodima.workbench.errors import SwingFileError
from aerodima.workbench.resources import model_path

THESIS = "swings/thesis_8_rad_per_s.yaml"


def thesis_data() -> dict:
    return yaml.safe_load(model_path(THESIS).read_text())


def changed(key: str, value) -> dict:
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


def test_the_thesis_swing_travels_130_degrees_at_8_rad_per_s_and_settles_outside() -> None:
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
    np.testing.assert_allclose(point.roll_position, -math.pi / 2 + 8.0 * during, atol=1e-9)
    np.testing.assert_allclose(point.roll_velocity, 8.0, atol=1e-9)
    end = swing_at(swing, 3.0)
    assert (float(end.roll_position), float(end.roll_velocity)) == (pytest.approx(math.pi / 2), 0.0)
    assert float(swing_at(swing, -1.0).roll_position) == pytest.approx(-math.pi / 2)
    assert not np.any(point.pitch_position)
    assert swing.car == {}


def test_the_thesis_gains_follow_the_phases_of_the_table() -> None:
    swing = read_swing(model_path(THESIS))
    travelled = math.radians(130.0) / 8.0
    assert [(g.kp, g.kd) for g in (gains_at(swing, t)[0] for t in (-0.01, 0.0, 0.28, travelled,
    2.0))] == [
        (17.0, 5.0), (0.0, 3.0), (0.0, 3.0), (5.0, 2.0), (5.0, 2.0),
    ]  # fmt: skip


def test_the_other_direction_mirrors_roll_and_keeps_pitch() -> None:
    data = changed("knots.pitch_position_rad", [0.0, 0.2, 0.1])
    data["knots"]["roll_torque_n_m"] = [1.0, 2.0, 0.0]
    data["knots"]["pitch_torque_n_m"] = [0.5, 0.5, 0.5]
    swing = swing_from_dict(data)
    t = np.linspace(-0.1, 0.6, 36)
    left = swing_at(swing, t, "left")
    right = swing_at(swing, t, "right")
    np.testing.assert_array_equal(right.roll_position, -left.roll_position)
    np.testing.assert_array_equal(right.roll_velocity, -left.roll_velocity)
    np.testing.assert_array_equal(right.roll_torque, -left.roll_torque)
    np.testing.assert_array_equal(right.pitch_position, left.pitch_position)
    np.testing.assert_array_equal(right.pitch_torque, left.pitch_torque)
    np.testing.assert_array_equal(swing_at(swing, t).roll_position, left.roll_position)
    assert left.roll_torque[10] > 0


def test_a_cubic_is_met_exactly_and_the_rate_is_its_derivative() -> None:
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
    np.testing.assert_allclose(point.roll_position, cubic(fine), atol=1e-12)
    np.testing.assert_allclose(point.roll_velocity, slope(fine), atol=1e-11)


def test_what_is_written_comes_back_equal_and_is_not_overwritten(tmp_path: Path) -> None:
    data = changed("car", {"car.mass": 6.1, "tail.length": 0.9})
    swing = swing_from_dict(data)
    path = write_swing(swing, tmp_path / "new" / "swing.yaml")
    assert read_swing(path) == swing
    with pytest.raises(SwingFileError, match="exists already"):
        write_swing(swing, path)
    write_swing(swing, path, force=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(SwingFileError, match="cannot be made or used as a folder"):
        write_swing(swing, tmp_path / "file" / "swing.yaml")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            "schema",
            "aerodima/swing/2",
            r"schema: 'aerodima/swing/2' is not read .*; allowed is 'aerodima/swing/1'",
        ),
        ("direction", "up", r"direction: 'up' is not allowed; .*'left' or 'right'"),
        (
            "knots.time_s",
            [0.0, 0.3, 0.3],
            r"knots\.time_s\.2: 0\.3 follows 0\.3; allowed: strictly increasing",
        ),
        ("knots.time_s", [0.1, 0.3, 0.5], r"knots\.time_s: 0\.1 is first; allowed: 0"),
        ("knots.time_s.1", float("nan"), r"knots\.time_s\.1: nan is not allowed"),
        ("knots.time_s", [0.0], r"knots\.time_s: \[0\.0\] is not allowed; .*at least 2"),
        (
            "knots.roll_velocity_rad_per_s",
            [8.0, 0.0],
            r"knots\.roll_velocity_rad_per_s: 2 values; allowed: 3",
        ),
        (
            "knots.roll_position_rad.0",
            "-90 deg",
            r"knots\.roll_position_rad\.0: '-90 deg' is not allowed",
        ),
        ("knots.roll_position_rad.0", True, r"knots\.roll_position_rad\.0: True is not allowed"),
        (
            "knots.roll_position_rad.2",
            90.0,
            r"knots\.roll_position_rad\.2: 90\.0; allowed: -1\.5708 to 1\.5708",
        ),
        (
            "knots.roll_velocity_rad_per_s.0",
            9.0,
            r"knots\.roll_velocity_rad_per_s\.0: 9\.0; allowed: -8 to 8",
        ),
        (
            "knots.roll_torque_n_m",
            [0.0, 25.0, 0.0],
            r"knots\.roll_torque_n_m\.1: 25\.0; allowed: -24\.8 to 24\.8",
        ),
        ("knots.roll_speed", [0.0], r"knots\.roll_speed: unknown key"),
        ("knots.pitch_position_rad", None, r"knots\.pitch_position_rad: missing"),
        (
            "gains.feedback",
            {"states": ["tail_roll"]},
            r"gains\.feedback: unknown key; allowed: hold, phases",
        ),
        ("gains.hold.kp", 501.0, r"gains\.hold\.kp: 501\.0 is not allowed; .*500"),
        (
            "gains.phases.1.start_s",
            0.0,
            r"gains\.phases\.1: 0\.0 follows 0\.0; allowed: strictly increasing",
        ),
        ("trigger.kind", "roll", r"trigger\.kind: 'roll' is not allowed"),
        (
            "trigger.threshold_rad_per_s",
            -1.0,
            r"trigger\.threshold_rad_per_s: -1\.0 is not allowed",
        ),
        ("limits.torque_n_m", float("inf"), r"limits\.torque_n_m: inf is not allowed"),
        ("car", {"car.mass": "6 kg"}, r"car\.car\.mass: '6 kg' is not allowed"),
        ("trigger", None, r"trigger: missing"),
    ],
)
def test_errors_name_file_key_value_and_what_is_allowed(
    tmp_path: Path, key: str, value, message: str
) -> None:
    path = tmp_path / "swing.yaml"
    path.write_text(yaml.safe_dump(changed(key, value)))
    with pytest.raises(SwingFileError, match=rf"swing\.yaml: {message}"):
        read_swing(path)


def test_a_curve_that_overshoots_its_limit_between_the_knots_is_refused() -> None:
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
    with pytest.raises(
        SwingFileError, match=r"the curve reaches 1\.68353 at 0\.05 s; allowed: -1\.5708 to 1\.5708"
    ):
        swing_from_dict(data)


@pytest.mark.parametrize(
    "trigger",
    [
        {"kind": "yaw_rate"},
        {"kind": "time", "threshold_rad_per_s": 1.0},
        {"kind": "steering", "threshold_rad": 0.1, "threshold_rad_per_s": 1.0},
    ],
)
def test_a_trigger_has_a_threshold_if_it_looks_at_the_yaw_rate(trigger: dict) -> None:
    with pytest.raises(
        SwingFileError, match=r"trigger\.threshold_rad_per_s: allowed and needed with kind yaw_rate"
    ):
        swing_from_dict(changed("trigger", trigger))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema: [", "not YAML"),
        ("schema: aerodima/swing/1\nname: a\nname: b\n", "key named twice: name"),
        ("- 1\n", "holds a list; allowed is a mapping"),
        ("", "schema: None is not read by this version"),
    ],
)
def test_what_is_no_swing_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "swing.yaml"
    path.write_text(text)
    with pytest.raises(SwingFileError, match=rf"swing\.yaml: .*{message}"):
        read_swing(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SwingFileError, match=r"none\.yaml: no such file"):
        read_swing(tmp_path / "none.yaml")


def test_another_car_is_named_parameter_by_parameter() -> None:
    swing = swing_from_dict(
        changed("car", {"car.mass": 6.1, "tail.length": 0.9, "tail.colour": 1.0})
    )
    scenario = {"car": {"mass": 6.1}, "tail": {"length": 0.8}}
    assert car_mismatches(swing, scenario) == [
        "tail.length: made for 0.9, the scenario has 0.8",
        "tail.colour: made for 1, the scenario has no such parameter",
    ]
    assert car_mismatches(swing_from_dict(thesis_data()), scenario) == []
