"""Candidates from names and files, the ballast of one, and what is refused."""

import pytest

from aerodima.optimisation.swerve.candidate import (
    LOW_BALLAST,
    LOW_MASS_HEIGHT,
    NO_TAIL,
    low_ballast,
)
from aerodima.optimisation.swerve.suite import select_candidates
from aerodima.workbench.car.car_model import chassis_centre, gearbox_height
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

LAWS = """
schema: aerodima/candidates/1
candidates:
  - name: slow
    settings: [tail.mode=swing, controller.swing_file=none, controller.swing_speed=3.0]
"""


SETTINGS = "settings: [tail.mode=swing, controller.swing_file=none, controller.swing_speed=3.0]"
TWICE = "  - {name: slow, settings: [tail.mode=none]}\n  - name: slow"


@pytest.mark.parametrize(
    ("was", "becomes", "named"),
    [
        ("controller.swing_speed=3.0", "car.com_height=0.1", ("car.com_height=0.1",)),
        ("controller.swing_speed=3.0", "controller.swing_sped=3.0", ("slow", "swing_sped")),
        ("candidates/1", "candidates/2", ("candidates/2",)),
        (SETTINGS, "", ("settings",)),
        ("  - name: slow", TWICE, ("slow",)),
    ],
)
def test_a_list_of_candidates_brings_tail_and_controller_alone(tmp_path, was, becomes, named):
    path = tmp_path / "mine.yaml"
    path.write_text(LAWS)
    _, law = select_candidates([str(path)])
    assert (law.name, law.settings[-1]) == ("slow", "controller.swing_speed=3.0")
    path.write_text(LAWS.replace(was, becomes))
    assert_refused(lambda: select_candidates([str(path)]), UserError, *named)


def test_candidates_that_ship_take_part_by_name():
    bare, folded = select_candidates(["folded", "none"])
    assert bare == NO_TAIL
    assert "feedback.roll_gain=0" in folded.settings
    _, thesis = select_candidates(["thesis_8_rad_per_s"])
    assert any(setting.startswith("controller.swing_file=") for setting in thesis.settings)


def test_the_place_of_low_ballast_is_swept():
    """Further back moves the centre of mass of the car and nothing else."""
    car = load_scenario("swerve")
    places = [load_scenario("swerve", ballast(car)).car for ballast in LOW_BALLAST.ballasts]
    back = [places[0].com_x - place.com_x for place in places]
    assert back == pytest.approx([0.0, 0.01, 0.02, 0.03])
    assert len({place.com_height for place in places}) == 1


def test_low_ballast_moves_gearbox_and_arm_and_leaves_the_chassis():
    before = load_scenario("turn_fast")
    after = load_scenario("turn_fast", [*NO_TAIL.settings, *low_ballast(before)])
    assert gearbox_height(after.car, after.tail) == pytest.approx(LOW_MASS_HEIGHT)
    arm = before.tail.mass + before.tail.hub_mass
    assert after.car.mass == pytest.approx(before.car.mass + arm)
    gravity = before.environment.gravity
    (m0, x0, z0), (m1, x1, z1) = (
        chassis_centre(one.car, one.tail, gravity) for one in (before, after)
    )
    assert m1 == pytest.approx(m0 + arm)
    # What the chassis has more is the arm's mass where it was put; its tyres sink in a little more.
    assert (m1 * x1 - m0 * x0) / arm == pytest.approx(before.car.gearbox_x)
    assert (m1 * z1 - m0 * z0) / arm == pytest.approx(LOW_MASS_HEIGHT, abs=2e-3)
