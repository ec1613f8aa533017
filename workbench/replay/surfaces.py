"""The visible shapes of a car as triangles, for pictures that need no graphics driver."""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    Box,
    Cylinder,
    Ellipsoid,
    GeometryId,
    Mesh,
    ReadObjToTriangleSurfaceMesh,
    Rgba,
    Role,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import ModelError
from aerodima.workbench.plants.car import CarPlant

_ROUND = 28
"""Corners of a circle."""


@dataclass(frozen=True)
class Surface:
    """One visible shape.

    Attributes:
        body: that it is fixed to.
        triangles: corners in the body frame, m, shape (n, 3, 3): triangle, corner, axis.
        colour: red, green, blue from 0 to 1.
    """

    body: RigidBody
    triangles: FloatArray
    colour: tuple[float, float, float]


def visible_surfaces(car: CarPlant) -> list[Surface]:
    """Every shape of a car with the illustration role.

    Raises:
        ModelError: a shape of another kind than box, cylinder, ellipsoid, sphere or OBJ mesh.
    """
    inspector = car.scene_graph.model_inspector()
    surfaces = []
    for geometry in inspector.GetAllGeometryIds(Role.kIllustration):
        corners = shape_triangles(inspector.GetShape(geometry), inspector.GetName(geometry))
        X_BG = inspector.GetPoseInFrame(geometry)
        moved = corners @ X_BG.rotation().matrix().T + X_BG.translation()
        body = car.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
        surfaces.append(Surface(body, moved, _colour(inspector, geometry)))
    return surfaces


def posed_triangles(
    surfaces: list[Surface], plant: MultibodyPlant, plant_context: Context
) -> tuple[FloatArray, FloatArray]:
    """Triangles (n, 3, 3) in W, m, and their colours (n, 3) in one pose of the plant."""
    corners, colours = [], []
    for surface in surfaces:
        X_WB = plant.EvalBodyPoseInWorld(plant_context, surface.body)
        corners.append(surface.triangles @ X_WB.rotation().matrix().T + X_WB.translation())
        colours.append(np.tile(surface.colour, (len(surface.triangles), 1)))
    return np.concatenate(corners), np.concatenate(colours)


def shape_triangles(shape: Shape, name: str) -> FloatArray:
    """Surface of a shape in its own frame, shape (n, 3, 3), m."""
    if isinstance(shape, Box):
        return _box() * [shape.width(), shape.depth(), shape.height()]
    if isinstance(shape, Cylinder):
        return _cylinder() * [shape.radius(), shape.radius(), shape.length()]
    if isinstance(shape, Ellipsoid):
        return _sphere() * [shape.a(), shape.b(), shape.c()]
    if isinstance(shape, Sphere):
        return _sphere() * shape.radius()
    if isinstance(shape, Mesh) and shape.extension() == ".obj":
        mesh = ReadObjToTriangleSurfaceMesh(shape.source().path(), shape.scale3())
        vertices = np.array([mesh.vertex(i) for i in range(mesh.num_vertices())])
        return vertices[[[face.vertex(i) for i in range(3)] for face in mesh.triangles()]]
    raise ModelError(
        f"visual {name!r}: a {type(shape).__name__} cannot be drawn; allowed: box, cylinder, ellipsoid, OBJ"
    )


def _colour(inspector: SceneGraphInspector, geometry: GeometryId) -> tuple[float, float, float]:
    properties = inspector.GetIllustrationProperties(geometry)
    colour = properties.GetPropertyOrDefault("phong", "diffuse", Rgba(0.7, 0.7, 0.7))
    assert isinstance(colour, Rgba)
    return colour.r(), colour.g(), colour.b()


def _box() -> FloatArray:
    """Cube of side 1 about the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return np.concatenate([[corners[[a, b, c]], corners[[a, c, d]]] for a, b, c, d in sides])


def _cylinder() -> FloatArray:
    """Radius 1, length 1 along z."""
    angle = np.linspace(0.0, 2.0 * np.pi, _ROUND + 1)
    rim = np.column_stack([np.cos(angle), np.sin(angle)])
    low, high = (np.column_stack([rim, np.full(len(rim), z)]) for z in (-0.5, 0.5))
    triangles = []
    for i in range(_ROUND):
        triangles += [[low[i], low[i + 1], high[i + 1]], [low[i], high[i + 1], high[i]]]
        triangles += [[high[i], high[i + 1], [0, 0, 0.5]], [low[i + 1], low[i], [0, 0, -0.5]]]
    return np.array(triangles)


def _sphere() -> FloatArray:
    """Radius 1."""
    azimuth = np.linspace(0.0, 2.0 * np.pi, _ROUND + 1)
    polar = np.linspace(0.0, np.pi, _ROUND // 2 + 1)
    grid = np.stack(
        [
            np.outer(np.sin(polar), np.cos(azimuth)),
            np.outer(np.sin(polar), np.sin(azimuth)),
            np.outer(np.cos(polar), np.ones_like(azimuth)),
        ],
        axis=-1,
    )
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    upper, lower = np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)
    return np.concatenate([upper.reshape(-1, 3, 3), lower.reshape(-1, 3, 3)])
