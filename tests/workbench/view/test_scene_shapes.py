"""Shapes of a plant go into a log as plain data and come back with the same extent, place and
colour.
"""

import json

import numpy as np
import pytest
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    Mesh,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.core.resources import models_dir
from aerodima.workbench.view.scene_shapes import MAX_POINTS, add_shapes, plant_shapes, shape_points

X_BG = RigidTransform(RollPitchYaw(0.3, -0.2, 0.5), np.array([0.1, 0.2, 0.3]))


def scene_with(shape):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    body = plant.AddRigidBody("thing", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    plant.RegisterVisualGeometry(body, X_BG, shape, "shape", np.array([0.2, 0.4, 0.6, 1.0]))
    plant.Finalize()
    return json.loads(json.dumps(plant_shapes(plant, scene_graph)))


def corners(scene):
    """Points in the shape's own frame (n, 3) of the scene put into another plant; the colours are
    still those.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    assert add_shapes(plant, scene, "log") == ["thing"]
    plant.Finalize()
    again = plant_shapes(plant, scene_graph)
    assert all(entry["colour"] == [0.2, 0.4, 0.6] for entry in again)
    points = np.vstack([shape_points(entry) for entry in again])
    return np.asarray(X_BG.inverse().multiply(points.T).T)


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        (Box(0.2, 0.4, 0.6), (0.2, 0.4, 0.6)),
        (Cylinder(0.5, 0.3), (1.0, 1.0, 0.3)),
        (Ellipsoid(0.1, 0.2, 0.3), (0.2, 0.4, 0.6)),
        (Sphere(0.4), (0.8, 0.8, 0.8)),
        (Capsule(0.1, 0.5), (0.2, 0.2, 0.7)),
        (
            Convex(
                points=np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1]]).T, label="wedge"
            ),
            (0.3, 0.2, 0.1),
        ),
    ],
)
def test_shape_comes_back_with_its_extent_and_colour(shape, size):
    # Of a round shape 200 points stand for the whole: a fifteenth of a radian apart, so up to 1 %
    # too small.
    assert np.ptp(corners(scene_with(shape)), axis=0) == pytest.approx(np.array(size), rel=0.01)


def test_mesh_comes_back_as_its_convex_hull():
    mesh = Mesh(str(models_dir() / "tail" / "half_cylinder.obj"))
    scene = scene_with(mesh)
    assert len(scene[0]["size"]) <= MAX_POINTS
    hull = mesh.GetConvexHull()
    points = np.array([hull.vertex(index) for index in range(hull.num_vertices())])
    found = corners(scene)
    assert found.min(axis=0) == pytest.approx(points.min(axis=0), abs=1e-6)
    assert found.max(axis=0) == pytest.approx(points.max(axis=0), abs=1e-6)


WEDGE = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1]], "<f4")
FACETS = WEDGE[[[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]]
BINARY = bytes(84) + b"".join(bytes(12) + facet.tobytes() + bytes(2) for facet in FACETS)
TEXT = b"".join(b"vertex %e %e %e\n" % (*p,) for p in FACETS.reshape(-1, 3))


@pytest.mark.parametrize("content", [BINARY, TEXT], ids=["binary", "text"])
def test_stl_comes_back_with_its_corners_and_scale(tmp_path, content):
    path = tmp_path / "wedge.stl"
    path.write_bytes(content)
    found = corners(scene_with(Mesh(str(path), np.array([1.0, 2.0, 3.0]))))
    expected = np.unique(WEDGE * [1.0, 2.0, 3.0], axis=0)
    assert np.unique(np.round(found, 6) + 0.0, axis=0) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", ["wedge.dae", "broken.stl"])
def test_mesh_that_cannot_be_read_is_left_out_with_a_note(tmp_path, name):
    path = tmp_path / name
    path.write_text("no mesh")
    with pytest.warns(UserWarning, match=rf"thing: .*{name}"):
        assert scene_with(Mesh(str(path))) == []
