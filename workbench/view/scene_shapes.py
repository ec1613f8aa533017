"""Visible shapes of a plant as plain data in a log, and back: a replay needs no model file.

A mesh is kept as the convex hull of at most `MAX_POINTS` of its points, a capsule as a cylinder
and two spheres. Half spaces are left out: a replay has a floor of its own. So are meshes that
neither Drake nor `_stl_points` reads, such as DAE, with a warning.
"""

import re
import warnings
from collections.abc import Iterator
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    Mesh,
    Rgba,
    Role,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody, SpatialInertia, world_index
from pydrake.systems.framework import Context

from aerodima.workbench.aero.tail_force import bodies_of
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.file_reading import Facts, Json

MAX_POINTS = 200
"""Largest number of points of the hull that stands for a mesh."""
_STL_HEAD = 84
"""Number of bytes before the facets of a binary STL file."""
_STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""A facet of a binary STL file."""
WORLD_BODY = ""
"""Body of a shape that stands still."""
_GREY = Rgba(0.7, 0.7, 0.7)
"""Colour of a shape whose model names none."""
_KINDS = {"box": Box, "cylinder": Cylinder, "sphere": Sphere, "ellipsoid": Ellipsoid}


def body_label(plant: MultibodyPlant, body: RigidBody) -> str:
    """Names a body in a log, with its model instance where another body has the same name."""
    if body.index() == world_index():
        return WORLD_BODY
    if plant.NumBodiesWithName(body.name()) == 1:
        return body.name()
    return f"{plant.GetModelInstanceName(body.model_instance())}_{body.name()}"


def scene_bodies(plant: MultibodyPlant, scene: list[Json]) -> dict[str, BodyIndex]:
    """Finds label and index of each body of a plant, except the world, with a shape in a scene."""
    labels = {entry["body"] for entry in scene} - {WORLD_BODY}
    bodies = {body_label(plant, body): body.index() for body in bodies_of(plant)}
    return {label: index for label, index in bodies.items() if label in labels}


def plant_shapes(plant: MultibodyPlant, scene_graph: SceneGraph) -> list[Json]:
    """Lists every visible shape of a plant that is registered with this scene graph: body, kind,
    size, pose, colour.
    """
    inspector = scene_graph.model_inspector()
    visuals = map(plant.GetVisualGeometriesForBody, bodies_of(plant))
    own = set(chain.from_iterable(visuals))
    scene = []
    for geometry in inspector.GetAllGeometryIds(Role.kIllustration):
        if geometry not in own:
            continue
        body: RigidBody = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
        properties: Any = inspector.GetIllustrationProperties(geometry)
        diffuse = properties.GetPropertyOrDefault("phong", "diffuse", _GREY)
        look = {
            "body": body_label(plant, body),
            "colour": np.round(diffuse.rgba[:3], 4).tolist(),
        }
        shape = inspector.GetShape(geometry)
        try:
            parts = list(_parts(shape))
        except (OSError, RuntimeError, ValueError) as cause:
            # The warning is shown at the line that calls `observe`.
            warnings.warn(f"{body.name()}: {shape} is left out of the log: {cause}", stacklevel=4)
            continue
        for kind, size, X_GS in parts:
            X_BS = inspector.GetPoseInFrame(geometry) @ X_GS
            pose = [*X_BS.rotation().ToQuaternion().wxyz(), *X_BS.translation()]
            scene.append({**look, "kind": kind, "size": size, "pose": list(map(float, pose))})
    return scene


def _parts(shape: Shape) -> Iterator[tuple[str, list[Any], RigidTransform]]:
    """Gives kind, size (m) and pose in the shape's frame of what stands for a shape."""
    here = RigidTransform()
    if isinstance(shape, Box):
        yield "box", [shape.width(), shape.depth(), shape.height()], here
    elif isinstance(shape, Cylinder | Capsule):
        yield "cylinder", [shape.radius(), shape.length()], here
        if isinstance(shape, Capsule):
            for end in (-0.5, 0.5):
                X_GE = RigidTransform(np.array([0.0, 0.0, end * shape.length()]))
                yield "sphere", [shape.radius()], X_GE
    elif isinstance(shape, Sphere):
        yield "sphere", [shape.radius()], here
    elif isinstance(shape, Ellipsoid):
        yield "ellipsoid", [shape.a(), shape.b(), shape.c()], here
    elif isinstance(shape, Mesh | Convex):
        if shape.extension() == ".stl":
            points = _stl_points(Path(shape.source().path())) * shape.scale3()
        else:
            hull = shape.GetConvexHull()
            points = np.array([hull.vertex(index) for index in range(hull.num_vertices())])
        yield "hull", np.round(_outermost(points), 6).tolist(), here


def _stl_points(path: Path) -> FloatArray:
    """Reads the corners (n, 3) of a text or binary STL file, which Drake does not; ValueError if
    the file has none.
    """
    content = path.read_bytes()
    text = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", content)
    if text:
        return np.array(text, float)
    return np.frombuffer(content, _STL_FACET, offset=_STL_HEAD)["corners"].reshape(-1, 3)


def _directions() -> FloatArray:
    """Spreads unit vectors evenly over the sphere, shape (`MAX_POINTS`, 3)."""
    place = np.arange(MAX_POINTS) + 0.5
    height = 1.0 - 2.0 * place / MAX_POINTS
    turn = np.pi * (1.0 + np.sqrt(5.0)) * place
    radius = np.sqrt(1.0 - height**2)
    x = radius * np.cos(turn)
    y = radius * np.sin(turn)
    return np.column_stack([x, y, height])


def _outermost(points: FloatArray) -> FloatArray:
    """Selects at most `MAX_POINTS` corners of a hull (n, 3): the farthest in directions spread
    evenly over the sphere.
    """
    if len(points) <= MAX_POINTS:
        return points
    return np.asarray(points[np.unique(np.argmax(_directions() @ points.T, axis=1))])


def shape_points(entry: Facts) -> FloatArray:
    """Lists points that a shape of a log spans in the frame of its body, m, (n, 3)."""
    size: FloatArray = np.asarray(entry["size"], dtype=float)
    points = size
    if entry["kind"] == "box":
        points = size * np.array(list(product((-0.5, 0.5), repeat=3)))
    elif entry["kind"] == "cylinder":
        across = _directions()[:, :2]
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        points = np.column_stack([size[0] * across, size[1] * np.resize((-0.5, 0.5), MAX_POINTS)])
    elif entry["kind"] != "hull":
        points = size * _directions()
    X_BS = shape_pose(entry)
    return points @ X_BS.rotation().matrix().T + X_BS.translation()


def contexts_at(plant: MultibodyPlant, positions: FloatArray) -> Iterator[Context]:
    """Yields one context of a plant, put into each row of positions (n, nq) in turn."""
    context = plant.CreateDefaultContext()
    for values in positions:
        plant.SetPositions(context, values)
        yield context


def point_paths(
    plant: MultibodyPlant, body: str, p_BP: FloatArray, positions: FloatArray
) -> FloatArray:
    """Follows points of a body over a run.

    Args:
        plant: finalised plant.
        body: name of the body.
        p_BP: points in the frame of the body, m, shape (m, 3).
        positions: positions of the plant over the run, shape (n, nq).

    Returns:
        The points in W, m, shape (n, m, 3).
    """
    points: Any = p_BP.T
    frame = plant.GetBodyByName(body)
    return np.array(
        [
            plant.EvalBodyPoseInWorld(context, frame).multiply(points).T
            for context in contexts_at(plant, positions)
        ]
    )


def shape_pose(entry: Facts) -> RigidTransform:
    """Reads the pose of a shape of a log in the frame of its body."""
    pose = np.array(entry["pose"], float)
    return RigidTransform(Quaternion(pose[:4]), pose[4:])


def add_shapes(plant: MultibodyPlant, scene: Any, name: str) -> list[str]:
    """Puts the shapes of a log into a plant, before Finalize: a free body for each that moves.

    Returns the names of these bodies.

    Args:
        plant: plant that is registered with a scene graph.
        scene: shapes made by `plant_shapes`, as read from a log.
        name: name of the log, for messages.

    Raises:
        LogError: `scene` is not what `plant_shapes` makes.
    """
    bodies: dict[str, RigidBody] = {WORLD_BODY: plant.world_body()}
    try:
        for number, entry in enumerate(scene):
            body = entry["body"]
            if body not in bodies:
                inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
                bodies[body] = plant.AddRigidBody(body, inertia)
            colour = Rgba(*map(float, entry["colour"])).rgba
            shape: Shape
            if entry["kind"] == "hull":
                points = np.array(entry["size"], dtype=float)
                shape = Convex(points=points.T, label=f"shape_{number}")
            else:
                shape = _KINDS[entry["kind"]](*map(float, entry["size"]))
            plant.RegisterVisualGeometry(
                bodies[body], shape_pose(entry), shape, f"{number}", colour
            )
    except (KeyError, TypeError, ValueError, RuntimeError) as cause:
        raise LogError(f"{name}: the shapes in its metadata cannot be read ({cause!r})") from None
    return [body for body in bodies if body != WORLD_BODY]
