"""A run as Foxglove draws it (https://docs.foxglove.dev/docs/visualization/message-schemas): bodies, poses and forces.

The bodies of the car and the floor are drawn once, each in the frame of its own body; poses come as transforms to
`world`, forces as arrows there, of the lengths and colours of the replay. `write_mcap` puts them beside the signals.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    Mesh,
    ReadObjToTriangleSurfaceMesh,
    Rgba,
    Role,
    SceneGraphInspector,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.message_logs import SceneMessage, stamp_of
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.replay.force_arrows import ForceArrow, force_arrows, shortest_turn
from aerodima.workbench.replay.logged_car import LoggedCar, add_logged_car, replayable
from aerodima.workbench.replay.recording import frame_rows
from aerodima.workbench.replay.viewer import area_around

POSES, BODIES, FORCES = "/tf", "/scene/bodies", "/scene/forces"
"""Topics: a message `FrameTransforms` each, and twice `SceneUpdate`."""
WORLD_FRAME = "world"
_FLOOR = Rgba(0.90, 0.91, 0.92)
_SHAFT, _HEAD, _HEAD_LENGTH = 0.014, 0.036, 0.05
"""Diameters and length of the parts of an arrow, m."""


def scene_of(run_log: RunLog) -> Iterator[SceneMessage]:
    """The messages of a run in the order of their times, 50 frames a second.

    Raises:
        LogError: the log cannot be replayed (see `replayable`), or `foxglove_schemas_protobuf` is not installed.
    """
    try:
        import foxglove_schemas_protobuf  # noqa: F401
    except ImportError:
        raise LogError("a scene needs foxglove_schemas_protobuf: pip install 'aerodima-workbench[logs]'") from None
    builder = DiagramBuilder()
    logged = add_logged_car(builder, replayable(run_log))
    diagram = builder.Build()
    return _messages(logged, diagram.CreateDefaultContext())


def _messages(logged: LoggedCar, context: Any) -> Iterator[SceneMessage]:
    time = logged.run_log.time
    rows, _ = frame_rows(time, 1.0)
    arrows = force_arrows(logged)
    plant_context = logged.car.plant.GetMyMutableContextFromRoot(context)
    yield SceneMessage(time[rows[0]], BODIES, _bodies(logged, time[rows[0]]))
    for row in rows:
        logged.move(plant_context, row)
        yield SceneMessage(time[row], POSES, _poses(logged, plant_context, time[row]))
        if arrows:
            yield SceneMessage(time[row], FORCES, _forces(arrows, row, time[row]))


def _bodies(logged: LoggedCar, time: float) -> Any:
    """Every drawn geometry, locked to the frame of its body, and the floor."""
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    plant, inspector = logged.car.plant, logged.car.scene_graph.model_inspector()
    for body in _moving(logged):
        entity = update.entities.add(id=body, frame_id=body, frame_locked=True)
        entity.timestamp.FromNanoseconds(stamp_of(time))
        frame_id = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName(body).index())
        for geometry in inspector.GetGeometries(frame_id, Role.kIllustration):
            _draw(entity, inspector, geometry)
    x0, x1, y0, y1 = area_around(logged.run_log.vector("position", "truth_m"))
    floor = update.entities.add(id="floor", frame_id=WORLD_FRAME)
    floor.timestamp.FromNanoseconds(stamp_of(time))
    middle = RigidTransform(np.array([(x0 + x1) / 2, (y0 + y1) / 2, -0.012]))
    _place(floor.cubes.add(), middle, (x1 - x0, y1 - y0, 0.01), _FLOOR)
    return update


def _moving(logged: LoggedCar) -> list[str]:
    """Names of the bodies of car and tail."""
    plant = logged.car.plant
    instances = [logged.car.car] if logged.car.tail is None else [logged.car.car, logged.car.tail]
    return [plant.get_body(index).name() for instance in instances for index in plant.GetBodyIndices(instance)]


def _draw(entity: Any, inspector: SceneGraphInspector, geometry: GeometryId) -> None:
    """Adds a geometry to an entity; shapes that no car has, such as a half space, are left out."""
    shape, X_BG = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry)
    properties: Any = inspector.GetIllustrationProperties(geometry)
    colour: Rgba = properties.GetPropertyOrDefault("phong", "diffuse", Rgba(0.6, 0.6, 0.6))
    if isinstance(shape, Box):
        _place(entity.cubes.add(), X_BG, shape.size(), colour)
    elif isinstance(shape, Sphere | Ellipsoid):
        axes = [shape.radius()] * 3 if isinstance(shape, Sphere) else [shape.a(), shape.b(), shape.c()]
        _place(entity.spheres.add(), X_BG, 2.0 * np.array(axes), colour)
    elif isinstance(shape, Cylinder | Capsule):
        width = 2.0 * shape.radius()
        _place(entity.cylinders.add(bottom_scale=1.0, top_scale=1.0), X_BG, (width, width, shape.length()), colour)
        for end in (-0.5, 0.5) if isinstance(shape, Capsule) else ():
            _place(
                entity.spheres.add(),
                X_BG @ RigidTransform(np.array([0.0, 0.0, end * shape.length()])),
                [width] * 3,
                colour,
            )
    elif isinstance(shape, Mesh | Convex) and shape.extension() == ".obj":
        mesh = ReadObjToTriangleSurfaceMesh(shape.source().path(), shape.scale3())
        triangles = entity.triangles.add()
        _place(triangles, X_BG, None, colour)
        for vertex in mesh.vertices():
            triangles.points.add(x=vertex[0], y=vertex[1], z=vertex[2])
        triangles.indices.extend(triangle.vertex(corner) for triangle in mesh.triangles() for corner in range(3))


def _poses(logged: LoggedCar, plant_context: Any, time: float) -> Any:
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    message, plant = FrameTransforms(), logged.car.plant
    for body in _moving(logged):
        X_WB = plant.EvalBodyPoseInWorld(plant_context, plant.GetBodyByName(body))
        transform = message.transforms.add(parent_frame_id=WORLD_FRAME, child_frame_id=body)
        transform.timestamp.FromNanoseconds(stamp_of(time))
        _set_vector(transform.translation, X_WB.translation())
        _set_rotation(transform.rotation, X_WB.rotation())
    return message


def _forces(arrows: list[ForceArrow], row: int, time: float) -> Any:
    """The arrows of a row; one that is too short is taken away."""
    from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    for arrow in arrows:
        if not arrow.shown[row]:
            gone = update.deletions.add(id=arrow.name, type=SceneEntityDeletion.MATCHING_ID)
            gone.timestamp.FromNanoseconds(stamp_of(time))
            continue
        entity = update.entities.add(id=arrow.name, frame_id=WORLD_FRAME)
        entity.timestamp.FromNanoseconds(stamp_of(time))
        length = float(np.linalg.norm(arrow.lengths[row]))
        drawn = entity.arrows.add(
            shaft_length=max(length - _HEAD_LENGTH, 1e-3),
            shaft_diameter=_SHAFT,
            head_length=_HEAD_LENGTH,
            head_diameter=_HEAD,
        )
        along_x = RotationMatrix.MakeYRotation(-np.pi / 2.0)  # Foxglove's arrows point along x, `shortest_turn` turns z
        turn = shortest_turn(arrow.lengths[row] / length) @ along_x
        _place(drawn, RigidTransform(turn, arrow.points[row]), None, Rgba(*arrow.colour))
    return update


def _place(primitive: Any, pose: RigidTransform, size: Any, colour: Rgba) -> None:
    """Sets what all primitives have: pose, colour, and the size of those that have one."""
    _set_vector(primitive.pose.position, pose.translation())
    _set_rotation(primitive.pose.orientation, pose.rotation())
    if size is not None:
        _set_vector(primitive.size, size)
    for name in "rgba":
        setattr(primitive.color, name, getattr(colour, name)())


def _set_vector(target: Any, values: Any) -> None:
    target.x, target.y, target.z = map(float, values)


def _set_rotation(target: Any, rotation: RotationMatrix) -> None:
    quaternion = rotation.ToQuaternion()
    target.w, target.x, target.y, target.z = quaternion.w(), quaternion.x(), quaternion.y(), quaternion.z()
