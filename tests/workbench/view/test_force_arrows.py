"""Arrows act where the forces do."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.scenario.signal_table import WHEELS
from aerodima.workbench.view.force_arrows import WHEEL_SCALE, point_on_axis
from aerodima.workbench.view.logged_run import AIR_SCALE, add_logged_run
from aerodima.workbench.view.scene_shapes import point_paths

ROOT, TIP = np.array([[1.0, 2.0, 0.3]]), np.array([[1.2, 1.6, 1.1]])


@pytest.mark.parametrize("fraction", [0.0, 0.35, 1.0])
def test_point_of_a_force_on_the_axis_is_found_from_its_moment(fraction):
    force = np.array([[0.7, -2.0, 0.4]])
    point = ROOT + fraction * (TIP - ROOT)
    assert point_on_axis(force, np.cross(point, force), ROOT, TIP) == pytest.approx(point)


def test_point_is_the_nearest_to_a_line_of_action_beside_the_axis():
    force = np.array([[0.0, 3.0, 0.0]])
    root = np.zeros((1, 3))
    tip = np.array([[0.0, 0.0, 2.0]])
    beside = np.array([[0.1, -5.0, 0.8]])
    assert point_on_axis(force, np.cross(beside, force), root, tip) == pytest.approx(
        np.array([[0.0, 0.0, 0.8]])
    )


def test_point_stays_on_the_tail():
    force = np.array([[0.7, -2.0, 0.4]])
    beyond = ROOT + 1.4 * (TIP - ROOT)
    assert point_on_axis(force, np.cross(beyond, force), ROOT, TIP) == pytest.approx(TIP)


@pytest.mark.parametrize("force", [[0.0, 0.0, 0.0], [0.2, -0.4, 0.8]])
def test_middle_stands_for_a_point_that_is_not_determined(force):
    moment = np.cross(ROOT, [force])
    assert point_on_axis(np.array([force]), moment, ROOT, TIP) == pytest.approx(0.5 * (ROOT + TIP))


def test_air_of_a_run_acts_on_the_sail(tailed):
    logged = add_logged_run(DiagramBuilder(), tailed)
    tail = tailed.scenario["tail"]
    (arrow,) = [arrow for arrow in logged.arrows if arrow.name == "air_on_tail"]
    tip = logged.tips["tail_tip"]
    root = point_paths(logged.plant, "tail_rod", np.zeros((1, 3)), logged.positions)[:, 0]
    assert np.linalg.norm(tip - root, axis=1) == pytest.approx(tail["length"])
    force = tailed.vector("tail_force", "truth_n")
    assert arrow.lengths == pytest.approx(AIR_SCALE * force)
    strength = np.linalg.norm(force, axis=1)
    blowing = strength > 0.2 * strength.max()
    assert strength.max() > 0.01
    from_root = np.linalg.norm(arrow.points - root, axis=1)[blowing]
    assert (
        from_root.min() > tail["length"] - tail["sail_length"]
    )  # the sail is the outer end of the tail
    assert from_root.max() < tail["length"]


def test_ground_acts_below_the_wheel_of_its_name(tailless):
    logged = add_logged_run(DiagramBuilder(), tailless)
    plant = logged.plant
    context = plant.CreateDefaultContext()
    row = len(tailless.time) - 1
    logged.move(context, row)
    arrows = {arrow.name: arrow for arrow in logged.arrows}
    assert set(arrows) == {f"ground_on_{wheel}" for wheel in WHEELS}
    for wheel in WHEELS:
        centre = plant.EvalBodyPoseInWorld(
            context, plant.GetBodyByName(f"{wheel}_wheel")
        ).translation()
        arrow = arrows[f"ground_on_{wheel}"]
        # Wheels are 0.27 m apart; contact is below the centre but for the lean of the wheel and one
        # step of travel.
        assert np.linalg.norm(arrow.points[row, :2] - centre[:2]) < 0.02
        assert arrow.lengths[row, 2] == pytest.approx(
            WHEEL_SCALE * tailless.signal(f"wheel_force_{wheel}_z_truth_n")[row]
        )
        assert arrow.shown[row]
