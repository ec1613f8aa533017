"""What a scenario may say about the air: names, ranges, files, and scenarios written before the air
could move.
"""

import math
from functools import partial

import pytest

from aerodima.workbench.aero.coefficient_files import embedded_sets, load_coefficients
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.section_laws import CrossedPlatesLaw, NormalForceLaw
from aerodima.workbench.car.car_air import free_sail, sail_law, sail_layout, wind_model
from aerodima.workbench.core.errors import ModelError, ScenarioError
from aerodima.workbench.scenario.scenario import scenario_from_dict
from aerodima.workbench.scenario.tail_parameters import SAIL_LAWS
from tests.refusals import assert_refused

POLAR = "speed_m_per_s,angle_rad,cd,cl,source\n" + "".join(
    f"{speed},{angle},1.2,0.3,made up\n" for angle in (0.0, 0.5) for speed in (5.0, 10.0)
)


def tail(**keys):
    return scenario_from_dict({"tail": keys}).tail


def test_constant_is_the_number_of_the_scenario():
    law, _ = sail_law(tail(normal_force_coefficient=1.3, sail="locked"))
    assert law == NormalForceLaw(1.3)
    law, _ = sail_law(tail(normal_force_coefficient=1.3))
    assert law == CrossedPlatesLaw(NormalForceLaw(1.3), NormalForceLaw(1.3))


def test_shell_and_board_of_a_free_sail_stand_behind_its_bearing():
    sizes = {
        "length": 0.9,
        "sail_length": 0.6,
        "sail_width": 0.2,
        "sail_shell_offset": 0.25,
        "sail_board_share": 0.5,
        "sections": 3,
    }
    parameters = tail(sail="free", **sizes)
    sail = free_sail(parameters, sail_law(parameters)[0])
    assert sail.shell_layout.p_BoRo_B == pytest.approx(
        (0.0, -0.05, 0.0)
    )  # behind is -y, hollow to +y
    assert sail.board_layout.p_BoRo_B == pytest.approx((0.0, -0.15, 0.0))
    assert sum(sail.board_layout.areas) == pytest.approx(0.06)
    for layout in (sail.shell_layout, sail_layout(parameters)):
        assert (layout.start, layout.end) == pytest.approx((0.3, 0.9))
        assert sum(layout.areas) == pytest.approx(0.12)
        assert layout.number == 3


@pytest.mark.parametrize("name", embedded_sets())
def test_sets_for_a_sail_are_those_whose_law_knows_its_normal(name):
    chosen = load_coefficients(name)
    assert chosen.law().knows_normal == (chosen.law_kind in SAIL_LAWS)


def test_wind_of_the_scenario_in_world_axes():
    wind = {
        "mean_x": -3.0,
        "gust_amplitude": 2.0,
        "gust_period": 4.0,
        "gust_direction": math.pi,
        "turbulence": 0.5,
    }
    model = wind_model(scenario_from_dict({"seed": 8, "wind": wind}))
    assert model is not None
    assert model.mean == (-3.0, 0.0, 0.0)
    assert model.gust == pytest.approx((-2.0, 0.0, 0.0), abs=1e-15)
    assert model.gust_frequency == 0.25
    assert model.turbulence == (0.5, 0.5, 0.5)
    assert model.seed == 8


def test_still_air_is_the_default_and_a_car_without_tail_has_no_wind():
    assert (
        wind_model(scenario_from_dict({"wind": {"gust_period": 1.0, "gust_direction": 1.0}}))
        is None
    )
    assert (
        wind_model(scenario_from_dict({"tail": {"mode": "none"}, "wind": {"mean_x": 5.0}})) is None
    )


def test_scenario_from_before_the_air_could_move_is_one_in_still_air():
    resolved = scenario_from_dict({"seed": 3}).resolved()
    del resolved["wind"]
    for key in (
        "coefficients",
        "sail_shell_offset",
        "sail_board_share",
        "sail_bearing_damping",
        "added_mass",
    ):
        del resolved["tail"][key]
    resolved["tail"]["sail_centre_of_pressure"] = 0.02  # of the flat sail of earlier versions
    assert scenario_from_dict(resolved) == scenario_from_dict({"seed": 3})


@pytest.mark.parametrize(
    ("section", "key", "value", "named"),
    [
        ("tail", "coefficients", "robot_tail_lne", ("'robot_tail_line'",)),
        ("tail", "coefficients", "cheetah_tail_1_major", ("flat_plate", "robot_tail_")),
        ("tail", "sail", "loose", ("'facing'", "'free'", "'locked'")),
        ("tail", "added_mass", -2.0, ("-1", "kg")),
        ("wind", "mean_y", 55.0, ("40", "m/s")),
        ("wind", "gust_direction", 90.0, ("3.1416", "rad")),
    ],
)
def test_wrong_air_is_refused_by_key_and_value(section, key, value, named):
    assert_refused(
        lambda: scenario_from_dict({section: {key: value}}, "run.yaml"),
        ScenarioError,
        "run.yaml",
        f"{section}.{key}",
        str(value),
        *named,
    )


def test_file_of_coefficients_is_read_when_the_car_is_built(tmp_path):
    """A polar does not know the normal of a sail, so that it cannot turn one."""
    path = tmp_path / "mine.csv"
    named = ("tail.coefficients", "mine.csv")
    given = tail(coefficients=str(path), sail="locked")
    assert_refused(lambda: sail_law(given), ModelError, *named)
    path.write_text(POLAR)
    law, limit = sail_law(given)
    assert isinstance(law, PolarLaw)
    assert limit == 10.0
    for sail in ("facing", "free"):
        turning = tail(coefficients=str(path), sail=sail)
        assert_refused(partial(sail_law, turning), ModelError, *named, f"'{sail}'")
    path.write_text(POLAR.replace("1.2", "nan", 1))
    assert_refused(lambda: sail_law(given), ModelError, *named, "cd")
