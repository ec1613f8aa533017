"""Scenarios resolve to typed numbers, repeat themselves, and refuse what they cannot mean."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import pytest
from pydantic import ValidationError

from aerodima.workbench.config.scenario import SECTIONS, Scenario, load_scenario, scenario_from_dict
from aerodima.workbench.errors import ScenarioError, UserError


def refusal(overrides: dict) -> str:
    with pytest.raises(ScenarioError) as caught:
        scenario_from_dict(overrides, "run.yaml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def file_refusal(path: Path, content: str | bytes, settings: Sequence[str] = ()) -> str:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path, settings)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_every_shipped_scenario_resolves():
    assert {"turn_none", "turn_held", "turn_swing", "straight", "slalom", "auto_turn"} <= set(
        Scenario.names()
    )
    for name in Scenario.names():
        assert isinstance(load_scenario(name), Scenario)


@pytest.mark.parametrize("name", Scenario.names())
def test_name_says_nothing_of_the_tail_which_a_flag_can_change(name):
    assert not {"tail", "none", "held", "swing"} & set(
        load_scenario(name).name.replace(",", "").split()
    )


def test_published_turn_in_si_units():
    scenario = load_scenario("turn_swing")
    assert scenario.manoeuvre.speed == 3.33
    assert scenario.manoeuvre.steer_angle == pytest.approx(math.radians(30))
    assert scenario.manoeuvre.steer_angle / scenario.servo.rate == pytest.approx(0.14)
    assert scenario.controller.travel == pytest.approx(math.radians(130))
    assert scenario.controller.hold_angle == pytest.approx(math.radians(90))


@pytest.mark.parametrize("name", ["turn_none", "turn_swing", "auto_turn"])
def test_resolved_scenario_is_json_and_resolves_to_itself(name):
    scenario = load_scenario(name, ["seed=9", "car.com_height=0.2"])
    text = json.dumps(scenario.resolved(), allow_nan=False)
    assert scenario_from_dict(json.loads(text)) == scenario
    assert json.loads(text)["schema"] == "aerodima/scenario/1"
    assert set(SECTIONS) <= set(json.loads(text))


def test_scenario_is_frozen():
    scenario = scenario_from_dict({})
    with pytest.raises(ValidationError):
        scenario.car.mass = 5.0
    with pytest.raises(ValidationError):
        scenario.seed = 5


def test_unknown_section_and_key_are_answered_with_the_nearest():
    assert refusal({"carr": {}}) == "run.yaml: carr: unknown key; did you mean 'car'?"
    assert (
        refusal({"car": {"com_hight": 0.2}})
        == "run.yaml: car.com_hight: unknown key; did you mean 'com_height'?"
    )


def test_speed_in_kilometres_per_hour_is_refused_and_not_converted():
    assert refusal({"manoeuvre": {"speed": "3.33 km/h"}}) == (
        "run.yaml: manoeuvre.speed: '3.33 km/h' has the unit 'km/h'; allowed is 'm/s'"
    )
    assert scenario_from_dict({"manoeuvre": {"speed": "3.33 m/s"}}).manoeuvre.speed == 3.33


def test_angle_in_degrees_is_refused():
    assert "allowed is 'rad'" in refusal({"manoeuvre": {"steer_angle": "30 deg"}})
    assert "less than or equal to 1.2 (rad)" in refusal({"manoeuvre": {"steer_angle": 30.0}})


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "nan m/s"])
def test_speed_that_is_not_finite_is_refused(value):
    assert "manoeuvre.speed" in refusal({"manoeuvre": {"speed": value}})


def test_negative_mass_is_refused_with_unit_and_range():
    assert refusal({"car": {"mass": -1.0}}) == (
        "run.yaml: car.mass: -1.0 is not allowed; input should be greater than 0 (kg)"
    )


def test_whole_number_is_taken_for_a_real_one_but_a_flag_is_not():
    assert scenario_from_dict({"manoeuvre": {"speed": 3}}).manoeuvre.speed == 3.0
    assert isinstance(scenario_from_dict({"manoeuvre": {"speed": 3}}).manoeuvre.speed, float)
    assert "manoeuvre.speed: True is not allowed" in refusal({"manoeuvre": {"speed": True}})
    assert "drive.governor: 1 is not allowed" in refusal({"drive": {"governor": 1}})
    assert "tail.sections: 5.0 is not allowed" in refusal({"tail": {"sections": 5.0}})


def test_unknown_mode_is_answered_with_the_known_ones():
    assert (
        "tail.mode: 'flying' is not allowed; input should be 'none', 'held' or 'swing'"
        in refusal({"tail": {"mode": "flying"}})
    )


@pytest.mark.parametrize("schema", ["aerodima/scenario/2", "", None, 1])
def test_other_schema_is_refused_by_name(schema):
    assert refusal({"schema": schema}) == (
        f"run.yaml: schema: {schema!r} is not read by this version; allowed is "
        "'aerodima/scenario/1'"
    )


@pytest.mark.parametrize("seed", [-1, 2**63, 1.0, True, "one"])
def test_seed_is_a_whole_number_that_fits(seed):
    assert "seed" in refusal({"seed": seed})


@pytest.mark.parametrize("content", [[1, 2], None, 3.0, "fast"])
def test_section_must_be_a_mapping(content):
    assert "car" in refusal({"car": content})
    assert "keys with values" in refusal({"car": content})


@pytest.mark.parametrize(
    "key", ["imu.rate", "gps.rate", "sail_encoder.rate", "controller.rate", "simulation.log_rate"]
)
def test_nothing_is_sampled_faster_than_the_plant_steps(key):
    section, name = key.split(".")
    assert refusal({section: {name: 501.0}}) == (
        f"run.yaml: {key}: 501 Hz is above 1/step; allowed with step 0.002 s: <= 500 Hz"
    )
    assert scenario_from_dict({section: {name: 500.0}})


def test_steering_beyond_the_servo_is_refused():
    message = refusal({"manoeuvre": {"steer_angle": 0.5237}})
    assert (
        message
        == "run.yaml: manoeuvre.steer_angle: 0.5237 rad; allowed: <= servo.limit 0.523598776 rad"
    )


def test_sail_longer_than_the_tail_is_refused():
    assert "tail.sail_length: 0.95 m; allowed: <= tail.length 0.9 m" in refusal(
        {"tail": {"length": 0.9, "sail_length": 0.95}}
    )


def test_turn_that_starts_before_the_speed_is_reached_is_refused():
    assert "manoeuvre.speed_ramp: 3 s; allowed: <= turn_start 2 s" in refusal(
        {"manoeuvre": {"speed_ramp": 3.0}}
    )


def test_tail_that_would_rest_behind_its_stop_is_refused():
    assert "controller.hold_angle: 1.8 rad; allowed: <= tail.roll_limit" in refusal(
        {"controller": {"hold_angle": 1.8}}
    )
    assert "controller.pitch_angle: -1.8 rad; allowed: within tail.pitch_limit" in refusal(
        {"controller": {"pitch_angle": -1.8}}
    )
    assert scenario_from_dict({"controller": {"hold_angle": 1.8}, "tail": {"mode": "none"}})


def test_cage_friction_that_drake_cannot_combine_is_refused():
    assert refusal({"car": {"cage_friction": 1.0, "tyre_friction": 0.5}}) == (
        "run.yaml: car.cage_friction: 1; allowed: < twice car.tyre_friction, 1"
    )


def test_file_that_is_no_scenario_is_named(tmp_path):
    path = tmp_path / "run.yaml"
    assert "holds a list; allowed is a mapping" in file_refusal(path, "- car\n- tail\n")
    assert "not YAML" in file_refusal(path, "car: [1\n")
    assert "cannot be read" in file_refusal(path, b"\xff\xfe\x00")
    assert "named twice: car" in file_refusal(path, "car: {mass: 5.0}\ncar: {mass: 7.0}\n")
    assert "named twice: mass" in file_refusal(path, "car: {mass: 5.0, com_x: 0.1, mass: 7.0}\n")
    assert "keys should be strings" in file_refusal(path, "1: {a: 2}\n")
    assert "car.mas: unknown key; did you mean 'mass'?" in file_refusal(path, "car: {mas: 5.0}\n")


def test_missing_file_and_unknown_name_are_told(tmp_path):
    with pytest.raises(ScenarioError, match=r"nowhere\.yaml: no such file"):
        load_scenario(tmp_path / "nowhere.yaml")
    with pytest.raises(UserError, match=r"turn_nonee.*did you mean 'turn_none'\?"):
        load_scenario("turn_nonee")


def test_empty_file_is_the_nominal_scenario(tmp_path):
    (tmp_path / "empty.yaml").write_text("")
    assert load_scenario(tmp_path / "empty.yaml") == scenario_from_dict({})


def test_settings_override_the_file():
    scenario = load_scenario(
        "turn_none",
        [
            "car.com_height=0.21",
            "manoeuvre.speed = 3.5 m/s",
            "seed=7",
            "name=low car",
            "drive.governor=false",
        ],
    )
    assert scenario.car.com_height == 0.21
    assert scenario.manoeuvre.speed == 3.5
    assert (scenario.seed, scenario.name, scenario.drive.governor) == (7, "low car", False)
    assert scenario.tail.mode == "none"


def test_last_of_two_equal_settings_counts():
    assert load_scenario("turn_none", ["seed=1", "seed=2"]).seed == 2


@pytest.mark.parametrize(
    "setting", ["car.com_height", "=3", "car.=3", ".mass=3", "car.mass.x=1", "", "car=="]
)
def test_setting_of_another_form_is_refused(setting):
    with pytest.raises(ScenarioError, match="--set"):
        load_scenario("turn_none", [setting])


def test_setting_is_named_in_its_error():
    with pytest.raises(
        ScenarioError, match=r"--set carr\.mass=1: 'carr' is no section; did you mean 'car'"
    ):
        load_scenario("turn_none", ["carr.mass=1"])
    with pytest.raises(
        ScenarioError, match=r"--set car\.mas=1: car\.mas: unknown key; did you mean 'mass'"
    ):
        load_scenario("turn_none", ["car.mas=1"])
    with pytest.raises(ScenarioError, match=r"manoeuvre\.speed.*unit 'km/h'; allowed is 'm/s'"):
        load_scenario("turn_none", ["manoeuvre.speed=12 km/h"])
    with pytest.raises(ScenarioError, match=r"car\.mass: None is not allowed"):
        load_scenario("turn_none", ["car.mass="])
    with pytest.raises(ScenarioError, match="is not a value"):
        load_scenario("turn_none", ["seed=[1"])
