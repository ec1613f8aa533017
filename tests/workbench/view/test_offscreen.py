"""The camera sees left on the left, up above; the robot stands on its floor."""

import numpy as np
import pytest
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench import observe
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.view.offscreen import Camera, OffscreenRun, check_renderer, floor_picture
from tests.refusals import assert_refused


def along_x(height=2.0, target=2.0):
    """Looks along x from 4 m behind the origin."""
    return Camera(
        np.array([-4.0, 0.0, height]), np.array([0.0, 0.0, target]), 100.0, width=120, height=100
    )


def test_point_ahead_is_in_the_middle_left_is_left_and_up_is_up():
    column, row, inverse_depth = along_x().project(np.array([0.0, 0.0, 2.0]))
    assert (column, row, inverse_depth) == pytest.approx((60.0, 50.0, 0.25))
    column, row, _ = along_x().project(
        np.array([0.0, 1.0, 2.4])
    )  # 1 m to the left, 0.4 m up, 4 m away
    assert (column, row) == pytest.approx((60.0 - 25.0, 50.0 - 10.0))


@pytest.mark.parametrize("height", [0.0, -1.5])
def test_floor_begins_at_the_horizon_and_is_seen_where_it_is(height):
    picture, points = floor_picture(along_x(), height)
    assert (picture.shape, points.shape) == ((100, 120, 3), (50, 120, 3))
    assert np.all(picture[:50] == picture[0, 0])
    assert points[..., 2] == pytest.approx(np.full((50, 120), height))
    column, row, _ = along_x().project(points[30, 70])
    assert (column, row) == pytest.approx((70.5, 80.5))


def plate_above_the_floor(low, falls=0.0):
    """A red plate of 0.6 m x 0.6 m, so high (m), that hangs there for two rows or falls (s)."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    if not falls:
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    body = plant.AddRigidBody("plate", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    plant.RegisterVisualGeometry(
        body, RigidTransform(), Box(0.6, 0.6, 0.01), "plate", np.array([1.0, 0.0, 0.0, 1.0])
    )
    plant.Finalize()
    with observe(builder, plant, rate=10.0) as run:
        simulator = Simulator(builder.Build())
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.SetPositions(context, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, low])
        simulator.AdvanceTo(falls or 0.1)
    return run.log


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("low", [1.0, -3.0])
def test_robot_stands_where_it_is(low):
    shown = OffscreenRun(plate_above_the_floor(low))
    assert shown.logged.floor == pytest.approx(0.0 if low > 0.0 else low - 0.005)
    camera = along_x(low + 3.0, low)
    pixels = np.asarray(shown.picture(1, camera)).astype(float)
    red = pixels[..., 0] > pixels[..., 1] + 60.0
    rows, columns = np.nonzero(red)
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx(
        camera.project(np.array([0, 0, low]))[:2], abs=1
    )


@pytest.mark.usefixtures("renderer")
def test_a_robot_that_falls_stays_in_the_picture():
    shown = OffscreenRun(plate_above_the_floor(5.0, falls=0.9))
    logged = shown.logged
    assert np.ptp(logged.path[:, 2]) > 3.5
    for row in (0, len(logged.path) - 1):
        camera = shown.camera(row, logged.camera_azimuth, logged.camera_place, (300, 300))
        column, line, _ = camera.project(logged.path[row])
        assert (column, line) == pytest.approx((150, 150), abs=140)


@pytest.fixture
def without_driver(monkeypatch):
    """EGL looks for its drivers where there are none; VTK then takes its process down."""
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nowhere.json")
    monkeypatch.delenv("DISPLAY", raising=False)
    check_renderer.cache_clear()
    yield
    check_renderer.cache_clear()


@pytest.mark.slow
@pytest.mark.usefixtures("without_driver")
def test_missing_renderer_is_one_line(tailed):
    assert_refused(check_renderer, UserError, "aerodima replay --html")
    assert_refused(lambda: OffscreenRun(tailed), UserError, "aerodima replay --html")
