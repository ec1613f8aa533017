"""What a viewer gets during a simulation: a world that moves under the camera, arrows with their
points right.
"""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from aerodima.workbench.view.watched_plant import LiveScene
from tests.workbench.view.shown_calls import ShownCalls

ARROW = "/drake/forces/air_on_tail"


def shown(com, force):
    """A body of 0.2 m about its origin at the centre of mass, whose tail of 1 m points up."""
    meshcat = ShownCalls()
    live = LiveScene(meshcat, ["tail"], [0.2], 0.1)
    context = live.CreateDefaultContext()
    middle = np.array([com[0], com[1], com[2] + 0.5])
    live.GetInputPort("com").FixValue(context, [*com, 0.0, 0.0, 0.0])
    live.GetInputPort("poses").FixValue(context, [1.0, 0.0, 0.0, 0.0, *com])
    ends = [com[0], com[1], com[2], com[0], com[1], com[2] + 1.0]
    live.GetInputPort("tail_air").FixValue(context, [*force, *np.cross(middle, force), *ends])
    Simulator(live, context).Initialize()
    return meshcat


def test_world_moves_under_the_camera_and_keeps_its_floor():
    meshcat = shown([3.0, -2.0, 0.4], [2.0, 0.0, 0.0])
    assert meshcat.poses["/drake"].translation() == pytest.approx([-3.0, 2.0, 0.0])
    eye, target = meshcat.camera
    assert target == pytest.approx([0.0, 0.0, 0.4])
    assert np.linalg.norm(eye - target) > 3 * 0.2
    assert "/drake/ground/floor" in meshcat.objects


def test_point_of_the_arrow_is_force_times_scale_from_the_middle_of_the_tail():
    meshcat = shown([3.0, -2.0, 0.4], [2.0, 0.0, 0.0])
    assert meshcat.properties[ARROW, "visible"] is True
    tip = meshcat.poses[ARROW].multiply(meshcat.poses[f"{ARROW}/head"].translation())
    assert tip == pytest.approx([3.2, -2.0, 0.9])


def test_arrow_of_a_small_force_is_hidden():
    assert shown([0.0, 0.0, 0.4], [0.01, 0.0, 0.0]).properties[ARROW, "visible"] is False
