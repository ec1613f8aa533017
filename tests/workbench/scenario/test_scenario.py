"""Scenarios resolve to typed numbers, repeat themselves, and refuse what they cannot mean."""

import json
import math

import pytest

from aerodima.workbench.core.errors import ScenarioError, UserError
from aerodima.workbench.core.yaml_files import parse_yaml
from aerodima.workbench.scenario.scenario import (
    Scenario,
    load_scenario,
    scenario_from_dict,
)
from tests.refusals import assert_refused

RATES = (
    ("imu", "rate"),
    ("gps", "rate"),
    ("sail_encoder", "rate"),
    ("controller", "rate"),
    ("simulation", "log_rate"),
)
"""Of what is sampled, in section and key; none may be faster than the plant steps, 500 Hz."""
LAUGHS = "a0: &a0 [1]\n" + "".join(
    f"a{n}: &a{n} [{', '.join(9 * [f'*a{n - 1}'])}]\n" for n in range(1, 7)
)
"""A few lines that stand for 9 to the 6th values."""


def test_every_shipped_scenario_resolves():
    assert {"turn_none", "turn_held", "turn_swing", "straight", "slalom", "auto_turn"} <= set(
        Scenario.names()
    )
    for name in Scenario.names():
        assert isinstance(load_scenario(name), Scenario)


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
    assert set(Scenario.sections()) <= set(json.loads(text))


def test_empty_file_is_the_nominal_scenario(tmp_path):
    (tmp_path / "empty.yaml").write_text("")
    assert load_scenario(tmp_path / "empty.yaml") == scenario_from_dict({})


def test_a_file_holds_what_differs_from_its_base(tmp_path):
    fast = tmp_path / "fast.yaml"
    fast.write_text("base: turn_swing\nmanoeuvre: {speed: 4.0 m/s}\n")
    base = load_scenario("turn_swing")
    assert load_scenario(fast) == base.varied(manoeuvre={"speed": 4.0})
    faster = tmp_path / "faster.yaml"
    faster.write_text("base: fast.yaml\n")
    assert_refused(lambda: load_scenario(faster), ScenarioError, "fast.yaml", "base")


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
    ("overrides", "named"),
    [
        ({"carr": {}}, ("carr", "'car'")),
        ({"car": {"com_hight": 0.2}}, ("car.com_hight", "'com_height'")),
        ({"manoeuvre": {"steer_angle": "30 deg"}}, ("manoeuvre.steer_angle", "'rad'", "degree")),
        (
            {"manoeuvre": {"steer_angle": 30.0}},
            ("manoeuvre.steer_angle", "30.0", "1.2", "rad", "degree"),
        ),
        ({"simulation": {"step": 1e-300}}, ("simulation.step", "1e-300", "0.00001")),
        ({"drive": {"governor": 1}}, ("drive.governor", "1")),
        ({"feedback": {"most_roll": 2.0}}, ("feedback.most_roll", "2")),
        ({"tail": {"roll_stop": 1.2}}, ("tail.roll_limit", "1.57", "tail.roll_stop", "1.2")),
        ({"tail": {"mode": "flying"}}, ("tail.mode", "'flying'", "'none'", "'held'", "'swing'")),
        *(
            ({"schema": schema}, ("schema", repr(schema), "'aerodima/scenario/1'"))
            for schema in ("aerodima/scenario/2", None)
        ),
        *(({"seed": seed}, ("seed",)) for seed in (-1, 2**63, 1.0, True)),
        *(({"car": content}, ("car",)) for content in ([1, 2], None)),
        *(
            ({section: {key: 501.0}}, (f"{section}.{key}", "501", "0.002", "500"))
            for section, key in RATES
        ),
        (
            {"manoeuvre": {"steer_angle": 0.5237}},
            ("manoeuvre.steer_angle", "0.5237", "servo.limit", "degree"),
        ),
        ({"tail": {"length": 0.9, "sail_length": 0.95}}, ("tail.sail_length", "0.95", "0.9")),
        ({"manoeuvre": {"speed_ramp": 3.0}}, ("manoeuvre.speed_ramp", "3", "turn_start")),
        ({"controller": {"hold_angle": 1.8}}, ("controller.hold_angle", "1.8", "tail.roll_limit")),
        (
            {"controller": {"pitch_angle": -1.8}},
            ("controller.pitch_angle", "-1.8", "tail.pitch_limit"),
        ),
        (
            {"manoeuvre": {"kind": "auto_turn", "first_hold": 0.2}},
            ("manoeuvre.first_hold", "0.2", "auto_turn"),
        ),
        (
            {
                "controller": {"law": "feedback"},
                "tail": {"mode": "swing", "pitch_limit": 0.5},
                "feedback": {"pitch_angle": -0.6},
            },
            ("feedback.pitch_angle", "-0.6", "tail.pitch_limit"),
        ),
        (
            {"car": {"cage_friction": 1.0, "tyre_friction": 0.5}},
            ("car.cage_friction", "1", "car.tyre_friction"),
        ),
    ],
    ids=str,
)
def test_wrong_scenarios_are_refused_by_file_key_and_value(overrides, named):
    assert_refused(
        lambda: scenario_from_dict(overrides, "run.yaml"), ScenarioError, "run.yaml", *named
    )


def test_values_at_the_edge_of_what_is_refused_are_taken():
    taken = scenario_from_dict({"manoeuvre": {"speed": 3}}).manoeuvre.speed
    assert isinstance(taken, float)
    assert taken == 3.0
    assert scenario_from_dict({"manoeuvre": {"speed": "3.33 m/s"}}).manoeuvre.speed == 3.33
    for section, key in RATES:
        assert scenario_from_dict({section: {key: 500.0}})
    assert scenario_from_dict({"controller": {"hold_angle": 1.8}, "tail": {"mode": "none"}})


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("- car\n- tail\n", ()),
        ("car: [1\n", ()),
        (b"\xff\xfe\x00", ()),
        ("[" * 30_000, ("column 101",)),
        ("car: {mass: " + 5000 * "9" + "}", ("5000 digits",)),
        (LAUGHS, ("alias", "20 within")),
        ("a: &a [*a]", ("alias",)),
        ("car: {mass: 5.0}\ncar: {mass: 7.0}\n", ("car",)),
        ("car: {mass: 5.0, com_x: 0.1, mass: 7.0}\n", ("mass",)),
        ("1: {a: 2}\n", (": 1:",)),
        ("car: {mas: 5.0}\n", ("car.mas", "'mass'")),
        (None, ()),
    ],
)
def test_file_that_is_no_scenario_is_named(tmp_path, content, named):
    path = tmp_path / "run.yaml"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert_refused(lambda: load_scenario(path), ScenarioError, str(path), *named)


def test_an_anchored_mapping_may_take_over_another():
    text = "b: &b {x: 1, y: 1}\nc: &c {<<: *b, x: 2}\nd: {<<: *c, y: 3}"
    assert parse_yaml(text)["d"] == {"x": 2, "y": 3}


def test_a_file_without_end_is_not_read_to_its_end():
    assert_refused(lambda: load_scenario("/dev/zero"), ScenarioError, "/dev/zero", "MiB")


def test_unknown_name_is_answered_with_the_nearest():
    assert_refused(lambda: load_scenario("turn_nonee"), UserError, "turn_nonee", "'turn_none'")


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        *((setting, ("--set",)) for setting in ("car.com_height", "=3", "car.=3", "car.mass.x=1")),
        ("carr.mass=1", ("carr.mass=1", "'carr'", "'car'")),
        ("car.mas=1", ("car.mas=1", "'mass'")),
        ("car.mass=", ("car.mass",)),
        ("seed=[1", ("seed",)),
        ("seed=" + "[" * 30_000, ("seed",)),
    ],
)
def test_wrong_setting_is_refused_by_name(setting, named):
    assert_refused(lambda: load_scenario("turn_none", [setting]), ScenarioError, *named)
