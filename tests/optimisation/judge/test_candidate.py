"""Candidates from names and files, the ballast of one, and what a task refuses."""

import pytest

from aerodima.optimisation.judge.candidate import HELD, LOW_MASS_HEIGHT, NO_TAIL, low_ballast
from aerodima.optimisation.judge.suite import select_candidates
from aerodima.optimisation.swing.task import Task, TaskSurface, load_task
from aerodima.workbench.car.car_model import chassis_centre, gearbox_height
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.ensemble import Member
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
    bare, held, best = select_candidates(["none", "held", "best_swing"])
    assert (bare, held) == (NO_TAIL, HELD)
    assert "controller.pitch_angle=0.593" in best.settings
    _, thesis = select_candidates(["thesis_8_rad_per_s"])
    assert any(setting.startswith("controller.swing_file=") for setting in thesis.settings)


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


def test_friction_of_a_floor_is_its_share_of_the_critical_one():
    floor = TaskSurface(Member("own", 1.0, {}), 4.5, 1.3, 0.85)
    assert floor.friction == pytest.approx(1.3 * 0.85)
    assert floor.setting == "car.tyre_friction=1.105"


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (lambda: select_candidates(["best_swin"]), ("best_swin", "best_swing")),
        (lambda: select_candidates(["hold"]), ("hold", "held")),
        (lambda: select_candidates(["held", "held"]), ("held",)),
        (lambda: Task(training=999).training_cars, ("training", "999")),
        (lambda: Task(speeds=[4.5, 4.5]), ("speed", "4.5")),
        (lambda: Task(floors=[1.3, 1.1, 1.3]), ("floor", "1.3")),
        (lambda: Task(floors=[9.0]), ("floor", "9", "0.2", "3")),
        (lambda: Task(steering=(-2.0, 20.0)), ("steering", "-2", "20")),
        (lambda: Task(scenario="slalom"), ("slalom", "manoeuvre.kind")),
        (lambda: Task(scenario="entry_twice"), ("entry_twice", "manoeuvre.turns", "2")),
        (lambda: Task(steering=(2.0, 40.0)), ("manoeuvre.steer_angle",)),
        (lambda: load_task("short_turns"), ("short_turns",)),
        (lambda: load_task("short_turn", ["pulse=5"]), ("pulse", "5")),
        (lambda: load_task("short_turn", ["car=3"]), ("--set car=3",)),
    ],
)
def test_wrong_input_is_named(wrong, named):
    assert_refused(wrong, UserError, *named)
