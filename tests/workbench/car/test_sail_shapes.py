"""The eight shapes of thesis 5.2: depth, board and coefficient of each, and what the text does not
have.
"""

import pytest

from aerodima.workbench.aero.section_laws import NormalForceLaw
from aerodima.workbench.car.car_air import free_sail, sail_law
from aerodima.workbench.car.tail_plant import sail_inertial, tail_sdf
from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.resources import published_table
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused
from tests.workbench.aero.vanes import side_moment


def tail(shape, *settings):
    return load_scenario("turn_swing", [f"tail.sail_shape={shape}", *settings]).tail


def broadside(law, sign):
    """Coefficient broadside in air that moves along the normal."""
    force = law.section_force((0.0, sign, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 1.0, 2.0)
    return abs(float(force[1]))


def test_coefficients_are_those_of_table_2_1():
    rows = published_table("shape_drag")
    planar = rows[rows["dimensionality"] == "2D"].set_index("row_in_table")["cd"]
    flat = sail_law(tail("flat", "tail.sail=locked"))[0]
    assert broadside(flat, 1.0) == broadside(flat, -1.0) == pytest.approx(planar[7])
    shell = sail_law(tail("half_cylinder_caps", "tail.sail=locked"))[0]
    assert sorted((broadside(shell, 1.0), broadside(shell, -1.0))) == pytest.approx(
        [planar[2], planar[9]]
    )
    assert broadside(sail_law(tail("built", "tail.sail=locked"))[0], 1.0) == 2.0
    # A set that is named stands above the shape.
    named = sail_law(tail("flat", "tail.sail=locked", "tail.coefficients=robot_tail_constant"))[0]
    assert broadside(named, 1.0) == 2.0


def test_depth_and_board_follow_the_shape():
    built = load_scenario("turn_swing").tail
    assert tail("half_cylinder_caps_board").sail_depth == built.sail_depth
    assert tail("half_cylinder").sail_depth == pytest.approx(0.5 * built.sail_width)
    assert tail("flat").sail_depth == 0.0
    mass = built.mass * built.sail_mass_fraction
    width = built.sail_width
    assert sail_inertial(tail("flat")).moments[2] == pytest.approx(mass * width**2 / 12)
    vane = free_sail(tail("flat_board", "tail.sail=free"), NormalForceLaw(2.0))
    # Only the board turns a flat sail: half a width deep, its middle a quarter of a width behind
    # the shell's place.
    offset = built.sail_shell_offset * width
    assert side_moment(vane) == pytest.approx(
        built.sail_length * 0.5 * width * (offset + 0.25 * width)
    )


def test_drawing_has_a_board_where_the_shape_has_one():
    for shape, drawn in (("flat", False), ("flat_board", True), ("half_cylinder", False)):
        car = load_scenario("turn_swing", [f"tail.sail_shape={shape}"])
        assert ("backing_board" in tail_sdf(car.tail, car.tail_motor, car.car).text()) is drawn


@pytest.mark.parametrize(
    ("shape", "settings", "named"),
    [
        ("disc_gap_band", [], ("disc_gap_band", "tail.coefficients")),
        ("flat", ["tail.sail=free"], ("sail", "'free'")),
        ("round", [], ("sail_shape", "'round'")),
    ],
)
def test_what_the_text_does_not_have_is_refused(shape, settings, named):
    assert_refused(lambda: tail(shape, *settings), ScenarioError, *named)


def test_shape_of_a_picture_needs_coefficients():
    assert tail("disc_gap_band", "tail.coefficients=half_cylinder").sail_depth > 0.0
